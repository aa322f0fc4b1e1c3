"""Describe LeRobot's format, version 3: the names of the files, and the contents of ``info.json``.

Only ``read_info`` does I/O.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa

from strands_actors.contract.lfs import pointer_reason

from .errors import DatasetError
from .info import VERSION, Feature, Info, decode_info

CHUNK_FILES = 1000
"""Files in one folder."""
DATA_MB = 100
VIDEO_MB = 200

# LeRobot makes each feature an input of a policy if its name begins with ``observation``, and an output if it
# begins with ``action``. So ``requested_action`` and ``age_ms`` begin with neither.
STATE = "observation.state"
CAMERA = "observation.images."
ACTION = "action"
REQUESTED = "requested_action"
AGE = "age_ms"
UNITS = "units"
COUNTERS = ("frame_index", "episode_index", "index", "task_index")
VECTORS = (STATE, AGE, ACTION, REQUESTED)

DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"

INFO = Path("meta/info.json")
STATS = Path("meta/stats.json")
TASKS = Path("meta/tasks.parquet")
STAGING = Path(".staging")
_OWN = re.compile(
    r"(data|meta/episodes)/chunk-\d+/file-\d+\.parquet|videos/[^/]+/chunk-\d+/file-\d+\.mp4"
    r"|meta/(info\.json|stats\.json|tasks\.parquet)\.staged"
)


class CameraShape(msgspec.Struct, frozen=True):
    """The name of a camera and the size of its pictures, in pixels."""

    name: str
    height: int
    width: int

    @property
    def key(self) -> str:
        return CAMERA + self.name


class Layout(msgspec.Struct, frozen=True):
    """The features that every frame of a dataset has.

    Attributes:
        robot_type: The robot, as in ``info.json``.
        fps: Frames per second.
        joints: Names of the numbers of an action and a state, as LeRobot spells them
            (``shoulder_pan.pos``).
        cameras: The cameras.
        codec: The codec of all videos.
        units: The unit of each joint; empty if not known.
        read_only: (name, unit) of the joints that can only be read. A state has their values after those of
            ``joints``.
    """

    robot_type: str
    fps: int
    joints: tuple[str, ...]
    cameras: tuple[CameraShape, ...] = ()
    codec: str = "av1"
    units: tuple[str, ...] = ()
    read_only: tuple[tuple[str, str], ...] = ()

    @property
    def sources(self) -> tuple[str, ...]:
        """The sources of a frame's data: the robot's state, then each camera. ``age_ms`` has this order."""
        return ("state", *(camera.name for camera in self.cameras))

    def names_of(self, vector: str) -> tuple[str, ...]:
        if vector == AGE:
            return self.sources
        return (*self.joints, *(name for name, _ in self.read_only)) if vector == STATE else self.joints

    def units_of(self, vector: str) -> tuple[str, ...]:
        """Return the unit of each value of a vector, such as ``action``. Empty if the units are not known."""
        if vector == AGE or not self.units:
            return ()
        return (*self.units, *(unit for _, unit in self.read_only)) if vector == STATE else self.units

    def features(self) -> dict[str, Any]:
        """Return the features in the form of ``info.json``."""
        features: dict[str, Any] = {}
        for vector in (ACTION, REQUESTED, STATE, AGE):
            names = self.names_of(vector)
            features[vector] = {"dtype": "float32", "shape": [len(names)], "names": list(names)}
            if units := self.units_of(vector):
                features[vector][UNITS] = list(units)  # LeRobot preserves this key, but does not use it.
        for camera in self.cameras:
            features[camera.key] = {
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
        features["timestamp"] = {"dtype": "float32", "shape": [1], "names": None}
        features |= {name: {"dtype": "int64", "shape": [1], "names": None} for name in COUNTERS}
        return features

    def typed_features(self) -> dict[str, Feature]:
        return msgspec.convert(self.features(), dict[str, Feature])

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
            "data_path": DATA_PATH,
            "video_path": VIDEO_PATH,
            "features": self.features(),
        }


class FileSlot(msgspec.Struct, frozen=True, order=True):
    """The number of a file: its folder ("chunk") and its number in this folder.

    Data files, index files and the videos of each camera are numbered separately.
    """

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
    """Return True if a path has a name that this package gives to files of a dataset, final or temporary.

    Args:
        path: The path, relative to the dataset.
    """
    return _OWN.fullmatch(path.as_posix()) is not None


def read_info(root: Path) -> Info | None:
    """Return the decoded ``info.json``; None if there is no such file.

    Raises:
        DatasetError: The file cannot be read or decoded, or is only a pointer of Git LFS.
    """
    try:
        if pointer := pointer_reason(root / INFO):
            raise DatasetError(pointer)
        return decode_info((root / INFO).read_bytes(), root / INFO)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise DatasetError(f"{root / INFO} cannot be read: {error}") from error


def layout_of(info: Info) -> Layout:
    """Return the layout of a dataset that this package has recorded.

    Raises:
        DatasetError: The dataset has a version, rate or features that a recording of this package cannot have.
    """
    if info.fps != int(info.fps):
        raise DatasetError(f"its rate is {info.fps} fps, and a recording needs a whole number")
    cameras = tuple(
        CameraShape(key.removeprefix(CAMERA), *info.features[key].height_width)
        for key in info.videos
        if key.startswith(CAMERA)
    )
    codecs = {feature.codec for feature in info.features.values()} - {""}
    joints, units = _named(info, ACTION)
    state, state_units = _named(info, STATE)
    behind = state[len(joints) :]
    read_only = tuple(zip(behind, state_units[len(joints) :] or ("",) * len(behind), strict=False))
    layout = Layout(
        info.robot_type or "", int(info.fps), joints, cameras, min(codecs, default="av1"), units, read_only
    )
    if difference := difference_of(layout.typed_features(), info.features):
        raise DatasetError(f"its features differ from those of a recording: {difference}")
    return layout


def _named(info: Info, vector: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the name and the unit of each value of a vector, such as ``action``."""
    feature = info.features.get(vector)
    return (tuple(feature.flat_names), tuple(feature.flat_units)) if feature else ((), ())


def difference_of(
    ours: Mapping[str, Feature],
    theirs: Mapping[str, Feature],
    names: tuple[str, str] = ("the recording", "the dataset"),
) -> str:
    """Return the first difference between features that matters to a program that reads the data. Empty if
    there is no such difference. ``names`` says in the text what ``ours`` and ``theirs`` are."""
    for key in (*ours, *(key for key in theirs if key not in ours)):
        mine, counterpart = ours.get(key), theirs.get(key)
        if mine is None or counterpart is None:
            return f"{key} is only in {names[mine is None]}"
        if (ours_text := _essence(mine)) != (theirs_text := _essence(counterpart)):
            return f"{key} is {theirs_text}, not {ours_text}"
        # Older versions of this package did not write units. Such a dataset has the robot's units.
        if mine.flat_units and counterpart.flat_units and mine.flat_units != counterpart.flat_units:
            ours_text, theirs_text = (
                ", ".join(unit or "no unit" for unit in each.flat_units) for each in (mine, counterpart)
            )
            return f"{key} is in {theirs_text}, not in {ours_text}"
    return ""


def contradiction_of(ours: Mapping[str, Feature], theirs: Mapping[str, Feature]) -> str:
    """Return the first declared feature that a recording would not have, or would have in another form. Empty
    if there is no such feature.

    Use this for a dataset without episodes. Its ``info.json`` may lack the features ``requested_action`` and
    ``age_ms``, because LeRobot does not know them. The first episode adds them.

    Args:
        ours: The features of the recording.
        theirs: The features that the dataset declares.
    """
    return difference_of({key: feature for key, feature in ours.items() if key in theirs}, theirs)


def _essence(feature: Feature) -> str:
    if feature.dtype == "video":
        height, width = feature.height_width
        return f"video {width}x{height}x{math.prod(feature.shape) // (height * width)}"
    names = feature.flat_names
    return f"{feature.dtype} {feature.shape}" + (f" {', '.join(names)}" if names else "")


def tasks_table(tasks: list[str]) -> pa.Table:
    """Return the table of tasks in the form in which pandas writes it: the text of each task is its row's
    index, as LeRobot expects."""
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
    """Return the tasks in the order of their numbers.

    Raises:
        ValueError: The tasks are not numbered from 0.
        pyarrow.ArrowException: The table is damaged.
    """
    text = next((name for name in table.column_names if name != "task_index"), "")
    numbers, tasks = (table[name].to_pylist() for name in ("task_index", text))
    ordered = dict(sorted(zip(numbers, tasks, strict=True)))
    if list(ordered) != list(range(len(tasks))) or not all(isinstance(task, str) for task in tasks):
        raise ValueError("the tasks are not numbered from 0")
    return list(ordered.values())
