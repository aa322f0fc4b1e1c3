"""Compare the data and the videos of a dataset with its index.

The dataset's index lists the episodes and their files. Each data file is read, and the packet index (the list of
the encoded pictures) of each video. Both must have exactly the frames that the dataset's index lists, in the same
order. Otherwise the episode is damaged. Damage of one episode does not affect the others.
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
NO_STATISTICS = "meta/stats.json cannot be read, or lacks statistics"


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
            number, reason = min(self.damaged.items())
            others = [str(each) for each in sorted(self.damaged) if each != number][:20]
            more = f". Damaged, too: {', '.join(others)}" if others else ""
            raise DamagedError(f"{root}: episode {number} is damaged: {reason}{more}. {RESTORE}")


class _Data(msgspec.Struct, frozen=True):
    """The columns of a data file that identify its frames, with one value for each frame."""

    episode: NDArray[np.int64]
    frame: NDArray[np.int64]
    index: NDArray[np.int64]
    task: NDArray[np.int64]
    seconds: NDArray[np.float64]
    # For each column by name: an array that is True for each frame without all its numbers in this column.
    incomplete: dict[str, NDArray[np.bool_]]
    wrong: str  # A defect of all episodes in the file. Empty if there is no such defect.
    unread: str  # Why a part of the file cannot be read. Empty if all was read.


def check(index: Index, read_pictures: bool = True) -> Checked:
    """Compare a dataset with its index. This reads every data file, and the packet index of every video.

    Args:
        index: The dataset.
        read_pictures: Also read the videos to their end, and compare their checksums. Only videos that this
            package has written have checksums.
    """
    result = Checked({}, dict(index.lost), list(index.doubts))
    if index.info is not None:
        _check_data(index, index.info, result)
        for key in index.info.videos:
            _check_videos(index, index.info, key, result, read_pictures)
        _check_neighbours(index, result)
        if index.rows and not index.info.is_older and not index.has_statistics():
            result.faults.append(NO_STATISTICS)
    return result


def _damage(result: Checked, number: int, reason: str, frames: int) -> None:
    result.damaged.setdefault(number, reason)
    result.frames[number] = min(result.frames.get(number, frames), frames)


# -- data


def _check_data(index: Index, info: Info, result: Checked) -> None:
    by_file: dict[Path, list[EpisodeRow]] = defaultdict(list)
    for row in index.rows.values():
        by_file[row.data].append(row)
    elsewhere: dict[Path, Counter[int]] = {}
    for path, rows in sorted(by_file.items()):
        try:
            data = _read(index.root / path, info)
        except DatasetError as damage:
            for row in rows:
                _damage(result, row.number, str(damage), 0)
            continue
        elsewhere[path] = Counter(data.episode.tolist())
        for row in rows:
            frames, reason = _compare(row, data, index, info)
            result.frames[row.number] = frames
            if reason := reason or data.wrong:
                _damage(result, row.number, f"{path}: {reason}", frames)
    _look_elsewhere(index, result, elsewhere)
    for path, counts in elsewhere.items():
        others = sorted(counts.keys() - {row.number for row in by_file[path]})
        if others and path in by_file:
            numbers = ", ".join(map(str, others[:20]))
            result.faults.append(
                f"{index.root / path} has frames of episode {numbers}, but by the index they are in another file"
            )


def _look_elsewhere(index: Index, result: Checked, counters: dict[Path, Counter[int]]) -> None:
    """If another file has the frames of a damaged episode, add its name to the reason of the damage."""
    if not result.damaged:
        return
    every = dict(counters)
    for path in index.stray_files():
        if path.suffix == ".parquet" and path.relative_to(index.root).parts[0] == "data":
            try:
                table = read_table(path)
                with refuse_damage(path):
                    every[path.relative_to(index.root)] = Counter(integers(table, "episode_index").tolist())
            except DatasetError:
                continue  # A damaged file cannot be searched. It is reported as a stray file.
    for number in result.damaged:
        row = index.rows.get(number)
        for path, counts in every.items():
            if row and path != row.data and counts[number] == row.frames:
                result.damaged[number] += f" (its frames are in {path})"


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
    """Find the frames in which numbers are missing.

    Returns:
        For each column with missing numbers, an array that is True for each frame without all its numbers. And
        a text about a defect of all frames, empty if there is no such defect.
    """
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
        elements = np.unique(cells.elements)
        if len(elements) == 1 and elements[0] != width:
            return {}, f"{key} has {elements[0]} numbers, not {width}"
        lacking = (cells.elements != width) | (cells.valid != width)
        if lacking.any():
            incomplete[key] = lacking
    return incomplete, ""


def _compare(row: EpisodeRow, data: _Data, index: Index, info: Info) -> tuple[int, str]:
    """Compare an episode with its data file. Return the number of usable frames, and their defect (empty if
    there is no defect)."""
    (places,) = np.nonzero(data.episode == row.number)
    if len(places) != row.frames:
        reason = f"the file has {len(places)} frames of the episode, but the index lists {row.frames}"
        return min(len(places), row.frames), ". ".join(filter(None, (reason, data.unread)))
    order = np.arange(row.frames)
    if not np.array_equal(places, places[0] + order) or not np.array_equal(data.frame[places], order):
        return row.frames, "its frames are out of order"
    if not info.is_older and not np.array_equal(data.index[places], row.first + order):
        return (
            row.frames,
            f"its frames are numbered from {data.index[places[0]]}, the index has them from {row.first}",
        )
    late = np.abs(data.seconds[places] - order / info.fps)
    # A NaN compares as False. With ``not`` and ``all``, it counts as an error.
    if not bool((late <= DRIFT_S * np.maximum(order, 1)).all()):
        return row.frames, f"its timestamps do not fit {info.fps:g} fps"
    for key, lacking in data.incomplete.items():
        if lacking[places].any():
            index_of_frame = int(np.argmax(lacking[places]))
            return row.frames - int(lacking[places].sum()), f"frame {index_of_frame} has not all numbers of {key}"
    return row.frames, _task_difference(row, data.task[places], index)


def _task_difference(row: EpisodeRow, tasks: NDArray[np.int64], index: Index) -> str:
    if not index.tasks:
        return ""
    numbers = np.unique(tasks).tolist()
    if unknown := [number for number in numbers if not 0 <= number < len(index.tasks)]:
        return f"its task number is {unknown[0]}, but the dataset has only {len(index.tasks)} tasks"
    texts = {index.tasks[number] for number in numbers}
    return "" if not row.tasks or texts <= set(row.tasks) else "its frames have another task than the index"


# -- videos


def _check_videos(index: Index, info: Info, key: str, result: Checked, read_pictures: bool) -> None:
    by_file: dict[Path, list[EpisodeRow]] = defaultdict(list)
    for row in index.rows.values():
        by_file[row.videos[key].path].append(row)
    opened: dict[Path, Pictures] = {}
    for path, rows in sorted(by_file.items()):
        try:
            opened[path] = look(index.root / path)
        except DatasetError as damage:
            for row in rows:
                _damage(result, row.number, str(damage), 0)
            continue
        for row in rows:
            _count_pictures(row, key, path, opened[path], info, result)
        if len(rows) == 1 and opened[path].count > _end(rows[0], key, info):
            reason = f"{path} has {opened[path].count} pictures, but the index lists {_end(rows[0], key, info)}"
            _damage(result, rows[0].number, reason, rows[0].frames)
        rows.sort(key=lambda row: (row.videos[key].start_s, row.number))
        if read_pictures:
            _check_pictures(index, rows, key, path, info, result)
        _check_overlap(rows, key, path, info, result)
    _check_size(by_file, opened, key, info, result)


def _start(row: EpisodeRow, key: str, info: Info) -> int:
    return round(row.videos[key].start_s * info.fps)


def _end(row: EpisodeRow, key: str, info: Info) -> int:
    return _start(row, key, info) + row.frames


def _count_pictures(row: EpisodeRow, key: str, path: Path, has: Pictures, info: Info, result: Checked) -> None:
    pictures = max(0, min(row.frames, has.count - _start(row, key, info)))
    if pictures < row.frames:
        _damage(
            result,
            row.number,
            f"{path} has {pictures} pictures of the episode, but the index lists {row.frames}",
            pictures,
        )
    elif abs(has.seconds - (has.count - 1) / info.fps) > DRIFT_S * has.count:
        _damage(result, row.number, f"{path}: its pictures are not shown at {info.fps:g} fps", row.frames)


def _check_pictures(
    index: Index, rows: list[EpisodeRow], key: str, path: Path, info: Info, result: Checked
) -> None:
    stated = [index.quality[row.number].pictures.get(key) if row.number in index.quality else None for row in rows]
    if any(each is not None for each in stated):
        spans = [(_start(row, key, info), row.frames) for row in rows]
        for row, its, read in zip(rows, stated, checksums(index.root / path, spans, info.fps), strict=True):
            if its is not None and its != read:
                _damage(
                    result, row.number, f"{path}: the pictures have changed since they were recorded", row.frames
                )


def _check_overlap(rows: list[EpisodeRow], key: str, path: Path, info: Info, result: Checked) -> None:
    good = [row for row in rows if row.number not in result.damaged]
    for first, second in itertools.pairwise(good):
        if _start(second, key, info) < _end(first, key, info):
            for row, its in ((first, second), (second, first)):
                _damage(result, row.number, f"{path}: episode {its.number} has the same pictures", row.frames)


def _check_size(
    by_file: dict[Path, list[EpisodeRow]], opened: dict[Path, Pictures], key: str, info: Info, result: Checked
) -> None:
    """Compare the size of the pictures with ``info.json``.

    If all videos have the same size, but not that of ``info.json``, then ``info.json`` is wrong. Otherwise a
    video with another size comes from another camera, and its episodes are damaged.
    """
    stated = info.features[key].height_width
    sizes = {(has.height, has.width) for has in opened.values()}
    text = f"{stated[1]}x{stated[0]}"
    if len(sizes) == 1 and stated not in sizes and len(opened) > 1:
        ((height, width),) = sizes
        result.faults.append(f"{key}: its pictures are {width}x{height}, info.json states {text}")
        return
    for path, has in opened.items():
        if (has.height, has.width) != stated:
            for row in by_file[path]:
                reason = f"{path}: its pictures are {has.width}x{has.height}, info.json states {text}"
                _damage(result, row.number, reason, row.frames)


# -- order


def _check_neighbours(index: Index, result: Checked) -> None:
    """Check that the frame numbers continue from each episode to the next, because LeRobot reads frames by
    number."""
    good = [row for number, row in sorted(index.rows.items()) if number not in result.damaged]
    for before, after in itertools.pairwise(good):
        if after.number == before.number + 1 and after.first != before.first + before.frames:
            end = before.first + before.frames
            result.faults.append(
                f"episode {after.number} begins at frame {after.first}, the one before ends at {end}"
            )
