"""Decode the index of a dataset: one row for each episode. Pure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from .errors import DatasetError
from .info import Count, Info
from .layout import FileSlot
from .statistics import Figures
from .tables import read_table, refuse_damage

Number = Annotated[int, msgspec.Meta(ge=0, le=10**9)]
Length = Annotated[int, msgspec.Meta(ge=1, le=10**9)]
Seconds = Annotated[float, msgspec.Meta(ge=0, le=1e9)]
NEEDED = ("min", "max", "mean", "std")


class VideoSpan(msgspec.Struct, frozen=True):
    """The start of an episode's pictures: a file, relative to the dataset, and a time in it."""

    path: Path
    start_s: float


class EpisodeRow(msgspec.Struct, frozen=True):
    """One episode as the index describes it. Paths are relative to the dataset."""

    number: int
    tasks: tuple[str, ...]
    frames: int
    first: int  # the number of its first frame in the dataset
    data: Path
    videos: dict[str, VideoSpan]
    figures: dict[str, Figures]


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
    """A line of ``meta/episodes.jsonl``."""

    episode_index: Number
    length: Length
    tasks: list[str] | None = None


class OlderTask(msgspec.Struct, frozen=True):
    """A line of ``meta/tasks.jsonl``."""

    task_index: Number
    task: str


class OlderFigures(msgspec.Struct, frozen=True):
    """A line of ``meta/episodes_stats.jsonl``."""

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
            given = {name.removeprefix(prefix): value for name, value in row.items() if name.startswith(prefix)}
            video = msgspec.convert(given, _Video)
            spans[key] = VideoSpan(FileSlot(video.chunk_index, video.file_index).video(key), video.from_timestamp)
    except msgspec.ValidationError as wrong:
        raise DatasetError(f"its row of the index is wrong: {wrong}") from wrong
    if fields.dataset_to_index - fields.dataset_from_index != fields.length:
        raise DatasetError(
            f"its row of the index contradicts itself: length {fields.length}, "
            f"frames {fields.dataset_from_index} to {fields.dataset_to_index}"
        )
    return EpisodeRow(
        fields.episode_index,
        tuple(fields.tasks or ()),
        fields.length,
        fields.dataset_from_index,
        FileSlot(fields.data_chunk, fields.data_file).data,
        spans,
        figures_in(row),
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


def slot_stated(row: Mapping[str, Any]) -> FileSlot | None:
    """Return the file of the index that a row names as its own; None if it names no file."""
    chunk, file = row.get("meta/episodes/chunk_index"), row.get("meta/episodes/file_index")
    return FileSlot(chunk, file) if isinstance(chunk, int) and isinstance(file, int) else None


def older_row(row: OlderRow, first: int, figures: Mapping[str, Any], info: Info) -> EpisodeRow:
    """Return an episode of version 2. It has separate files, and their names follow from its number."""
    chunk = f"chunk-{row.episode_index // info.chunks_size:03d}"
    name = f"episode_{row.episode_index:06d}"
    return EpisodeRow(
        row.episode_index,
        tuple(row.tasks or ()),
        row.length,
        first,
        Path("data") / chunk / f"{name}.parquet",
        {key: VideoSpan(Path("videos") / chunk / key / f"{name}.mp4", 0.0) for key in info.videos},
        {feature: usable for feature, values in figures.items() if (usable := usable_figures(values))},
    )


def figures_in(row: Mapping[str, Any]) -> dict[str, Figures]:
    """Return the figures in a row of the index. Figures that cannot be used are left out."""
    found: dict[str, Figures] = {}
    for name, value in row.items():
        if name.startswith("stats/") and value is not None:
            feature, _, figure = name.removeprefix("stats/").rpartition("/")
            found.setdefault(feature, {})[figure] = value
    return {feature: usable for feature, values in found.items() if (usable := usable_figures(values))}


def usable_figures(values: object) -> Figures | None:
    """Return figures in one shape, as nested lists; None if a needed one is missing or a shape differs."""
    if not isinstance(values, Mapping):
        return None
    try:
        arrays = {name: np.asarray(value, dtype=np.float64) for name, value in values.items() if value is not None}
        count = np.ravel(arrays.pop("count"))
        shapes = {array.shape for array in arrays.values()}
        if not set(NEEDED) <= arrays.keys() or len(shapes) != 1 or count.size != 1 or not count[0] >= 1:
            return None
        if not next(iter(shapes)):  # a single number
            arrays = {name: array.reshape(1) for name, array in arrays.items()}
        return {name: array.tolist() for name, array in arrays.items()} | {"count": [int(count[0])]}
    except (ValueError, TypeError, KeyError, OverflowError):
        return None
