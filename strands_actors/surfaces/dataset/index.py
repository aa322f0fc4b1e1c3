"""Read which episodes a dataset has, from ``info.json``, the index of the episodes and the list of tasks.

If a table of the index is damaged, its episodes are listed as lost, and the other episodes are read. The data
and the videos are not read here: ``check`` compares them with the index.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from strands_actors.contract.lfs import pointer_reason

from .episode import Episode, Quality, decode_quality
from .errors import DamagedError, DatasetError
from .info import Info
from .layout import DATA_PATH, INFO, STATS, TASKS, VIDEO_PATH, FileSlot, is_own_name, read_info, tasks_of
from .rows import (
    EpisodeRow,
    OlderRow,
    OlderStatistics,
    OlderTask,
    decode_row,
    older_row,
    slot_stated,
    usable_statistics,
)
from .storage import STAGED_SUFFIX
from .tables import JSON_DAMAGE, decode_json, read_rows, read_table, refuse_damage

EPISODES = "meta/episodes.jsonl"
OLDER_TASKS = "meta/tasks.jsonl"
OLDER_STATS = "meta/episodes_stats.jsonl"
OLDER_PATHS = (
    "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
    "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
)
Line = TypeVar("Line")


class Index:
    """The committed episodes of a dataset. ``info.json`` states how many there are.

    Attributes:
        info: The decoded ``info.json``, or None if there is no such file.
        rows: The episodes with a readable row in the index, by number.
        lost: The reason why an episode has no readable row in the index, by the episode's number.
        marks: The recorder's notes on the quality of each episode, by the episode's number.
        tasks: The tasks, in the order of their numbers.
        files: Every file that a committed episode needs.
        index_files: The file of the index with the row of each episode, relative to the dataset, by the episode's
            number.
        doubts: Reasons why it is not certain which episodes the dataset has. If there is a reason, no file may
            be written or moved.
    """

    def __init__(self, root: Path) -> None:
        """Read the index.

        Args:
            root: The folder of the dataset.

        Raises:
            DatasetError: ``info.json`` cannot be used.
        """
        self.root = root
        self.info = read_info(root)
        self.rows: dict[int, EpisodeRow] = {}
        self.lost: dict[int, str] = {}
        self.quality: dict[int, Quality] = {}
        self.tasks: list[str] = []
        self.files: set[Path] = set()
        self.index_files: dict[int, Path] = {}
        self.doubts: list[str] = []
        self._unread: list[str] = []
        if self.info is None:
            return
        self._require_supported_paths(self.info)
        if self.info.is_older:
            self._read_older(self.info)
        else:
            self._read(self.info)
        self._compare(self.info)
        self.files |= {root / path for row in self.rows.values() for path in files_of(row)}

    @property
    def frames(self) -> int:
        return sum(row.frames for row in self.rows.values())

    @property
    def total(self) -> int:
        """Number of committed episodes, including those without a readable row."""
        return len(self.rows) + len(self.lost)

    @property
    def episodes(self) -> list[Episode]:
        return [
            Episode(number, ", ".join(row.tasks), row.frames, self.quality.get(number, Quality()))
            for number, row in sorted(self.rows.items())
        ]

    def has_statistics(self) -> bool:
        """Return True if ``stats.json`` is complete: it has usable statistics of each feature that has
        statistics in every episode."""
        statistics = self.statistics()
        stated = set.intersection(*(set(row.statistics) for row in self.rows.values())) if self.rows else set()
        return bool(statistics) and all(usable_statistics(statistics.get(key)) for key in stated)

    def statistics(self) -> dict[str, Any]:
        """Return the statistics in ``stats.json``. Empty if the file cannot be read."""
        try:
            return decode_json((self.root / STATS).read_bytes(), dict[str, Any])
        except (OSError, *JSON_DAMAGE):
            return {}

    def require_certain(self) -> None:
        """Raise ``DamagedError`` unless it is certain which episodes are committed."""
        reasons = [*(f"episode {number}: {reason}" for number, reason in sorted(self.lost.items())), *self.doubts]
        if reasons:
            more = f" ({len(reasons) - 1} more)" if len(reasons) > 1 else ""
            raise DamagedError(f"{self.root} is damaged, and was not touched: {reasons[0]}{more}. {RESTORE}")

    def stray_files(self) -> list[Path]:
        """Return the files that no committed episode needs and that LeRobot could read."""
        paths = [
            path for path in self.root.glob("meta/*" + STAGED_SUFFIX) if is_own_name(path.relative_to(self.root))
        ]
        for pattern in ("data/*/*.parquet", "meta/episodes/*/*.parquet", "videos/*/*/*.mp4"):
            paths += [path for path in self.root.glob(pattern) if path not in self.files]
        return sorted(paths)

    def last_slot(self) -> FileSlot | None:
        """Return the highest file number in use, or None if there are no files. A new file must have a higher
        number, so that it replaces no other file."""
        every = self.files.union(path for path in self.stray_files() if path.suffix != STAGED_SUFFIX)
        names = [path for path in every if is_own_name(path.relative_to(self.root))]
        slots = [FileSlot(int(path.parent.name[6:]), int(path.stem[5:])) for path in names]
        return max(slots, default=None)

    # -- version 3

    def _read(self, info: Info) -> None:
        rows_by_number: dict[int, list[tuple[Path, dict[str, Any]]]] = defaultdict(list)
        in_order: list[int] = []
        for path in sorted((self.root / "meta/episodes").glob("*/[!.]*.parquet")):
            try:
                table = read_rows(path)
                numbers = msgspec.convert([row.get("episode_index") for row in table.rows], list[int])
                quality = decode_quality(table.metadata)
            except (DatasetError, msgspec.MsgspecError) as damage:
                self._unread.append(_describe(path, damage))
                continue
            committed = [n for n in numbers if info.total_episodes is None or 0 <= n < info.total_episodes]
            if 0 < len(committed) < len(numbers):
                self.doubts.append(
                    f"{path} lists more episodes than {INFO}, so the program that wrote it did not finish"
                )
            for number, row in zip(numbers, table.rows, strict=True):
                if number in committed:
                    rows_by_number[number].append((path, row))
            self.quality |= quality
            in_order += committed
        for number, candidates in rows_by_number.items():
            self._choose(info, number, candidates)
        numbers = sorted(rows_by_number)
        if in_order != numbers and sorted(in_order) == numbers:
            self.doubts.append(f"{self.root / 'meta/episodes'}: the episodes are out of order: {in_order[:20]}")
        self._read_tasks(info)

    def _choose(self, info: Info, number: int, candidates: list[tuple[Path, dict[str, Any]]]) -> None:
        """Select the row of an episode. If the index has several rows of it, use the row that names the file in
        which it stands."""
        own = [each for each in candidates if _is_in_its_file(self.root, *each)]
        path, row = (own or candidates)[0]
        if len(own or candidates) > 1:
            self.doubts.append(f"{path}: the index has episode {number} {len(own or candidates)} times")
        self.files.add(path)
        self.index_files[number] = path.relative_to(self.root)
        try:
            self.rows[number] = decode_row(row, info)
        except DatasetError as wrong:
            self.lost[number] = f"{path}: {wrong}"

    def _read_tasks(self, info: Info) -> None:
        if not self.rows and not (self.root / TASKS).exists():
            return  # A dataset without episodes may have no list of tasks.
        try:
            table = read_table(self.root / TASKS)
            with refuse_damage(self.root / TASKS):
                tasks = tasks_of(table)
        except DatasetError as damage:
            self.doubts.append(str(damage))
            return
        self.tasks = tasks[: info.total_tasks]

    # -- version 2

    def _read_older(self, info: Info) -> None:
        tasks = sorted(self._lines(OLDER_TASKS, OlderTask), key=lambda task: task.task_index)
        is_numbered = [task.task_index for task in tasks] == list(range(len(tasks)))
        if not is_numbered:
            self.doubts.append(f"{self.root / OLDER_TASKS} does not number its tasks from 0")
        self.tasks = [task.task for task in tasks] if is_numbered and not self._unread else []
        rows = sorted(self._lines(EPISODES, OlderRow), key=lambda row: row.episode_index)
        has_stats = (self.root / OLDER_STATS).exists()  # Version 2.0 has no statistics of episodes.
        statistics = (
            {line.episode_index: line.stats for line in self._lines(OLDER_STATS, OlderStatistics)}
            if has_stats
            else {}
        )
        first = 0
        for row in rows:
            if row.episode_index in self.rows:
                self.doubts.append(f"{self.root / EPISODES} has episode {row.episode_index} twice")
            self.rows[row.episode_index] = older_row(row, first, statistics.get(row.episode_index, {}), info)
            first += row.length

    def _lines(self, name: str, line_type: type[Line]) -> list[Line]:
        path = self.root / name
        try:
            pointer = pointer_reason(path)
            data = path.read_bytes().splitlines()
        except OSError as failure:
            self._unread.append(f"{path} cannot be read: {failure.strerror}")
            return []
        if pointer:
            self._unread.append(pointer)
            return []
        lines = []
        for number, line in enumerate(data, 1):
            try:
                lines += [decode_json(line, line_type)] if line.strip() else []
            except JSON_DAMAGE as damage:
                self._unread.append(f"{path}, line {number}: {damage}")
        return lines

    # -- both

    def _require_supported_paths(self, info: Info) -> None:
        supported = OLDER_PATHS if info.is_older else (DATA_PATH, VIDEO_PATH)
        for stated, path in zip((info.data_path, info.video_path), supported, strict=True):
            if stated is not None and stated != path:
                raise DatasetError(
                    f"{self.root / INFO}: the file names {stated!r} are not supported, only {path!r}"
                )

    def _compare(self, info: Info) -> None:
        """Compare the numbers of episodes, frames and tasks in ``info.json`` with the index."""
        self.doubts += self._unread
        if not self.doubts and len(self.tasks) < (tasks := info.total_tasks or min(1, len(self.rows))):
            self.doubts.append(f"{self.root} has {len(self.tasks)} tasks, and it should have {tasks}")
        committed = len(self.rows) + len(self.lost)
        total = committed if info.total_episodes is None else info.total_episodes
        unread = f" ({'. '.join(self._unread)})" if self._unread else ""
        missing = [
            number for number in range(min(total, MOST)) if number not in self.rows and number not in self.lost
        ]
        self.lost |= dict.fromkeys(missing[: committed + MOST_LOST], f"the index has no row of it{unread}")
        if total != committed:
            self.doubts.append(
                f"{self.root}: {INFO} counts {total} episodes, the index has {committed} of them{unread}"
            )
        if not self.lost and info.total_frames is not None and info.total_frames != self.frames:
            frames = f"{INFO} counts {info.total_frames} frames, the index {self.frames}"
            self.doubts.append(f"{self.root}: {frames}")


MOST = 1_000_000
MOST_LOST = 10_000
"""At most so many episodes without a row are listed, since a damaged ``info.json`` may count any number."""
RESTORE = "Put the file back from a copy. `strands-actors dataset show` lists all that is wrong"


def files_of(row: EpisodeRow) -> Sequence[Path]:
    """Return the paths of an episode's data and videos, relative to the dataset."""
    return (row.data, *(span.path for span in row.videos.values()))


def _is_in_its_file(root: Path, path: Path, row: dict[str, Any]) -> bool:
    slot = slot_stated(row)
    return slot is not None and path == root / slot.episodes


def _describe(path: Path, damage: Exception) -> str:
    return str(damage) if isinstance(damage, DatasetError) else f"{path} cannot be read: {damage}"
