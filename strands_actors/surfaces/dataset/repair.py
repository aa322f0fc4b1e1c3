"""What an episode that was not finished leaves, and how it becomes one."""

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
    """What became of one episode. ``episode``: its number, -1 when nothing of it could be kept."""

    folder: str
    episode: int
    frames: int
    marks: str
    problem: str = ""


class Damage(msgspec.Struct, frozen=True):
    """An episode that is counted, and that cannot be used."""

    episode: int
    problem: str


class Report(msgspec.Struct, frozen=True):
    dataset: str
    swept: list[str]  # what nothing counted, and LeRobot would have read: it lies in .staging/uncounted
    repaired: list[Repaired]
    dropped: list[str]
    total_episodes: int
    damaged: list[Damage] = []  # what only a copy of the file can repair
    faults: list[str] = []  # what is wrong with the dataset as a whole

    @property
    def is_sound(self) -> bool:
        """Whether nothing is wrong with the dataset any more."""
        return not self.damaged and not self.faults and not any(one.problem for one in self.repaired)


def require_dataset(root: Path) -> None:
    """Raise ``DatasetError`` when there is none."""
    if read_info(root) is None and not (root / STAGING).is_dir():
        raise DatasetError(f"{root} is no dataset: it has no meta/info.json")


def repair(root: Path, drop: bool = False, storage: Storage | None = None) -> Report:
    """Make episodes of what is in staging; with ``drop`` remove what nobody finished instead, and
    what was put aside. What was finished is kept in any case.

    A damaged episode is named and left as it is.

    Raises:
        DamagedError: It is not certain what the dataset counts. Nothing was touched.
        DatasetError: It is no dataset, or another process writes into it.
    """
    require_dataset(root)
    dataset = Dataset(root, storage, accept_damage=True)
    try:
        repaired = [_told("finished", episode) for episode in dataset.recovered]
        dropped = []
        for folder in dataset.unfinished():
            if drop:
                dataset.storage.remove(folder)
                dropped.append(folder.name)
            else:
                repaired.append(_repair(dataset, folder))
        aside = dataset.staging / ASIDE
        if drop and aside.exists() and not dataset.checked.damaged:  # a damaged episode may lack it
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
        return _told(folder.name, dataset.commit(folder))
    except DatasetError as problem:
        return Repaired(folder.name, -1, 0, "", str(problem))


def _told(folder: str, episode: Episode) -> Repaired:
    return Repaired(folder, episode.index, episode.frames, episode.marks.told)


def _written(folder: Path) -> float:
    """When something was written into it last; 0: it is gone."""
    newest = 0.0
    with contextlib.suppress(FileNotFoundError):
        newest = folder.stat().st_mtime
        for path in folder.iterdir():
            with contextlib.suppress(FileNotFoundError):  # it has its place now
                newest = max(newest, path.stat().st_mtime)
    return newest


class Unfinished(msgspec.Struct, frozen=True):
    folder: str
    task: str
    frames: int
    seconds_since: float  # something was written into it
    problem: str = ""


def unfinished_in(root: Path) -> list[Unfinished]:
    """Look at what is in staging, without touching it: it may be being recorded."""
    found = []
    for folder in staged_folders(root / STAGING):
        since = round(time.time() - _written(folder), 1)
        try:
            staged = read_staged(folder)
        except DatasetError as problem:
            if not folder.exists():  # it was counted, or discarded, while we looked
                continue
            found.append(Unfinished(folder.name, "", 0, since, str(problem)))
        else:
            found.append(Unfinished(folder.name, staged.about.task, staged.table.num_rows, since))
    return found
