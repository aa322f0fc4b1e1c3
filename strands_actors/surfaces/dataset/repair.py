"""Repair a dataset after a crash: make episodes of the unfinished ones in staging."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import msgspec

from .dataset import ASIDE, Dataset
from .episode import Episode
from .errors import DatasetError
from .layout import STAGING, read_info
from .staging import read_staged, staged_folders
from .storage import Storage


class Repaired(msgspec.Struct, frozen=True):
    """The result for one staged episode.

    Attributes:
        folder: Its staging folder, or ``finished`` if it was finished and only had to be committed.
        episode: Its number in the dataset; -1 if no part of it could be kept.
        frames: Its number of frames.
        marks: Its defects, in words.
        problem: Why it could not be kept; empty if it was.
    """

    folder: str
    episode: int
    frames: int
    marks: str
    problem: str = ""


class Damage(msgspec.Struct, frozen=True):
    """A counted episode that cannot be used."""

    episode: int
    problem: str


class Report(msgspec.Struct, frozen=True):
    dataset: str
    swept: list[str]  # uncounted files that LeRobot would have read, now in .staging/uncounted
    repaired: list[Repaired]
    dropped: list[str]
    total_episodes: int
    damaged: list[Damage] = []  # can be repaired only by a copy of the file
    faults: list[str] = []  # defects of the whole dataset

    @property
    def is_sound(self) -> bool:
        """True if the dataset has no defects any more."""
        return not self.damaged and not self.faults and not any(one.problem for one in self.repaired)


def require_dataset(root: Path) -> None:
    """Raise ``DatasetError`` if the folder has neither ``info.json`` nor a staging folder."""
    if read_info(root) is None and not (root / STAGING).is_dir():
        raise DatasetError(f"{root} is no dataset: it has no meta/info.json")


def repair(root: Path, drop: bool = False, storage: Storage | None = None) -> Report:
    """Commit the episodes in staging: the finished ones, and the complete frames of the unfinished ones.

    A damaged counted episode is reported and not changed.

    Args:
        root: The folder of the dataset.
        drop: Remove unfinished episodes, and the files that were put aside, instead. Finished episodes
            are kept in any case.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: It is not certain which episodes are counted. Nothing was touched.
        DatasetError: It is no dataset, or another process writes into it.
    """
    require_dataset(root)
    dataset = Dataset(root, storage, accept_damage=True)
    try:
        repaired = [_repaired("finished", episode) for episode in dataset.recovered]
        dropped = []
        for folder in dataset.unfinished():
            if drop:
                dataset.storage.remove(folder)
                dropped.append(folder.name)
            else:
                repaired.append(_repair(dataset, folder))
        aside = dataset.staging / ASIDE
        # If an episode is damaged, its missing frames may be in a file that was put aside.
        if drop and aside.exists() and not dataset.checked.damaged:
            dropped += sorted(str(path.relative_to(aside)) for path in aside.rglob("*") if path.is_file())
            dataset.storage.remove(aside)
        damaged = [Damage(number, why) for number, why in sorted(dataset.checked.damaged.items())]
        return Report(
            str(root), dataset.swept, repaired, dropped, len(dataset.episodes), damaged, dataset.checked.faults
        )
    finally:
        dataset.close()


def _repair(dataset: Dataset, folder: Path) -> Repaired:
    try:
        return _repaired(folder.name, dataset.commit(folder))
    except DatasetError as problem:
        return Repaired(folder.name, -1, 0, "", str(problem))


def _repaired(folder: str, episode: Episode) -> Repaired:
    return Repaired(folder, episode.index, episode.frames, episode.marks.told)


def _written(folder: Path) -> float:
    """Return the time of the last write into a folder, in seconds since the epoch; 0 if it is gone."""
    newest = 0.0
    with contextlib.suppress(FileNotFoundError):
        newest = folder.stat().st_mtime
        for path in folder.iterdir():
            with contextlib.suppress(FileNotFoundError):  # it was renamed to its final place
                newest = max(newest, path.stat().st_mtime)
    return newest


class Unfinished(msgspec.Struct, frozen=True):
    folder: str
    task: str
    frames: int
    seconds_since: float  # since the last write into it
    problem: str = ""


def unfinished_in(root: Path) -> list[Unfinished]:
    """Return the episodes in staging. Nothing is touched, since a recorder may be writing them."""
    found = []
    for folder in staged_folders(root / STAGING):
        since = round(time.time() - _written(folder), 1)
        try:
            staged = read_staged(folder)
        except DatasetError as problem:
            if not folder.exists():  # it was committed or discarded meanwhile
                continue
            found.append(Unfinished(folder.name, "", 0, since, str(problem)))
        else:
            found.append(Unfinished(folder.name, staged.about.task, staged.table.num_rows, since))
    return found
