"""Copy the episodes that a second place lacks, and compare the written files.

The second place is a dataset with the same files as the first. The files of an episode are written and read back,
and then ``info.json``, which counts the episode. So a killed copy leaves only complete episodes that are counted,
and files that the next copy completes. The names of the files are those of the dataset. So no episode can be there
twice.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec

from strands_actors.surfaces.dataset.check import check
from strands_actors.surfaces.dataset.compact import open_newest
from strands_actors.surfaces.dataset.errors import DatasetError
from strands_actors.surfaces.dataset.index import RESTORE, Index, files_of
from strands_actors.surfaces.dataset.info import Info, decode_info
from strands_actors.surfaces.dataset.layout import INFO, STATS, TASKS, difference_of, is_own_name
from strands_actors.surfaces.dataset.storage import Lock

from .place import CHUNK, Place, PlaceError, Source


class Brought(msgspec.Struct, frozen=True):
    """The result of a copy.

    Attributes:
        dataset: The dataset.
        place: The second place.
        episodes: Number of episodes that are complete there.
        of: Number of episodes of the dataset.
        copied: Number of episodes of which at least one file was written.
        bytes: Number of bytes that were written.
        uncounted: Files there that no episode has, and that LeRobot would read.
    """

    dataset: str
    place: str
    episodes: int
    of: int
    copied: int
    bytes: int
    uncounted: list[str] = []


def copy_all(root: Path, place: Place, verify: bool, progress: Callable[[int, int], None]) -> Brought:
    """Copy the files that the place lacks. First check the whole dataset, so that no damaged file is copied.

    Args:
        root: The folder of the dataset.
        place: The second place.
        verify: Also read every file of the place, and replace those that differ.
        progress: Called with the number of episodes that are complete there, and of all episodes.

    Raises:
        DamagedError: An episode of the dataset is damaged. Nothing was written.
        DatasetError: The folder is not a dataset, or the place has another one.
        PlaceError: The place cannot be used at the moment.
    """
    index, _ = open_newest(root)
    check(index).require_sound(root)
    return bring(index, place, verify, progress)


def bring(
    index: Index, place: Place, verify: bool = False, progress: Callable[[int, int], None] = lambda there, of: None
) -> Brought:
    """Copy the files that the place lacks, as ``copy_all``, without a check of the dataset's files."""
    index.require_certain()
    with _only_copy(index.root):
        return _bring(index, place, verify, progress)


def _bring(index: Index, place: Place, verify: bool, progress: Callable[[int, int], None]) -> Brought:
    files = place.sizes()
    counted = _counted(index, place, files)
    of = len(index.rows)
    copied = written = there = 0
    progress(counted, of)
    for number in sorted(index.rows):
        lacking = [name for name in _files(index, number) if not _has(index.root, place, files, name, verify)]
        sources: dict[str, Source] = {name: index.root / name for name in lacking}
        if lacking or number >= counted:
            counting = _counting(index, number + 1)
            note = f"Add episode {number}" if number >= counted else f"Restore episode {number}"
            if number < counted:
                counting = {}
            _put(place, sources, counting, note)
            files |= {name: _size(source) for name, source in (sources | counting).items()}
            written += sum(_size(source) for source in (sources | counting).values())
            copied += 1
        there = number + 1
        progress(there, of)
    if verify or there == counted:
        # An earlier copy may have ended before it wrote these small files anew, or they were damaged.
        totals = _counting(index, of)
        if stale := {name: data for name, data in totals.items() if not _is_equal(place, files, name, data)}:
            _put(place, {}, stale, "Update totals")
            written += sum(map(_size, stale.values()))
    names = {name for number in index.rows for name in _files(index, number)}
    uncounted = sorted(name for name in files if is_own_name(Path(name)) and name not in names)
    return Brought(str(index.root), place.url, there, of, copied, written, uncounted)


def _counted(index: Index, place: Place, files: Mapping[str, int]) -> int:
    """Return how many episodes the place counts. Raise ``DatasetError`` if it has episodes of another dataset."""
    assert index.info is not None
    ours = {name for number in index.rows for name in _files(index, number)}
    if str(INFO) not in files:
        if strange := sorted(name for name in files if is_own_name(Path(name)) and name not in ours):
            raise DatasetError(
                f"{place.url} has no {INFO}, but files of another dataset: {strange[0]}. Give another place"
            )
        return 0
    with place.open(str(INFO)) as file:
        info = decode_info(file.read(), f"{place.url}/{INFO}")
    reason = _contradiction(index.info, info)
    if not reason and (info.total_episodes or 0) > len(index.rows):
        reason = f"it has {info.total_episodes} episodes, and {index.root} has {len(index.rows)}"
    total = info.total_episodes or 0
    if not reason and total:
        # Two datasets of the same robot differ in the statistics of each episode, which the index has.
        for number in {0, total - 1}:
            path = index.index_files[number]
            if str(path) in files and not _is_equal(place, files, str(path), index.root / path):
                reason = f"its episode {number} is another one"
    if reason:
        raise DatasetError(f"{place.url} has another dataset than {index.root}: {reason}. Give another place")
    return total


def _contradiction(ours: Info, theirs: Info) -> str:
    if theirs.codebase_version != ours.codebase_version:
        return f"its version is {theirs.codebase_version}"
    if theirs.robot_type != ours.robot_type:
        return f"it is of the robot {theirs.robot_type}, not {ours.robot_type}"
    if theirs.fps != ours.fps:
        return f"it has {theirs.fps:g} fps, not {ours.fps:g}"
    return difference_of(ours.features, theirs.features)


def _files(index: Index, number: int) -> Iterator[str]:
    """Yield the names of an episode's files. Videos are first and the index is last, as in a commit."""
    data, *videos = files_of(index.rows[number])
    yield from map(str, (*videos, data, index.index_files[number]))


def _counting(index: Index, episodes: int) -> dict[str, Source]:
    """Return the files that count the first ``episodes`` episodes. ``info.json`` is the last."""
    assert index.info is not None
    frames = sum(index.rows[number].frames for number in sorted(index.rows)[:episodes])
    totals: dict[str, Any] = {"total_episodes": episodes, "total_frames": frames}
    if episodes < len(index.rows):
        totals["splits"] = {"train": f"0:{episodes}"}
    files: dict[str, Source] = {
        str(name): path.read_bytes() for name in (TASKS, STATS) if (path := index.root / name).exists()
    }
    return files | {str(INFO): json.dumps(index.info.document | totals, indent=4).encode()}


def _put(place: Place, sources: Mapping[str, Source], counting: Mapping[str, Source], note: str) -> None:
    """Write the files of an episode, read them back, and then write the files that count it."""
    if place.is_atomic:
        place.put({**sources, **counting}, note)
    elif sources:
        place.put(sources, note)
    for name, source in sources.items():
        if not _is_same(place, name, source):
            raise PlaceError(f"{place.url}: {name} differs from the file that was written. Copy it again")
    if counting and not place.is_atomic:
        place.put(counting, note)


def _has(root: Path, place: Place, files: Mapping[str, int], name: str, verify: bool) -> bool:
    return files.get(name) == _size(root / name) and (not verify or _is_same(place, name, root / name))


def _is_equal(place: Place, files: Mapping[str, int], name: str, source: Source) -> bool:
    return files.get(name) == _size(source) and _is_same(place, name, source)


def _is_same(place: Place, name: str, source: Source) -> bool:
    """Read a file of the place, and compare it with its source."""
    with place.open(name) as file:
        if isinstance(source, bytes):
            return file.read() == source
        with source.open("rb") as original:
            while (expected := original.read(CHUNK)) == (read := _read(file, CHUNK)):
                if not expected and not read:
                    return True
    return False


def _read(file: Any, size: int) -> bytes:
    """Read exactly ``size`` bytes, or all up to the end. A file of a store may return fewer at a time."""
    pieces = b""
    while len(pieces) < size and (piece := file.read(size - len(pieces))):
        pieces += piece
    return pieces


def _size(source: Source) -> int:
    if isinstance(source, bytes):
        return len(source)
    try:
        return source.stat().st_size
    except OSError as failure:
        raise DatasetError(f"{source} cannot be read: {failure.strerror}. {RESTORE}") from failure


@contextlib.contextmanager
def _only_copy(root: Path) -> Iterator[None]:
    """Let one process at a time copy a dataset. Otherwise an older process could count fewer episodes again."""
    try:
        lock = Lock(root / INFO.parent)
    except DatasetError as taken:
        raise PlaceError(f"another process copies {root}. Wait for its end") from taken
    try:
        yield
    finally:
        lock.release()
