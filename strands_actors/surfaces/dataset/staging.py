"""Write the running episode into a staging folder, as streams. If the recorder is killed, the streams can be
read up to the last write.

An episode's folder has ``episode.json`` (layout, task and date), ``frames.arrows`` (an Arrow stream, with one
batch per half second), a fragmented MP4 for each camera and, after the episode was finished,
``finished.json``.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from .errors import DatasetError
from .layout import ACTION, AGE, REQUESTED, STATE, Layout
from .statistics import PictureStatistics
from .storage import Storage
from .video import FRAGMENT_S, Encoder, require_codec

ABOUT = "episode.json"
FINISHED = "finished.json"
FRAMES = "frames.arrows"
GAP = "gap"
STALE = "stale"

Picture = NDArray[np.uint8]


class Row(msgspec.Struct, frozen=True):
    """One frame without its pictures.

    Attributes:
        state: The measured positions, and the values of read-only joints.
        action: The target that was in effect.
        requested: The target that the program requested.
        age_ms: The age of each of ``Layout.sources``, in milliseconds.
        gap: Number of missing frames before this one.
        stale: The sources that are older than allowed.
    """

    state: tuple[float, ...]
    action: tuple[float, ...]
    requested: tuple[float, ...]
    age_ms: tuple[float, ...]
    gap: int = 0
    stale: tuple[str, ...] = ()


class About(msgspec.Struct, frozen=True):
    layout: Layout
    task: str
    began: str  # Date and time at which the episode began.


class Finished(msgspec.Struct, frozen=True):
    """The contents of ``finished.json``.

    Attributes:
        frames: Number of frames.
        gap: Number of missing frames after the last frame.
        levels: For each camera, a histogram of each colour with 256 levels.
    """

    frames: int
    gap: int
    levels: dict[str, list[list[int]]]


class Staged(msgspec.Struct, frozen=True):
    """An episode as read from its staging folder."""

    folder: Path
    about: About
    finished: Finished | None
    table: pa.Table

    def video(self, camera: str) -> Path:
        return self.folder / f"{camera}.mp4"


def schema_of(layout: Layout) -> pa.Schema:
    vectors = {name: pa.list_(pa.float32(), len(layout.names_of(name))) for name in (STATE, ACTION, REQUESTED, AGE)}
    return pa.schema({**vectors, GAP: pa.int64(), STALE: pa.list_(pa.string())})


class StagedEpisode:
    """Writes one episode into its staging folder.

    Any method may raise ``OSError``. The part that was written before can then be repaired, as after a kill.
    """

    def __init__(self, storage: Storage, folder: Path, layout: Layout, task: str) -> None:
        require_codec(layout.codec, layout.cameras)
        self.folder = folder
        self.layout = layout
        self.frames = 0
        self._storage = storage
        self._rows: list[Row] = []
        self._batch = max(1, round(layout.fps * FRAGMENT_S))
        began = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
        storage.write(folder / ABOUT, msgspec.json.encode(About(layout, task, began)))
        self._file = storage.create(folder / FRAMES)
        self._stream = pa.ipc.new_stream(pa.PythonFile(self._file, "w"), schema_of(layout))
        self._encoders: dict[str, Encoder] = {}
        self._levels: dict[str, PictureStatistics] = {}
        for camera in layout.cameras:
            self._encoders[camera.name] = Encoder(folder / f"{camera.name}.mp4", camera, layout.fps, layout.codec)
            self._levels[camera.name] = PictureStatistics()
        self._threads = ThreadPoolExecutor(max(1, len(layout.cameras)), "encoder")

    def add(self, row: Row, pictures: Mapping[str, Picture]) -> None:
        """Write one frame. The pictures of the cameras are encoded in parallel."""
        for _ in self._threads.map(self._encode, pictures.items()):
            pass
        self._rows.append(row)
        self.frames += 1
        if len(self._rows) >= self._batch:
            self._write()

    def _encode(self, named_picture: tuple[str, Picture]) -> None:
        camera, picture = named_picture
        self._levels[camera].add(picture)
        self._encoders[camera].add(picture)

    def _write(self) -> None:
        rows, self._rows = self._rows, []
        columns = [
            *(
                pa.FixedSizeListArray.from_arrays(pa.array(np.array(values, np.float32).ravel()), len(values[0]))
                for values in (
                    [row.state for row in rows],
                    [row.action for row in rows],
                    [row.requested for row in rows],
                    [row.age_ms for row in rows],
                )
            ),
            pa.array([row.gap for row in rows], pa.int64()),
            pa.array([list(row.stale) for row in rows], pa.list_(pa.string())),
        ]
        self._stream.write_batch(pa.record_batch(columns, schema=schema_of(self.layout)))
        self._file.flush()

    def finish(self, gap: int = 0) -> None:
        """Complete the episode, and wait until it is on the disk.

        Args:
            gap: Number of missing frames after the last frame.
        """
        if self._rows:
            self._write()
        self._stream.close()
        self._storage.sync(self._file)
        for camera, encoder in self._encoders.items():
            encoder.finish()
            self._storage.sync_path(self.folder / f"{camera}.mp4")
        levels = {camera: statistics.histogram.tolist() for camera, statistics in self._levels.items()}
        self._storage.write(self.folder / FINISHED, msgspec.json.encode(Finished(self.frames, gap, levels)))
        self._storage.sync_path(self.folder)
        self.abandon()

    def abandon(self) -> None:
        """Close all open files. The written part stays."""
        self._threads.shutdown()
        for encoder in self._encoders.values():
            encoder.abandon()
        self._file.close()


def read_staged(folder: Path) -> Staged:
    """Read an episode from its staging folder.

    Raises:
        DatasetError: The folder has no episode, or it is damaged.
    """
    try:
        about = msgspec.json.decode((folder / ABOUT).read_bytes(), type=About)
        finished = None
        if (folder / FINISHED).exists():
            finished = msgspec.json.decode((folder / FINISHED).read_bytes(), type=Finished)
    except (OSError, msgspec.MsgspecError) as damage:
        raise DatasetError(f"{folder} has no readable episode: {' '.join(str(damage).split())}") from damage
    return Staged(folder, about, finished, _read_frames(folder / FRAMES, about.layout))


def _read_frames(path: Path, layout: Layout) -> pa.Table:
    """Return the frames of all batches that were written completely."""
    batches: list[pa.RecordBatch] = []
    schema = schema_of(layout)
    try:
        with path.open("rb") as file, pa.ipc.open_stream(file) as stream:
            if not stream.schema.equals(schema):
                raise DatasetError(f"{path} has other columns than its episode.json describes")
            for batch in stream:
                batches.append(batch)
    except (pa.ArrowInvalid, FileNotFoundError, EOFError, OSError):
        pass  # The recorder was killed while it wrote the next batch.
    return pa.Table.from_batches(batches, schema)


def staged_folders(staging: Path) -> Sequence[Path]:
    """Return the folders of the episodes in staging, oldest first."""
    return sorted(path for path in staging.glob("episode-*") if path.is_dir())


def new_folder(staging: Path) -> Path:
    return staging / f"episode-{time.time_ns()}"
