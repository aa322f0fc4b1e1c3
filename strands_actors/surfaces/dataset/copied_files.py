"""Write the files of a copy of episodes, and compare them with their sources."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from .check import check
from .episode import Quality, index_table
from .errors import DamagedError
from .grouping import common_schema, groups_of, slotted
from .index import Index
from .info import Info
from .layout import DATA_MB, INFO, STATS, TASKS, VIDEO_MB, FileSlot, tasks_table
from .rows import EpisodeRow, VideoSpan, frames_of
from .statistics import PictureStatistics, Statistics, aggregate, of_column
from .tables import integers, is_list, is_same, parquet, refuse_damage
from .video import Span, concatenate, decode_image, pictures_of, setup_of

RENUMBERED = ("episode_index", "index", "task_index")
"""Columns that a copy may number anew."""


class Chosen(msgspec.Struct, frozen=True):
    """An episode that is copied.

    Attributes:
        index: The dataset of the episode.
        number: Its number there.
        task: Its new task. None keeps its tasks.
        mark: Its new mark. None keeps its mark.
    """

    index: Index
    number: int
    task: str | None = None
    mark: str | None = None

    @property
    def row(self) -> EpisodeRow:
        return self.index.rows[self.number]

    @property
    def quality(self) -> Quality:
        quality = self.index.quality.get(self.number, Quality())
        return quality if self.mark is None else msgspec.structs.replace(quality, mark=self.mark)


class _New(msgspec.Struct):
    """An episode that is being copied: its rows in the indexes of the source and of the copy."""

    chosen: Chosen
    source: EpisodeRow
    row: EpisodeRow
    # The number of the episode's file in the copy. The keys are "data" and the key of each video.
    slots: dict[str, FileSlot]
    pictures: dict[str, int]  # A checksum of the episode's pictures, by the key of each video.

    @property
    def root(self) -> Path:
        return self.chosen.index.root


class CopiedFiles:
    """One copy in progress."""

    def __init__(
        self, chosen: Sequence[Chosen], staged: Path, info: Info, document: dict[str, Any], tasks: Sequence[str]
    ) -> None:
        self._info = info
        self._staged = staged
        self._document = document
        self._tasks = list(tasks)
        self.frames = 0
        self._episodes: list[_New] = []
        for number, each in enumerate(chosen):
            row = msgspec.structs.replace(each.row, number=number, first=self.frames)
            self._episodes.append(_New(each, each.row, row, {}, {}))
            self.frames += row.frames
        self._schema = pa.schema([])

    def write(self) -> list[Path]:
        """Write all files, compare them with the source, and return their paths."""
        (self._staged / INFO).parent.mkdir(parents=True)
        self._write_data()
        for key in self._info.videos:
            self._write_videos(key)
        statistics = [self._statistics_of(episode) for episode in self._episodes]
        merged = aggregate(statistics)
        total = merged or (self._episodes[0].chosen.index.statistics() if self._episodes else {})
        self._write(STATS, lambda file: file.write(json.dumps(total, indent=4).encode()))
        self._write(TASKS, parquet(tasks_table(self._tasks)))
        if self._episodes:
            rows = [
                self._row(episode, {key: each[key] for key in merged})
                for episode, each in zip(self._episodes, statistics, strict=True)
            ]
            quality = {
                episode.row.number: msgspec.structs.replace(episode.chosen.quality, pictures=episode.pictures)
                for episode in self._episodes
            }
            self._write(FileSlot(0, 0).episodes, parquet(index_table(rows, quality)))
        totals = {
            "total_episodes": len(self._episodes),
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
        }
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
        paths = [episode.root / episode.source.data for episode in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        self._schema = common_schema(paths)
        for slot, group in slotted(groups_of(sizes, DATA_MB)):
            tables = []
            for number in group:
                episode = self._episodes[number]
                table = self._frames_of(episode)
                tables.append(table)
                episode.slots["data"] = slot
                tasks = (episode.chosen.task,) if episode.chosen.task is not None else episode.row.tasks
                tasks = tasks or tuple(self._tasks[number] for number in np.unique(integers(table, "task_index")))
                episode.row = msgspec.structs.replace(episode.row, data=slot.data, tasks=tasks)
            with refuse_damage(self._staged):
                self._write(slot.data, parquet(*tables))

    def _frames_of(self, episode: _New) -> pa.Table:
        """Return the frames of an episode as the copy has them: numbered anew, with the column types that all
        files share."""
        table = frames_of(episode.root, episode.source)
        with refuse_damage(episode.root / episode.source.data):
            first = np.arange(episode.row.first, episode.row.first + table.num_rows)
            table = _with_column(table, "index", first)
            table = _with_column(table, "episode_index", np.full(table.num_rows, episode.row.number))
            if "task_index" in table.column_names:
                table = _with_column(table, "task_index", self._task_numbers(episode.chosen, table))
            return table.select(self._schema.names).cast(self._schema)

    def _task_numbers(self, chosen: Chosen, table: pa.Table) -> NDArray[np.int64]:
        """Return the number of each frame's task in the copy. A task that is new there gets the next number."""
        before = integers(table, "task_index")
        numbers = before.copy()
        for number in np.unique(before):
            has_name = 0 <= number < len(chosen.index.tasks)
            task = chosen.task if chosen.task is not None else chosen.index.tasks[number] if has_name else None
            if task is None:  # A dataset without a list of tasks.
                continue
            if task not in self._tasks:
                self._tasks.append(task)
            numbers[before == number] = self._tasks.index(task)
        return numbers

    # -- videos

    def _write_videos(self, key: str) -> None:
        fps = self._info.fps
        paths = [episode.root / episode.source.videos[key].path for episode in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        setups = {path: setup_of(path) for path in set(paths)}
        for slot, group in slotted(groups_of(sizes, VIDEO_MB, [setups[path] for path in paths])):
            name = slot.video(key)
            (self._staged / name).parent.mkdir(parents=True, exist_ok=True)
            episodes = [self._episodes[number] for number in group]
            spans = [
                Span(
                    episode.root / episode.source.videos[key].path,
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
            table = frames_of(episode.root, episode.source)
            for key in missing:
                if statistics := self._computed(key, table, episode):
                    by_feature[key] = statistics
        if self._is_renumbered(episode):
            table = self._frames_of(episode)
            for key in by_feature.keys() & set(RENUMBERED):
                by_feature[key] = of_column(integers(table, key))
        return by_feature

    def _is_renumbered(self, episode: _New) -> bool:
        source, row, before = episode.source, episode.row, episode.chosen.index.tasks
        is_same_task = episode.chosen.task is None and self._tasks[: len(before)] == before
        return (source.number, source.first) != (row.number, row.first) or not is_same_task

    def _computed(self, key: str, table: pa.Table, episode: _New) -> Statistics | None:
        row = episode.source
        dtype = self._info.features[key].dtype
        if dtype in ("video", "image"):
            pictures = PictureStatistics()
            images: Iterable[Any] = (
                pictures_of(episode.root / row.videos[key].path)
                if dtype == "video"
                else (decode_image(io.BytesIO(cell["bytes"])) for cell in table[key].to_pylist())
            )
            for picture in images:
                pictures.add(picture)
            return pictures.statistics()
        with refuse_damage(episode.root / row.data):
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
        if result.faults or (copied.total, copied.frames) != (len(self._episodes), self.frames):
            raise DamagedError(f"the copy has {copied.frames} frames of {self.frames}: {result.faults[:1]}")
        for episode in self._episodes:
            written = frames_of(self._staged, copied.rows[episode.row.number])
            if not is_same(written, self._frames_of(episode)):
                raise DamagedError(
                    f"episode {episode.row.number} has other values in the copy than in "
                    f"{episode.root / episode.source.data}"
                )


def _with_column(table: pa.Table, name: str, values: NDArray[Any]) -> pa.Table:
    place = table.schema.get_field_index(name)
    if place < 0:
        return table.append_column(name, pa.array(values))
    return table.set_column(place, name, pa.array(values))


def _first(episode: _New, key: str, fps: float) -> int:
    return round(episode.source.videos[key].start_s * fps)
