"""Copy a dataset into few files, as large as LeRobot makes them. The dataset itself is not touched.

Every written frame is read again and compared with its source. The copy is made in a staged folder and
renamed last, so that an incomplete copy never has the final name.
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
from .episode import Marks, index_table
from .errors import DamagedError, DatasetError
from .index import Index
from .info import Info
from .layout import DATA_MB, INFO, STAGING, STATS, TASKS, VIDEO_MB, FileSlot, tasks_table
from .rows import EpisodeRow, VideoSpan, frames_of
from .statistics import Figures, PictureFigures, aggregate, of_column
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
    """An episode in the source and in the copy."""

    source: EpisodeRow
    row: EpisodeRow
    slots: dict[str, FileSlot]  # the file in the copy, by "data" and by the key of each video
    pictures: dict[str, int]  # a checksum of its pictures, by the key of each video


def copy_dataset(index: Index, copy: Path, document: dict[str, Any], storage: Storage | None = None) -> Copied:
    """Copy every episode of a dataset.

    Args:
        index: The dataset. It must be undamaged, since a copy leaves nothing out.
        copy: The folder of the copy, which must not exist.
        document: The copy's ``info.json``, without its totals.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: An episode is damaged, or a frame of the copy differs from its source.
        DatasetError: The folder of the copy exists, or its staged folder does.
    """
    storage = storage or Storage()
    index.require_certain()
    check(index).require_sound(index.root)
    if copy.exists():
        raise DatasetError(f"{copy} is there already. give another name, or remove it")
    staged = copy.with_name(copy.name + STAGED_SUFFIX)
    try:
        staged.mkdir(0o700, parents=True)
    except FileExistsError:
        why = "another copy is being made there, or one was ended"
        raise DatasetError(f"{staged} is there already: {why}. give another name, or remove it") from None
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
        """Write all files, compare them with the source, and return them."""
        (self._staged / INFO).parent.mkdir(parents=True)
        self._write_data()
        for key in self._info.videos:
            self._write_videos(key)
        figures = [self._figures_of(one) for one in self._episodes]
        merged = aggregate(figures)
        total = merged or self._index.figures()
        self._write(STATS, lambda file: file.write(json.dumps(total, indent=4).encode()))
        tasks = self._index.tasks
        self._write(TASKS, parquet(tasks_table(tasks)))
        if self._episodes:
            rows = [
                self._row(one, {key: each[key] for key in merged})
                for one, each in zip(self._episodes, figures, strict=True)
            ]
            marks = {
                one.row.number: msgspec.structs.replace(
                    self._index.marks.get(one.row.number, Marks()), pictures=one.pictures
                )
                for one in self._episodes
            }
            self._write(FileSlot(0, 0).episodes, parquet(index_table(rows, marks)))
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
        paths = [self._index.root / one.source.data for one in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        self._schema = _common_schema(self._index.root, [one.source.data for one in self._episodes])
        for slot, group in _slotted(_groups(sizes, DATA_MB)):
            tables = []
            for number in group:
                one = self._episodes[number]
                table = self._frames_of(one)
                tables.append(table)
                one.slots["data"] = slot
                tasks = one.row.tasks or tuple(
                    self._index.tasks[at] for at in np.unique(integers(table, "task_index"))
                )
                one.row = msgspec.structs.replace(one.row, data=slot.data, tasks=tasks)
            with refuse_damage(self._index.root):
                self._write(slot.data, parquet(*tables))

    def _frames_of(self, one: _New) -> pa.Table:
        """Return the frames of an episode for the copy: with new numbers, and the common types."""
        table = frames_of(self._index.root, one.source)
        numbers = pa.array(np.arange(one.row.first, one.row.first + table.num_rows))
        at = table.schema.get_field_index("index")
        table = table.set_column(at, "index", numbers) if at >= 0 else table.append_column("index", numbers)
        with refuse_damage(self._index.root / one.source.data):
            return table.select(self._schema.names).cast(self._schema)

    # -- videos

    def _write_videos(self, key: str) -> None:
        fps = self._info.fps
        paths = [self._index.root / one.source.videos[key].path for one in self._episodes]
        shared = {path: paths.count(path) for path in set(paths)} if len(set(paths)) < len(paths) else {}
        sizes = [path.stat().st_size // shared.get(path, 1) for path in paths]
        setups = {path: setup_of(path) for path in set(paths)}
        for slot, group in _slotted(_groups(sizes, VIDEO_MB, [setups[path] for path in paths])):
            name = slot.video(key)
            (self._staged / name).parent.mkdir(parents=True, exist_ok=True)
            ones = [self._episodes[number] for number in group]
            spans = [
                Span(self._index.root / one.source.videos[key].path, _first(one, key, fps), one.source.frames)
                for one in ones
            ]
            sums = concatenate(spans, self._staged / name, fps)
            for one, checksum in zip(ones, sums, strict=True):
                one.pictures[key] = checksum
            before = 0
            for one in ones:
                # Compute the start by one division. A sum of durations would collect rounding errors.
                one.row = msgspec.structs.replace(
                    one.row, videos=one.row.videos | {key: VideoSpan(name, before / fps)}
                )
                one.slots[key] = slot
                before += one.row.frames

    # -- the index

    def _figures_of(self, one: _New) -> dict[str, Figures]:
        """Return the source's figures. For version 2, missing ones are computed (2.0 has no figures)."""
        found = {key: figures for key, figures in one.source.figures.items() if key in self._info.features}
        missing = [key for key in self._info.features if key not in found] if self._info.is_older else []
        if missing:
            table = frames_of(self._index.root, one.source)
            for key in missing:
                if figures := self._computed(key, table, one.source):
                    found[key] = figures
        return found

    def _computed(self, key: str, table: pa.Table, row: EpisodeRow) -> Figures | None:
        kind = self._info.features[key].dtype
        if kind in ("video", "image"):
            pictures = PictureFigures()
            images: Iterable[Any] = (
                pictures_of(self._index.root / row.videos[key].path)
                if kind == "video"
                else (decode_image(io.BytesIO(cell["bytes"])) for cell in table[key].to_pylist())
            )
            for picture in images:
                pictures.add(picture)
            return pictures.figures()
        with refuse_damage(self._index.root / row.data):
            values = table[key].combine_chunks()
            while is_list(values.type):
                values = values.flatten()
            numeric = pa.types.is_integer(values.type) or pa.types.is_floating(values.type)
            if not numeric and not pa.types.is_boolean(values.type):
                return None
            return of_column(values.cast(pa.float64()).to_numpy(zero_copy_only=False).reshape(row.frames, -1))

    def _row(self, one: _New, figures: dict[str, Figures]) -> dict[str, Any]:
        row: dict[str, Any] = {
            "episode_index": one.row.number,
            "tasks": list(one.row.tasks),
            "length": one.row.frames,
            "data/chunk_index": one.slots["data"].chunk,
            "data/file_index": one.slots["data"].file,
            "dataset_from_index": one.row.first,
            "dataset_to_index": one.row.first + one.row.frames,
        }
        fps = self._info.fps
        for key, span in one.row.videos.items():
            row |= {
                f"videos/{key}/chunk_index": one.slots[key].chunk,
                f"videos/{key}/file_index": one.slots[key].file,
                f"videos/{key}/from_timestamp": span.start_s,
                f"videos/{key}/to_timestamp": (round(span.start_s * fps) + one.row.frames) / fps,
            }
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
        for feature, values in figures.items():
            row |= {f"stats/{feature}/{name}": value for name, value in values.items()}
        return row

    # -- verification

    def _verify(self) -> None:
        """Read the copy like any dataset. Raise ``DamagedError`` if a frame is missing or differs."""
        copied = Index(self._staged)
        copied.require_certain()
        found = check(copied)
        found.require_sound(self._staged)
        if found.faults or (copied.total, copied.frames) != (len(self._index.rows), self._index.frames):
            raise DamagedError(f"the copy has {copied.frames} frames of {self._index.frames}: {found.faults[:1]}")
        for one in self._episodes:
            written = frames_of(self._staged, copied.rows[one.row.number])
            if not is_same(written, self._frames_of(one)):
                raise DamagedError(
                    f"episode {one.row.number} has other values in the copy than in {one.source.data}"
                )


def _first(one: _New, key: str, fps: float) -> int:
    return round(one.source.videos[key].start_s * fps)


def _common_schema(root: Path, paths: Sequence[Path]) -> pa.Schema:
    """Return the columns of every file, in types that hold the values of each.

    Raises:
        DatasetError: A file has other columns than the first, or types that cannot be unified.
    """
    common = pa.schema([])
    for path in dict.fromkeys(paths):
        schema = read_schema(root / path)
        at = schema.get_field_index("index")
        number = pa.field("index", pa.int64())
        schema = schema.set(at, number) if at >= 0 else schema.append(number)
        if strange := sorted(set(schema.names) ^ set(common.names)) if common.names else []:
            which = "has" if strange[0] in schema.names else "lacks"
            raise DatasetError(
                f"{root / path} {which} the column {shown(strange[0])}, unlike {paths[0]}. Make them the same"
            )
        with refuse_damage(root / path):
            common = pa.unify_schemas([common, schema], promote_options="permissive") if common.names else schema
    return common


def _groups(sizes: Sequence[int], most_mb: float, kinds: Sequence[bytes] = ()) -> Iterator[list[int]]:
    """Yield groups of successive numbers. The items of a group fit into one file and are of one kind."""
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
