"""LeRobot's format, version 3: which files there are, and what stands in ``info.json``.

Pure, but for reading what is there.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from .errors import DatasetError
from .info import VERSION, decode_info

CHUNK_FILES = 1000
"""Files of one folder."""
DATA_MB = 100
VIDEO_MB = 200

# Of each name that begins with ``observation`` LeRobot makes an input of a policy, and an output of
# each that begins with ``action``.
STATE = "observation.state"
ACTION = "action"
REQUESTED = "requested_action"
AGE = "age_ms"
UNITS = "units"
COUNTERS = ("frame_index", "episode_index", "index", "task_index")
VECTORS = (STATE, AGE, ACTION, REQUESTED)

INFO = Path("meta/info.json")
STATS = Path("meta/stats.json")
TASKS = Path("meta/tasks.parquet")
STAGING = Path(".staging")
_OWN = re.compile(
    r"(data|meta/episodes)/chunk-\d+/file-\d+\.parquet|videos/[^/]+/chunk-\d+/file-\d+\.mp4"
    r"|meta/(info\.json|stats\.json|tasks\.parquet)\.staged"
)


class CameraShape(msgspec.Struct, frozen=True):
    """How large the pictures of one camera are."""

    name: str
    height: int
    width: int

    @property
    def key(self) -> str:
        return f"observation.images.{self.name}"


class Layout(msgspec.Struct, frozen=True):
    """What every frame of a dataset has. ``joints``: the names of an action and of a state, as
    LeRobot spells them (``shoulder_pan.pos``); ``units``: theirs, one each, where they are known."""

    robot_type: str
    fps: int
    joints: tuple[str, ...]
    cameras: tuple[CameraShape, ...] = ()
    codec: str = "av1"
    units: tuple[str, ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """Whose age each frame has: the robot's state, and each camera."""
        return ("state", *(camera.name for camera in self.cameras))

    def width_of(self, vector: str) -> int:
        return len(self.sources) if vector == AGE else len(self.joints)

    def features(self) -> dict[str, Any]:
        """As ``info.json`` has them."""
        found: dict[str, Any] = {}
        for vector in (ACTION, REQUESTED, STATE, AGE):
            names = self.sources if vector == AGE else self.joints
            found[vector] = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
            if self.units and vector != AGE:
                found[vector][UNITS] = list(self.units)  # LeRobot keeps it, and does not look at it
        for camera in self.cameras:
            found[camera.key] = {
                "dtype": "video",
                "shape": [camera.height, camera.width, 3],
                "names": ["height", "width", "channels"],
                "info": {
                    "video.height": camera.height,
                    "video.width": camera.width,
                    "video.codec": self.codec,
                    "video.pix_fmt": "yuv420p",
                    "video.is_depth_map": False,
                    "video.fps": self.fps,
                    "video.channels": 3,
                    "has_audio": False,
                },
            }
        found["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        found |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in COUNTERS}
        return found

    def info(self, episodes: int, frames: int, tasks: int) -> dict[str, Any]:
        return {
            "codebase_version": VERSION,
            "robot_type": self.robot_type,
            "total_episodes": episodes,
            "total_frames": frames,
            "total_tasks": tasks,
            "chunks_size": CHUNK_FILES,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self.fps,
            "splits": {"train": f"0:{episodes}"},
            "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
            "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
            "features": self.features(),
        }


class FileSlot(msgspec.Struct, frozen=True, order=True):
    """One file among its kind."""

    chunk: int
    file: int

    @property
    def next(self) -> FileSlot:
        return FileSlot(*divmod(self.chunk * CHUNK_FILES + self.file + 1, CHUNK_FILES))

    def _below(self, folder: str, suffix: str) -> Path:
        return Path(folder) / f"chunk-{self.chunk:03d}" / f"file-{self.file:03d}{suffix}"

    @property
    def data(self) -> Path:
        return self._below("data", ".parquet")

    @property
    def episodes(self) -> Path:
        return self._below("meta/episodes", ".parquet")

    def video(self, key: str) -> Path:
        return self._below(f"videos/{key}", ".mp4")


def is_own_name(path: Path) -> bool:
    """Whether a file of a dataset, or one on its way to be one, is called so: ``path`` in its folder."""
    return _OWN.fullmatch(path.as_posix()) is not None


def read_info(root: Path) -> dict[str, Any] | None:
    """Return what the dataset says of itself; None: it has no episode yet. Raise
    ``DatasetError``."""
    try:
        return decode_info((root / INFO).read_bytes(), root / INFO)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DatasetError(f"{root / INFO} cannot be read: {error}") from error


def layout_of(info: dict[str, Any]) -> Layout:
    """Raise ``DatasetError`` when a dataset has other features than those recorded here."""
    features = info["features"]
    cameras = tuple(
        CameraShape(key.removeprefix("observation.images."), *feature["shape"][:2])
        for key, feature in features.items()
        if feature["dtype"] == "video"
    )
    codecs = {(feature.get("info") or {}).get("video.codec", "") for feature in features.values()} - {""}
    joints = tuple(features.get(ACTION, {}).get("names") or ())
    units = tuple(features.get(ACTION, {}).get(UNITS) or ())
    codec = min(codecs, default="av1")
    layout = Layout(info.get("robot_type") or "", int(info["fps"]), joints, cameras, codec, units)
    if difference := difference_of(layout.features(), features):
        raise DatasetError(f"its features are not those of a recording: {difference}")
    return layout


def difference_of(ours: dict[str, Any], theirs: dict[str, Any]) -> str:
    """Return which features differ in what a program relies on; empty: none."""
    for key in (*ours, *(key for key in theirs if key not in ours)):
        here, there = (_essence(features.get(key)) for features in (ours, theirs))
        if here != there:
            return f"{key} is {there}, not {here}"
        units = [features[key].get(UNITS) for features in (ours, theirs)]
        if all(units) and units[0] != units[1]:  # what is older has none: then they are the robot's
            here, there = (", ".join(unit or "no unit" for unit in each) for each in units)
            return f"{key} is in {there}, not in {here}"
    return ""


def _essence(feature: dict[str, Any] | None) -> str:
    if feature is None:
        return "not there"
    names = feature.get("names")
    return f"{feature['dtype']} {list(feature['shape'])}" + (f" {', '.join(names)}" if names else "")


def tasks_table(tasks: list[str]) -> pa.Table:
    """As pandas writes it: the text of a task is the index."""
    table = pa.table(
        {"task_index": pa.array(range(len(tasks)), pa.int64()), "__index_level_0__": pa.array(tasks, pa.string())}
    )
    no_name = {"name": None, "field_name": None, "metadata": {"encoding": "UTF-8"}}
    described = {
        "index_columns": ["__index_level_0__"],
        "column_indexes": [no_name | {"pandas_type": "unicode", "numpy_type": "object"}],
        "columns": [
            {
                "name": "task_index",
                "field_name": "task_index",
                "pandas_type": "int64",
                "numpy_type": "int64",
                "metadata": None,
            },
            {
                "name": None,
                "field_name": "__index_level_0__",
                "pandas_type": "unicode",
                "numpy_type": "object",
                "metadata": None,
            },
        ],
        "creator": {"library": "pyarrow", "version": pa.__version__},
        "pandas_version": "2.2.0",
    }
    with_pandas: pa.Table = table.replace_schema_metadata({"pandas": json.dumps(described)})
    return with_pandas


def tasks_of(table: pa.Table) -> list[str]:
    """In the order of their numbers."""
    text = next(name for name in table.column_names if name != "task_index")
    rows = zip(table["task_index"].to_pylist(), table[text].to_pylist(), strict=True)
    return [task for _, task in sorted(rows)]
