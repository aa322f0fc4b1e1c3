"""Build the parts of a finished episode: its rows, its statistics, and its row in the dataset's index."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from .layout import VECTORS, FileSlot, Layout
from .staging import GAP, STALE, Staged
from .statistics import PictureStatistics, Statistics, of_column
from .video import pictures_of

QUALITY_KEY = b"strands_actors"
"""Key in the metadata of the index's files. Its value is a JSON object of the recorder's notes, by episode
number."""


class Quality(msgspec.Struct, frozen=True):
    """The recorder's notes on the quality of an episode.

    Attributes:
        gaps: Number of missing frames.
        stale: For the robot's state and each camera, the number of frames in which its value was older than
            1.5 periods.
        repaired: True if the recorder did not finish the episode.
        began: Date and time at which the episode began.
        pictures: A checksum of the pictures of each video, by the video's key.
        mark: What ``dataset label`` has noted, such as "failed".
    """

    gaps: int = 0
    stale: dict[str, int] = {}
    repaired: bool = False
    began: str = ""
    pictures: dict[str, int] = {}
    mark: str = ""

    @property
    def as_text(self) -> str:
        """The defects and the mark as text, for example "3 frames missing"; empty if there are none."""
        words = [f"{self.gaps} frames missing"] if self.gaps else []
        words += [f"{name} late in {count} frames" for name, count in self.stale.items()]
        words += ["repaired"] if self.repaired else []
        return ", ".join([*words, self.mark] if self.mark else words)


class Episode(msgspec.Struct, frozen=True):
    """A committed episode."""

    index: int
    task: str
    frames: int
    quality: Quality


def quality_of(staged: Staged, table: pa.Table, pictures: dict[str, int]) -> Quality:
    """Return the recorder's notes on the quality of an episode in its staging folder.

    Args:
        staged: The episode.
        table: The rows of the episode that are committed.
        pictures: A checksum of the pictures of each video, by the video's key.
    """
    stale = Counter(name for row in table[STALE].to_pylist() for name in row)
    gaps = sum(table[GAP].to_pylist())
    finished = staged.finished
    if finished is not None:
        gaps += finished.gap + finished.frames - table.num_rows
    return Quality(gaps, dict(sorted(stale.items())), finished is None, staged.about.began, pictures)


def columns_of(layout: Layout, table: pa.Table, episode: int, first: int, task: int) -> dict[str, NDArray[Any]]:
    """Return every column of an episode, with one row per frame.

    Args:
        layout: The dataset's layout.
        table: The rows of the episode in its staging folder.
        episode: The number of the episode.
        first: The number of the episode's first frame, counted over the whole dataset.
        task: The number of the episode's task.
    """
    count = table.num_rows
    frames = np.arange(count, dtype=np.int64)
    columns: dict[str, NDArray[Any]] = {name: _rows(table, name, len(layout.names_of(name))) for name in VECTORS}
    return columns | {
        "timestamp": (frames / layout.fps).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(count, episode, np.int64),
        "index": frames + first,
        "task_index": np.full(count, task, np.int64),
    }


def _rows(table: pa.Table, name: str, width: int) -> NDArray[np.float32]:
    values = [chunk.flatten().to_numpy(zero_copy_only=False) for chunk in table[name].chunks]
    return np.concatenate(values, dtype=np.float32).reshape(-1, width)


def data_table(columns: Mapping[str, NDArray[Any]]) -> pa.Table:
    """Return the columns as a table in LeRobot's form, in which a vector of length one is a plain number."""
    return pa.table(
        {
            name: pa.array(values.ravel())
            if values.ndim == 1 or values.shape[1] == 1
            else pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
            for name, values in columns.items()
        }
    )


def statistics_of(
    staged: Staged, columns: Mapping[str, NDArray[Any]], layout: Layout, videos: Mapping[str, Path]
) -> dict[str, Statistics]:
    """Return the statistics of each feature of an episode.

    Args:
        staged: The episode.
        columns: The columns of the episode.
        layout: The dataset's layout.
        videos: The final video of each camera. It is decoded only if the recorder did not finish the episode.
    """
    by_feature = {name: of_column(values) for name, values in columns.items()}
    for camera in layout.cameras:
        pictures = PictureStatistics()
        if staged.finished is not None:
            pictures.take(staged.finished.levels[camera.name], staged.finished.frames)
        else:
            for picture in pictures_of(videos[camera.name]):
                pictures.add(picture)
        by_feature[camera.key] = pictures.statistics()
    return by_feature


def index_row(
    episode: int,
    task: str,
    first: int,
    frames: int,
    slot: FileSlot,
    layout: Layout,
    statistics: Mapping[str, Statistics],
) -> dict[str, Any]:
    row: dict[str, Any] = {
        "episode_index": episode,
        "tasks": [task],
        "length": frames,
        "data/chunk_index": slot.chunk,
        "data/file_index": slot.file,
        "dataset_from_index": first,
        "dataset_to_index": first + frames,
    }
    for camera in layout.cameras:
        row |= {
            f"videos/{camera.key}/chunk_index": slot.chunk,
            f"videos/{camera.key}/file_index": slot.file,
            f"videos/{camera.key}/from_timestamp": 0.0,
            f"videos/{camera.key}/to_timestamp": frames / layout.fps,
        }
    row |= {"meta/episodes/chunk_index": slot.chunk, "meta/episodes/file_index": slot.file}
    for feature, values in statistics.items():
        row |= {f"stats/{feature}/{name}": value for name, value in values.items()}
    return row


def index_table(rows: list[dict[str, Any]], quality: Mapping[int, Quality]) -> pa.Table:
    schema = pa.schema([(name, _column_type(name, rows[0][name])) for name in rows[0]])
    encoded = msgspec.json.encode({str(number): each for number, each in quality.items()})
    return pa.Table.from_pylist(rows, schema=schema.with_metadata({QUALITY_KEY: encoded}))


def decode_quality(metadata: Mapping[bytes, bytes]) -> dict[int, Quality]:
    """Return the recorder's notes from the metadata of an index file. Empty if another program wrote the file.

    Raises:
        msgspec.MsgspecError: The notes are damaged.
    """
    return msgspec.json.decode(metadata.get(QUALITY_KEY, b"{}"), type=dict[int, Quality], strict=False)


def _column_type(name: str, value: Any) -> pa.DataType:
    """Return the type of a column of the index. The type follows from the column's name, not from the values,
    so that it is the same for all episodes."""
    if name == "tasks":
        return pa.list_(pa.string())
    if isinstance(value, list):
        return pa.list_(_column_type(name, value[0]) if value else pa.float64())
    if isinstance(value, str):
        return pa.string()
    is_count = name.endswith("/count") or not (name.startswith("stats/") or name.endswith("_timestamp"))
    return pa.int64() if is_count else pa.float64()
