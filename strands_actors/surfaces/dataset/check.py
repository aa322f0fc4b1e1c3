"""Compare the data and the videos of a dataset with its index.

No file is trusted in what it states about another. Each data file and the index of each video are read. Both
must have the frames that the dataset's index counts, in their order. An episode for which this is not so is
damaged. Damage of one episode does not affect the others.
"""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter, defaultdict
from pathlib import Path

import msgspec
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from .errors import DamagedError, DatasetError
from .index import RESTORE, Index
from .info import Info
from .rows import EpisodeRow
from .tables import integers, numbers_in, read_groups, read_table, refuse_damage
from .video import Pictures, checksums, look

DRIFT_S = 1e-4
"""Greatest accepted difference of a period from 1 / fps, in seconds, as in LeRobot."""
_NUMBER = re.compile(r"(float|u?int)\d+|bool")
NO_FIGURES = "meta/stats.json cannot be read, or lacks figures"


class Checked(msgspec.Struct):
    """The result of a check.

    Attributes:
        frames: Number of readable frames of each episode.
        damaged: Why an episode cannot be used, by its number.
        faults: Other defects, which damage no episode.
    """

    frames: dict[int, int]
    damaged: dict[int, str]
    faults: list[str]

    def require_sound(self, root: Path) -> None:
        """Raise ``DamagedError`` if an episode is damaged."""
        if self.damaged:
            number, why = min(self.damaged.items())
            others = [str(other) for other in sorted(self.damaged) if other != number][:20]
            more = f". Damaged, too: {', '.join(others)}" if others else ""
            raise DamagedError(f"{root}: episode {number} is damaged: {why}{more}. {RESTORE}")


class _Data(msgspec.Struct, frozen=True):
    """The counters of a data file, one value for each frame."""

    episode: NDArray[np.int64]
    frame: NDArray[np.int64]
    index: NDArray[np.int64]
    task: NDArray[np.int64]
    seconds: NDArray[np.float64]
    incomplete: dict[str, NDArray[np.bool_]]  # the frames that lack a number, by the name of the column
    wrong: str  # a defect of all its episodes; empty if there is no such defect
    unread: str  # why a part of it cannot be read; empty if all was read


def check(index: Index, read_pictures: bool = True) -> Checked:
    """Compare a dataset with its index. Reads every data file, and the index of every video.

    Args:
        index: The dataset.
        read_pictures: Read the videos to their end, too, and compare the checksums of recordings and
            copies. Videos of other programs have no checksums; only their pictures are counted.
    """
    found = Checked({}, dict(index.lost), list(index.doubts))
    if index.info is not None:
        _check_data(index, index.info, found)
        for key in index.info.videos:
            _check_videos(index, index.info, key, found, read_pictures)
        _check_neighbours(index, found)
        if index.rows and not index.info.is_older and not index.has_figures():
            found.faults.append(NO_FIGURES)
    return found


def _damage(found: Checked, number: int, why: str, frames: int) -> None:
    found.damaged.setdefault(number, why)
    found.frames[number] = min(found.frames.get(number, frames), frames)


# -- data


def _check_data(index: Index, info: Info, found: Checked) -> None:
    by_file: dict[Path, list[EpisodeRow]] = defaultdict(list)
    for row in index.rows.values():
        by_file[row.data].append(row)
    elsewhere: dict[Path, Counter[int]] = {}
    for path, rows in sorted(by_file.items()):
        try:
            data = _read(index.root / path, info)
        except DatasetError as damage:
            for row in rows:
                _damage(found, row.number, str(damage), 0)
            continue
        elsewhere[path] = Counter(data.episode.tolist())
        for row in rows:
            frames, why = _compare(row, data, index, info)
            found.frames[row.number] = frames
            if why := why or data.wrong:
                _damage(found, row.number, f"{path}: {why}", frames)
    _look_elsewhere(index, found, elsewhere)
    for path, counts in elsewhere.items():
        others = sorted(counts.keys() - {row.number for row in by_file[path]})
        if others and path in by_file:
            numbers = ", ".join(map(str, others[:20]))
            found.faults.append(
                f"{index.root / path} has frames of episode {numbers}, the index has them elsewhere"
            )


def _look_elsewhere(index: Index, found: Checked, counted: dict[Path, Counter[int]]) -> None:
    """Name the file that has the frames of a damaged episode, if there is one."""
    if not found.damaged:
        return
    every = dict(counted)
    for path in index.uncounted():
        if path.suffix == ".parquet" and path.relative_to(index.root).parts[0] == "data":
            try:
                table = read_table(path)
                with refuse_damage(path):
                    every[path.relative_to(index.root)] = Counter(integers(table, "episode_index").tolist())
            except DatasetError:
                continue  # this file is listed among the uncounted ones
    for number in found.damaged:
        row = index.rows.get(number)
        for path, counts in every.items():
            if row and path != row.data and counts[number] == row.frames:
                found.damaged[number] += f" (its frames are in {path})"


def _read(path: Path, info: Info) -> _Data:
    pictures = [key for key, feature in info.features.items() if feature.dtype == "image"]
    table, unread = read_groups(path, without=pictures)
    with refuse_damage(path):
        episode = integers(table, "episode_index")
        frame = integers(table, "frame_index")
        none = np.full(len(episode), -1, np.int64)
        columns = table.column_names
        number = integers(table, "index") if "index" in columns else none
        task = integers(table, "task_index") if "task_index" in columns else none
        seconds = frame / info.fps
        if "timestamp" in columns:
            seconds = np.ravel(table["timestamp"].cast(pa.float64()).to_numpy())
        incomplete, wrong = _read_numbers(table, info)
        return _Data(episode, frame, number, task, seconds, incomplete, wrong, unread)


def _read_numbers(table: pa.Table, info: Info) -> tuple[dict[str, NDArray[np.bool_]], str]:
    """Return which frames lack a number, by the name of the column, and a defect of all frames."""
    incomplete = {}
    for key, feature in info.features.items():
        if feature.dtype in ("video", "image"):
            continue
        if key not in table.column_names:
            return {}, f"it has no column {key}"
        if not _NUMBER.fullmatch(feature.dtype):
            continue
        cells = numbers_in(table[key])
        if cells is None:
            return {}, f"{key} is {table.schema.field(key).type}, info.json states {feature.dtype}"
        width = math.prod(feature.shape)
        counted = np.unique(cells.counted)
        if len(counted) == 1 and counted[0] != width:
            return {}, f"{key} has {counted[0]} numbers, not {width}"
        lacking = (cells.counted != width) | (cells.valid != width)
        if lacking.any():
            incomplete[key] = lacking
    return incomplete, ""


def _compare(row: EpisodeRow, data: _Data, index: Index, info: Info) -> tuple[int, str]:
    """Return how many frames of an episode its data file has, and their defect; empty if there is no
    defect."""
    (places,) = np.nonzero(data.episode == row.number)
    if len(places) != row.frames:
        why = f"it has {len(places)} frames of it, the index counts {row.frames}"
        return min(len(places), row.frames), ". ".join(filter(None, (why, data.unread)))
    order = np.arange(row.frames)
    if not np.array_equal(places, places[0] + order) or not np.array_equal(data.frame[places], order):
        return row.frames, "its frames are out of order"
    if not info.is_older and not np.array_equal(data.index[places], row.first + order):
        return (
            row.frames,
            f"its frames are numbered from {data.index[places[0]]}, the index has them from {row.first}",
        )
    late = np.abs(data.seconds[places] - order / info.fps)
    if not bool((late <= DRIFT_S * np.maximum(order, 1)).all()):  # written so that a NaN fails
        return row.frames, f"its timestamps are not those of {info.fps:g} fps"
    for key, lacking in data.incomplete.items():
        if lacking[places].any():
            at = int(np.argmax(lacking[places]))
            return row.frames - int(lacking[places].sum()), f"frame {at} has not all numbers of {key}"
    return row.frames, _task_difference(row, data.task[places], index)


def _task_difference(row: EpisodeRow, tasks: NDArray[np.int64], index: Index) -> str:
    if not index.tasks:
        return ""
    numbers = np.unique(tasks).tolist()
    if unknown := [number for number in numbers if not 0 <= number < len(index.tasks)]:
        return f"it has task {unknown[0]}, and there are {len(index.tasks)}"
    texts = {index.tasks[number] for number in numbers}
    return "" if not row.tasks or texts <= set(row.tasks) else "its frames have another task than the index"


# -- videos


def _check_videos(index: Index, info: Info, key: str, found: Checked, read_pictures: bool) -> None:
    by_file: dict[Path, list[EpisodeRow]] = defaultdict(list)
    for row in index.rows.values():
        by_file[row.videos[key].path].append(row)
    opened: dict[Path, Pictures] = {}
    for path, rows in sorted(by_file.items()):
        try:
            opened[path] = look(index.root / path)
        except DatasetError as damage:
            for row in rows:
                _damage(found, row.number, str(damage), 0)
            continue
        for row in rows:
            _count_pictures(row, key, path, opened[path], info, found)
        if len(rows) == 1 and opened[path].count > _end(rows[0], key, info):
            why = f"{path}: it has {opened[path].count} pictures, the index counts {_end(rows[0], key, info)}"
            _damage(found, rows[0].number, why, rows[0].frames)
        rows.sort(key=lambda row: (row.videos[key].start_s, row.number))
        if read_pictures:
            _check_pictures(index, rows, key, path, info, found)
        _check_overlap(rows, key, path, info, found)
    _check_size(by_file, opened, key, info, found)


def _start(row: EpisodeRow, key: str, info: Info) -> int:
    return round(row.videos[key].start_s * info.fps)


def _end(row: EpisodeRow, key: str, info: Info) -> int:
    return _start(row, key, info) + row.frames


def _count_pictures(row: EpisodeRow, key: str, path: Path, has: Pictures, info: Info, found: Checked) -> None:
    there = max(0, min(row.frames, has.count - _start(row, key, info)))
    if there < row.frames:
        _damage(found, row.number, f"{path}: it has {there} pictures of it, the index counts {row.frames}", there)
    elif abs(has.seconds - (has.count - 1) / info.fps) > DRIFT_S * has.count:
        _damage(found, row.number, f"{path}: its pictures are not shown at {info.fps:g} fps", row.frames)


def _check_pictures(index: Index, rows: list[EpisodeRow], key: str, path: Path, info: Info, found: Checked) -> None:
    stated = [index.marks[row.number].pictures.get(key) if row.number in index.marks else None for row in rows]
    if any(each is not None for each in stated):
        spans = [(_start(row, key, info), row.frames) for row in rows]
        for row, its, read in zip(rows, stated, checksums(index.root / path, spans, info.fps), strict=True):
            if its is not None and its != read:
                _damage(found, row.number, f"{path}: its pictures are not those that were recorded", row.frames)


def _check_overlap(rows: list[EpisodeRow], key: str, path: Path, info: Info, found: Checked) -> None:
    good = [row for row in rows if row.number not in found.damaged]
    for one, other in itertools.pairwise(good):
        if _start(other, key, info) < _end(one, key, info):
            for row, its in ((one, other), (other, one)):
                _damage(found, row.number, f"{path}: episode {its.number} has the same pictures", row.frames)


def _check_size(
    by_file: dict[Path, list[EpisodeRow]], opened: dict[Path, Pictures], key: str, info: Info, found: Checked
) -> None:
    """Compare the size of the pictures with ``info.json``. If all videos have one other size, ``info.json`` is
    wrong. Otherwise a video with another size is of another camera, and its episodes are damaged."""
    stated = info.features[key].height_width
    sizes = {(has.height, has.width) for has in opened.values()}
    text = f"{stated[1]}x{stated[0]}"
    if len(sizes) == 1 and stated not in sizes and len(opened) > 1:
        ((height, width),) = sizes
        found.faults.append(f"{key}: its pictures are {width}x{height}, info.json states {text}")
        return
    for path, has in opened.items():
        if (has.height, has.width) != stated:
            for row in by_file[path]:
                why = f"{path}: its pictures are {has.width}x{has.height}, info.json states {text}"
                _damage(found, row.number, why, row.frames)


# -- order


def _check_neighbours(index: Index, found: Checked) -> None:
    """Check that each episode begins where its predecessor ends, because LeRobot reads frames by number."""
    good = [row for number, row in sorted(index.rows.items()) if number not in found.damaged]
    for one, other in itertools.pairwise(good):
        if other.number == one.number + 1 and other.first != one.first + one.frames:
            end = one.first + one.frames
            found.faults.append(
                f"episode {other.number} begins at frame {other.first}, the one before ends at {end}"
            )
