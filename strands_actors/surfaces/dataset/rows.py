"""Decode the index of a dataset, which has one row for each episode."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .errors import DatasetError
from .info import Count, Info
from .layout import FileSlot
from .statistics import Statistics
from .tables import read_table, refuse_damage

Number = Annotated[int, msgspec.Meta(ge=0, le=10**9)]
Length = Annotated[int, msgspec.Meta(ge=1, le=10**9)]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=1e9)]
NEEDED = ("min", "max", "mean", "std")


class VideoSpan(msgspec.Struct, frozen=True):
    """Where the pictures of an episode begin: the path of a video, relative to the dataset, and a time in
    it."""

    path: Path
    start_s: float


class EpisodeRow(msgspec.Struct, frozen=True):
    """One episode as the index describes it. Paths are relative to the dataset."""

    number: int
    tasks: tuple[str, ...]
    frames: int
    first: int  # Number of the episode's first frame, counted over the whole dataset.
    data: Path
    videos: dict[str, VideoSpan]
    statistics: dict[str, Statistics]


class _Row(
    msgspec.Struct,
    frozen=True,
    rename={"data_chunk": "data/chunk_index", "data_file": "data/file_index"},
):
    episode_index: Number
    length: Length
    dataset_from_index: Count
    dataset_to_index: Count
    data_chunk: Number
    data_file: Number
    tasks: list[str] | None = None


class _Video(msgspec.Struct, frozen=True):
    chunk_index: Number
    file_index: Number
    from_timestamp: Seconds


class OlderRow(msgspec.Struct, frozen=True):
    """A line of ``meta/episodes.jsonl``, which describes an episode in version 2."""

    episode_index: Number
    length: Length
    tasks: list[str] | None = None


class OlderTask(msgspec.Struct, frozen=True):
    """A line of ``meta/tasks.jsonl``, which has a task in version 2."""

    task_index: Number
    task: str


class OlderStatistics(msgspec.Struct, frozen=True):
    """A line of ``meta/episodes_stats.jsonl``, which has the statistics of an episode in version 2.1."""

    episode_index: Number
    stats: dict[str, dict[str, Any]]


def decode_row(row: Mapping[str, Any], info: Info) -> EpisodeRow:
    """Decode a row of ``meta/episodes``.

    Raises:
        DatasetError: A value is missing or impossible.
    """
    try:
        fields = msgspec.convert(dict(row), _Row)
        spans = {}
        for key in info.videos:
            prefix = f"videos/{key}/"
            video_fields = {
                name.removeprefix(prefix): value for name, value in row.items() if name.startswith(prefix)
            }
            video = msgspec.convert(video_fields, _Video)
            spans[key] = VideoSpan(FileSlot(video.chunk_index, video.file_index).video(key), video.from_timestamp)
    except msgspec.ValidationError as wrong:
        raise DatasetError(f"the index is wrong about this episode: {wrong}") from wrong
    if fields.dataset_to_index - fields.dataset_from_index != fields.length:
        raise DatasetError(
            f"the index contradicts itself about this episode: length {fields.length}, "
            f"frames {fields.dataset_from_index} to {fields.dataset_to_index}"
        )
    return EpisodeRow(
        fields.episode_index,
        tuple(fields.tasks or ()),
        fields.length,
        fields.dataset_from_index,
        FileSlot(fields.data_chunk, fields.data_file).data,
        spans,
        statistics_in(row),
    )


def frames_of(root: Path, row: EpisodeRow, without: Collection[str] = ()) -> pa.Table:
    """Return the frames of an episode.

    Args:
        root: The folder of the dataset.
        row: The episode.
        without: Columns that are left out, for example large pictures.

    Raises:
        DatasetError: The data file is missing or damaged.
    """
    table = read_table(root / row.data, without)
    with refuse_damage(root / row.data):
        return table.filter(pc.equal(table["episode_index"], row.number)).combine_chunks()


def episodes_of(
    root: Path, rows: Iterable[EpisodeRow], without: Collection[str] = ()
) -> Iterator[tuple[EpisodeRow, pa.Table]]:
    """Yield each episode with its frames, as ``frames_of``. A file that several episodes in a row share is read
    once."""
    for path, group in itertools.groupby(rows, key=lambda row: row.data):
        table = read_table(root / path, without)
        for row in group:
            with refuse_damage(root / path):
                frames = table.filter(pc.equal(table["episode_index"], row.number)).combine_chunks()
            yield row, frames


def slot_stated(row: Mapping[str, Any]) -> FileSlot | None:
    """Return the index file in which a row should stand, by its own columns. None if it does not state a
    file."""
    chunk, file = row.get("meta/episodes/chunk_index"), row.get("meta/episodes/file_index")
    return FileSlot(chunk, file) if isinstance(chunk, int) and isinstance(file, int) else None


def older_row(row: OlderRow, first: int, statistics: Mapping[str, Any], info: Info) -> EpisodeRow:
    """Return the row of an episode in version 2, where each episode has separate files with its number in their
    names."""
    chunk = f"chunk-{row.episode_index // info.chunks_size:03d}"
    name = f"episode_{row.episode_index:06d}"
    return EpisodeRow(
        row.episode_index,
        tuple(row.tasks or ()),
        row.length,
        first,
        Path("data") / chunk / f"{name}.parquet",
        {key: VideoSpan(Path("videos") / chunk / key / f"{name}.mp4", 0.0) for key in info.videos},
        {feature: usable for feature, values in statistics.items() if (usable := usable_statistics(values))},
    )


def statistics_in(row: Mapping[str, Any]) -> dict[str, Statistics]:
    """Return the usable statistics in a row of the index, by feature."""
    by_feature: dict[str, Statistics] = {}
    for name, value in row.items():
        if name.startswith("stats/") and value is not None:
            feature, _, statistic = name.removeprefix("stats/").rpartition("/")
            by_feature.setdefault(feature, {})[statistic] = value
    return {feature: usable for feature, values in by_feature.items() if (usable := usable_statistics(values))}


def usable_statistics(values: object) -> Statistics | None:
    """Return the statistics of a feature as nested lists. Return None if one of ``NEEDED`` is missing, or if
    they do not all have the same shape."""
    if not isinstance(values, Mapping):
        return None
    try:
        arrays = {name: np.asarray(value, dtype=np.float64) for name, value in values.items() if value is not None}
        count = np.ravel(arrays.pop("count"))
        shapes = {array.shape for array in arrays.values()}
        if not set(NEEDED) <= arrays.keys() or len(shapes) != 1 or count.size != 1 or not count[0] >= 1:
            return None
        if not next(iter(shapes)):  # Statistics of a single number may lack the dimension that LeRobot's have.
            arrays = {name: array.reshape(1) for name, array in arrays.items()}
        return {name: array.tolist() for name, array in arrays.items()} | {"count": [int(count[0])]}
    except (ValueError, TypeError, KeyError, OverflowError):
        return None
