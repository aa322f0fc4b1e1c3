"""Copy a dataset into few large files, as LeRobot does. The source is not changed.

Every frame of the copy is read and compared with the source. The copy is made in a temporary folder. At the end
this folder gets the final name, so that an incomplete copy never has this name.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa

from strands_actors.contract.shown import shown

from .check import check
from .episode import Quality, index_table
from .errors import DamagedError, DatasetError
from .index import Index
from .info import Info
from .layout import DATA_MB, INFO, STAGING, STATS, TASKS, VIDEO_MB, FileSlot, tasks_table
from .rows import EpisodeRow, VideoSpan, frames_of
from .statistics import PictureStatistics, Statistics, aggregate, of_column
from .storage import STAGED_SUFFIX, Storage
from .tables import integers, is_list, is_same, parquet, read_schema, refuse_damage
from .video import Span, concatenate, decode_image, pictures_of, setup_of

MB = 1_000_000


class Copied(msgspec.Struct, frozen=True):
    dataset: str
    copy: str
    episodes: int
    frames: int
    files_before: int
    files: int
    bytes: int


class _New(msgspec.Struct):
    """An episode that is being copied: its rows in the indexes of the source and of the copy."""

    source: EpisodeRow
    row: EpisodeRow
    # The number of the episode's file in the copy. The keys are "data" and the key of each video.
    slots: dict[str, FileSlot]
    pictures: dict[str, int]  # A checksum of the episode's pictures, by the key of each video.


def copy_dataset(index: Index, copy: Path, document: dict[str, Any], storage: Storage | None = None) -> Copied:
    """Copy every episode of a dataset.

    Args:
        index: The dataset. It must be undamaged, since every episode is copied.
        copy: The folder of the copy, which must not exist.
        document: The contents of the copy's ``info.json``. The totals are added.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: An episode is damaged, or a frame of the copy differs from its source.
        DatasetError: The folder of the copy exists, or the temporary folder exists.
    """
    storage = storage or Storage()
    index.require_certain()
    check(index).require_sound(index.root)
    if copy.exists():
        raise DatasetError(f"{copy} exists already. Give another name, or remove it")
    staged = copy.with_name(copy.name + STAGED_SUFFIX)
    try:
        staged.mkdir(0o700, parents=True)
    except FileExistsError:
        reason = "another copy is being made, or a copy was interrupted"
        raise DatasetError(f"{staged} exists already: {reason}. Give another name, or remove it") from None
    try:
        files = _Copy(index, staged, document).write()
        for path in files:
            storage.sync_path(path)
        os.rename(staged, copy)
    except BaseException:
        storage.remove(staged)
        raise
    storage.sync_path(copy.parent)
    size = sum(path.stat().st_size for path in copy.rglob("*") if path.is_file())
    before = sum(path.is_file() and STAGING.name not in path.parts for path in index.root.rglob("*"))
    return Copied(str(index.root), str(copy), len(index.rows), index.frames, before, len(files), size)


class _Copy:
    """One copy in progress."""

    def __init__(self, index: Index, staged: Path, document: dict[str, Any]) -> None:
        assert index.info is not None
        self._index = index
        self._info: Info = index.info
        self._staged = staged
        self._document = document
        first = 0
        self._episodes: list[_New] = []
        for number in sorted(index.rows):
            row = index.rows[number]
            self._episodes.append(_New(row, msgspec.structs.replace(row, first=first), {}, {}))
            first += row.frames
        self._frames = first
        self._schema = pa.schema([])

    def write(self) -> list[Path]:
        """Write all files, compare them with the source, and return their paths."""
        (self._staged / INFO).parent.mkdir(parents=True)
        self._write_data()
        for key in self._info.videos:
            self._write_videos(key)
        statistics = [self._statistics_of(episode) for episode in self._episodes]
        merged = aggregate(statistics)
        total = merged or self._index.statistics()
        self._write(STATS, lambda file: file.write(json.dumps(total, indent=4).encode()))
        tasks = self._index.tasks
        self._write(TASKS, parquet(tasks_table(tasks)))
        if self._episodes:
            rows = [
                self._row(episode, {key: each[key] for key in merged})
                for episode, each in zip(self._episodes, statistics, strict=True)
            ]
            quality = {
                episode.row.number: msgspec.structs.replace(
                    self._index.quality.get(episode.row.number, Quality()), pictures=episode.pictures
                )
                for episode in self._episodes
            }
            self._write(FileSlot(0, 0).episodes, parquet(index_table(rows, quality)))
        totals = {"total_episodes": len(self._episodes), "total_frames": self._frames, "total_tasks": len(tasks)}
        document = self._document | totals | {"splits": {"train": f"0:{len(self._episodes)}"}}
        self._write(INFO, lambda file: file.write(json.dumps(document, indent=4).encode()))
        self._verify()
        return sorted(path for path in self._staged.rglob("*") if path.is_file())

    def _write(self, name: Path, fill: Callable[[Any], object]) -> None:
        path = self._staged / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("wb") as file:
            fill(file)

    # -- data

    def _write_data(self) -> None:
        paths = [self._index.root / episode.source.data for episode in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        self._schema = _common_schema(self._index.root, [episode.source.data for episode in self._episodes])
        for slot, group in _slotted(_groups(sizes, DATA_MB)):
            tables = []
            for number in group:
                episode = self._episodes[number]
                table = self._frames_of(episode)
                tables.append(table)
                episode.slots["data"] = slot
                tasks = episode.row.tasks or tuple(
                    self._index.tasks[task_number] for task_number in np.unique(integers(table, "task_index"))
                )
                episode.row = msgspec.structs.replace(episode.row, data=slot.data, tasks=tasks)
            with refuse_damage(self._index.root):
                self._write(slot.data, parquet(*tables))

    def _frames_of(self, episode: _New) -> pa.Table:
        """Return the frames of an episode as the copy has them: numbered anew, with the column types that all
        files share."""
        table = frames_of(self._index.root, episode.source)
        numbers = pa.array(np.arange(episode.row.first, episode.row.first + table.num_rows))
        column = table.schema.get_field_index("index")
        table = table.set_column(column, "index", numbers) if column >= 0 else table.append_column("index", numbers)
        with refuse_damage(self._index.root / episode.source.data):
            return table.select(self._schema.names).cast(self._schema)

    # -- videos

    def _write_videos(self, key: str) -> None:
        fps = self._info.fps
        paths = [self._index.root / episode.source.videos[key].path for episode in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        setups = {path: setup_of(path) for path in set(paths)}
        for slot, group in _slotted(_groups(sizes, VIDEO_MB, [setups[path] for path in paths])):
            name = slot.video(key)
            (self._staged / name).parent.mkdir(parents=True, exist_ok=True)
            episodes = [self._episodes[number] for number in group]
            spans = [
                Span(
                    self._index.root / episode.source.videos[key].path,
                    _first(episode, key, fps),
                    episode.source.frames,
                )
                for episode in episodes
            ]
            sums = concatenate(spans, self._staged / name, fps)
            for episode, checksum in zip(episodes, sums, strict=True):
                episode.pictures[key] = checksum
            before = 0
            for episode in episodes:
                # Divide the number of frames by the rate. Adding durations would accumulate rounding errors.
                episode.row = msgspec.structs.replace(
                    episode.row, videos=episode.row.videos | {key: VideoSpan(name, before / fps)}
                )
                episode.slots[key] = slot
                before += episode.row.frames

    # -- the index

    def _statistics_of(self, episode: _New) -> dict[str, Statistics]:
        """Return the statistics of an episode, as the source has them. Version 2.0 has no statistics, and in
        version 2.1 some may be missing, so compute these."""
        by_feature = {
            key: statistics for key, statistics in episode.source.statistics.items() if key in self._info.features
        }
        missing = [key for key in self._info.features if key not in by_feature] if self._info.is_older else []
        if missing:
            table = frames_of(self._index.root, episode.source)
            for key in missing:
                if statistics := self._computed(key, table, episode.source):
                    by_feature[key] = statistics
        return by_feature

    def _computed(self, key: str, table: pa.Table, row: EpisodeRow) -> Statistics | None:
        dtype = self._info.features[key].dtype
        if dtype in ("video", "image"):
            pictures = PictureStatistics()
            images: Iterable[Any] = (
                pictures_of(self._index.root / row.videos[key].path)
                if dtype == "video"
                else (decode_image(io.BytesIO(cell["bytes"])) for cell in table[key].to_pylist())
            )
            for picture in images:
                pictures.add(picture)
            return pictures.statistics()
        with refuse_damage(self._index.root / row.data):
            values = table[key].combine_chunks()
            while is_list(values.type):
                values = values.flatten()
            numeric = pa.types.is_integer(values.type) or pa.types.is_floating(values.type)
            if not numeric and not pa.types.is_boolean(values.type):
                return None
            return of_column(values.cast(pa.float64()).to_numpy(zero_copy_only=False).reshape(row.frames, -1))

    def _row(self, episode: _New, statistics: dict[str, Statistics]) -> dict[str, Any]:
        row: dict[str, Any] = {
            "episode_index": episode.row.number,
            "tasks": list(episode.row.tasks),
            "length": episode.row.frames,
            "data/chunk_index": episode.slots["data"].chunk,
            "data/file_index": episode.slots["data"].file,
            "dataset_from_index": episode.row.first,
            "dataset_to_index": episode.row.first + episode.row.frames,
        }
        fps = self._info.fps
        for key, span in episode.row.videos.items():
            row |= {
                f"videos/{key}/chunk_index": episode.slots[key].chunk,
                f"videos/{key}/file_index": episode.slots[key].file,
                f"videos/{key}/from_timestamp": span.start_s,
                f"videos/{key}/to_timestamp": (round(span.start_s * fps) + episode.row.frames) / fps,
            }
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        for feature, values in statistics.items():
            row |= {f"stats/{feature}/{name}": value for name, value in values.items()}
        return row

    # -- verification

    def _verify(self) -> None:
        """Read the whole copy, and compare it with the source. Raise ``DamagedError`` if a frame is missing or
        differs."""
        copied = Index(self._staged)
        copied.require_certain()
        result = check(copied)
        result.require_sound(self._staged)
        if result.faults or (copied.total, copied.frames) != (len(self._index.rows), self._index.frames):
            raise DamagedError(f"the copy has {copied.frames} frames of {self._index.frames}: {result.faults[:1]}")
        for episode in self._episodes:
            written = frames_of(self._staged, copied.rows[episode.row.number])
            if not is_same(written, self._frames_of(episode)):
                raise DamagedError(
                    f"episode {episode.row.number} has other values in the copy than in {episode.source.data}"
                )


def _first(episode: _New, key: str, fps: float) -> int:
    return round(episode.source.videos[key].start_s * fps)


def _common_schema(root: Path, paths: Sequence[Path]) -> pa.Schema:
    """Return the columns that all data files have, each with a type that can hold the values of every file.

    Raises:
        DatasetError: A file has other columns than the first file, or the types of a column do not fit
            together.
    """
    common = pa.schema([])
    for path in dict.fromkeys(paths):
        schema = read_schema(root / path)
        column = schema.get_field_index("index")
        number = pa.field("index", pa.int64())
        schema = schema.set(column, number) if column >= 0 else schema.append(number)
        if strange := sorted(set(schema.names) ^ set(common.names)) if common.names else []:
            verb = "has" if strange[0] in schema.names else "lacks"
            raise DatasetError(
                f"{root / path} {verb} the column {shown(strange[0])}, "
                f"unlike {paths[0]}. Give all data files the same columns"
            )
        with refuse_damage(root / path):
            common = pa.unify_schemas([common, schema], promote_options="permissive") if common.names else schema
    return common


def _groups(sizes: Sequence[int], most_mb: float, kinds: Sequence[bytes] = ()) -> Iterator[list[int]]:
    """Divide a sequence of items into groups. Yield the indexes of each group.

    The items of a group follow each other, fit into one file together, and are of the same kind.
    """
    group: list[int] = []
    size = 0
    for number, more in enumerate(sizes):
        is_other = bool(kinds) and bool(group) and kinds[number] != kinds[group[0]]
        if group and (is_other or size + more > most_mb * MB):
            yield group
            group, size = [], 0
        group.append(number)
        size += more
    if group:
        yield group


def _slotted(groups: Iterator[list[int]]) -> Iterator[tuple[FileSlot, list[int]]]:
    slot = FileSlot(0, 0)
    for group in groups:
        yield slot, group
        slot = slot.next
