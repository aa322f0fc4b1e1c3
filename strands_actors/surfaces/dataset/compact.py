"""A copy of a dataset in few files, as large as LeRobot makes them: for the Hub. The dataset itself
is not touched."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from .dataset import Index
from .episode import figures_in, index_table
from .errors import DatasetError
from .layout import DATA_MB, INFO, STAGING, STATS, TASKS, VIDEO_MB, FileSlot, tasks_table
from .statistics import aggregate
from .storage import STAGED_SUFFIX, Storage
from .video import concatenate, setup_of

MB = 1_000_000


class Compacted(msgspec.Struct, frozen=True):
    dataset: str
    copy: str
    episodes: int
    frames: int
    files_before: int
    files: int
    bytes: int


Group = list[int]
"""Numbers of episodes that share a file."""


def compact(root: Path, copy: Path, storage: Storage | None = None) -> Compacted:
    """Raise ``DatasetError`` when there is no dataset, or something is in the place of the copy, or of
    its folder until it is whole."""
    storage = storage or Storage()
    index = Index(root)
    if index.info is None:
        raise DatasetError(f"{root} is no dataset: it has no {INFO}")
    if copy.exists():
        raise DatasetError(f"{copy} is there already. give another name, or remove it")
    staged = copy.with_name(copy.name + STAGED_SUFFIX)
    try:
        staged.mkdir(parents=True)
    except FileExistsError:
        why = "another copy is being made there, or one was ended"
        raise DatasetError(f"{staged} is there already: {why}. give another name, or remove it") from None
    try:
        return _copy(index, staged, copy, storage)
    except BaseException:
        storage.remove(staged)
        raise


def _copy(index: Index, staged: Path, copy: Path, storage: Storage) -> Compacted:
    assert index.info is not None
    root = index.root
    # Of the episodes that the index has, not of those that a recorder has added since.
    (staged / INFO).parent.mkdir(parents=True)
    figures = aggregate([figures_in(row) for row in index.rows]) or json.loads((root / STATS).read_bytes())
    (staged / STATS).write_bytes(json.dumps(figures, indent=4).encode())
    pq.write_table(tasks_table(index.tasks), staged / TASKS, compression="snappy")
    rows = [dict(row) for row in index.rows]
    _join_data(index, rows, staged)
    for key in index.videos:
        _join_videos(index, rows, key, staged)
    for row in rows:
        row |= {"meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0}
    if rows:
        path = staged / FileSlot(0, 0).episodes
        path.parent.mkdir(parents=True)
        pq.write_table(index_table(rows, index.marks), path)
    info = index.info | {"splits": {"train": f"0:{len(rows)}"}}
    (staged / INFO).write_bytes(json.dumps(info, indent=4).encode())
    files = [path for path in staged.rglob("*") if path.is_file()]
    for path in files:
        storage.sync_path(path)
    os.rename(staged, copy)
    storage.sync_path(copy.parent)
    size = sum(path.stat().st_size for path in copy.rglob("*") if path.is_file())
    before = sum(path.is_file() and STAGING.name not in path.parts for path in root.rglob("*"))
    return Compacted(str(root), str(copy), len(rows), index.frames, before, len(files), size)


def _join_data(index: Index, rows: list[dict[str, Any]], staged: Path) -> None:
    for slot, group in _slotted(_groups(rows, [_data_path(index, row) for row in rows], DATA_MB)):
        tables = []
        for number in group:
            table = pq.read_table(_data_path(index, rows[number]))
            tables.append(table.filter(pc.equal(table["episode_index"], number)))
            rows[number] |= {"data/chunk_index": slot.chunk, "data/file_index": slot.file}
        path = staged / slot.data
        path.parent.mkdir(parents=True, exist_ok=True)
        pq.write_table(pa.concat_tables(tables), path, compression="snappy")


def _data_path(index: Index, row: dict[str, Any]) -> Path:
    return index.root / FileSlot(row["data/chunk_index"], row["data/file_index"]).data


def _join_videos(index: Index, rows: list[dict[str, Any]], key: str, staged: Path) -> None:
    assert index.info is not None
    fps = index.info["fps"]
    paths = [
        index.root / FileSlot(row[f"videos/{key}/chunk_index"], row[f"videos/{key}/file_index"]).video(key)
        for row in rows
    ]
    if len(set(paths)) < len(paths):
        raise DatasetError(f"{index.root}: several episodes share a video. it is compact already")
    for slot, group in _slotted(_groups(rows, paths, VIDEO_MB, [setup_of(path) for path in paths])):
        path = staged / slot.video(key)
        path.parent.mkdir(parents=True, exist_ok=True)
        concatenate([paths[number] for number in group], path, fps, [rows[number]["length"] for number in group])
        before = 0
        for number in group:
            length = rows[number]["length"]
            # Divided, not added up: the hundredth episode begins as exactly as the first.
            rows[number] |= {
                f"videos/{key}/chunk_index": slot.chunk,
                f"videos/{key}/file_index": slot.file,
                f"videos/{key}/from_timestamp": before / fps,
                f"videos/{key}/to_timestamp": (before + length) / fps,
            }
            before += length


def _groups(
    rows: Sequence[dict[str, Any]], paths: Sequence[Path], most_mb: int, kinds: Sequence[bytes] = ()
) -> Iterator[Group]:
    """Neighbours that fit into one file, and are of one kind."""
    group: Group = []
    size = 0
    for number in range(len(rows)):
        more = paths[number].stat().st_size
        is_other = bool(kinds) and bool(group) and kinds[number] != kinds[group[0]]
        if group and (is_other or size + more > most_mb * MB):
            yield group
            group, size = [], 0
        group.append(number)
        size += more
    if group:
        yield group


def _slotted(groups: Iterator[Group]) -> Iterator[tuple[FileSlot, Group]]:
    slot = FileSlot(0, 0)
    for group in groups:
        yield slot, group
        slot = slot.next
