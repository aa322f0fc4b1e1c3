"""Repair a dataset after a crash. An unfinished episode is saved with the frames that are complete."""

from __future__ import annotations

import contextlib
import time
from pathlib import Path

import msgspec

from .dataset import STRAYS, Dataset
from .episode import Episode
from .errors import DatasetError
from .layout import STAGING, read_info
from .staging import read_staged, staged_folders
from .storage import Storage


class Repaired(msgspec.Struct, frozen=True):
    """The result of a repair for one episode in the staging folder, which is not part of the dataset yet.

    Attributes:
        folder: The name of the episode's staging folder. If the recorder had finished the episode, so that it
            only had to be committed, the text ``finished``.
        episode: The number of the episode in the dataset. -1 if it could not be saved.
        frames: The number of frames.
        defects: The defects of the episode as text.
        problem: Why the episode could not be saved. Empty if it was saved.
    """

    folder: str
    episode: int
    frames: int
    defects: str = msgspec.field(name="marks")
    problem: str = ""


class Damage(msgspec.Struct, frozen=True):
    """An episode of the dataset that cannot be used, and the reason."""

    episode: int
    problem: str


class Report(msgspec.Struct, frozen=True):
    dataset: str
    # Files that belonged to no episode but that LeRobot would read. They were moved to .staging/uncounted.
    moved_strays: list[str] = msgspec.field(name="swept")
    repaired: list[Repaired]
    dropped: list[str]
    total_episodes: int
    # Episodes with damaged files. Only the user can repair them, with a backup of the files.
    damaged: list[Damage] = []
    faults: list[str] = []  # Defects that concern the whole dataset.

    @property
    def is_sound(self) -> bool:
        """True if the dataset has no defects after the repair."""
        return not self.damaged and not self.faults and not any(episode.problem for episode in self.repaired)


def require_dataset(root: Path) -> None:
    """Raise ``DatasetError`` if the folder has neither ``info.json`` nor a staging folder."""
    if read_info(root) is None and not (root / STAGING).is_dir():
        raise DatasetError(
            f"{root} is not a dataset, because it has no meta/info.json. Give the folder of a dataset"
        )


def repair(root: Path, drop: bool = False, storage: Storage | None = None) -> Report:
    """Save the episodes in staging: finished episodes, and the complete frames of unfinished episodes.

    A damaged episode of the dataset is reported, and not changed.

    Args:
        root: The folder of the dataset.
        drop: Remove unfinished episodes and the files in ``.staging/uncounted``, instead of saving them.
            Finished episodes are always saved.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: It is not certain which episodes the dataset has. No file was changed.
        DatasetError: The folder is not a dataset, or another process writes into it.
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
        strays = dataset.staging / STRAYS
        # If an episode is damaged, its missing frames may be in a stray file.
        if drop and strays.exists() and not dataset.checked.damaged:
            dropped += sorted(str(path.relative_to(strays)) for path in strays.rglob("*") if path.is_file())
            dataset.storage.remove(strays)
        damaged = [Damage(number, reason) for number, reason in sorted(dataset.checked.damaged.items())]
        return Report(
            str(root),
            dataset.moved_strays,
            repaired,
            dropped,
            len(dataset.episodes),
            damaged,
            dataset.checked.faults,
        )
    finally:
        dataset.close()


def _repair(dataset: Dataset, folder: Path) -> Repaired:
    try:
        return _repaired(folder.name, dataset.commit(folder))
    except DatasetError as problem:
        return Repaired(folder.name, -1, 0, "", str(problem))


def _repaired(folder: str, episode: Episode) -> Repaired:
    return Repaired(folder, episode.index, episode.frames, episode.quality.as_text)


def _written(folder: Path) -> float:
    """Return the time of the last write into a folder, in seconds since 1970. 0 if the folder does not
    exist."""
    newest = 0.0
    with contextlib.suppress(FileNotFoundError):
        newest = folder.stat().st_mtime
        for path in folder.iterdir():
            with contextlib.suppress(FileNotFoundError):  # The file may just have been renamed to its final name.
                newest = max(newest, path.stat().st_mtime)
    return newest


class Unfinished(msgspec.Struct, frozen=True):
    folder: str
    task: str
    frames: int
    seconds_since: float  # Time since the last write into the folder, in seconds.
    problem: str = ""


def unfinished_in(root: Path) -> list[Unfinished]:
    """Return the episodes in the staging folder, which are not part of the dataset yet. No file is changed,
    since a recorder may be writing an episode."""
    episodes = []
    for folder in staged_folders(root / STAGING):
        since = round(time.time() - _written(folder), 1)
        try:
            staged = read_staged(folder)
        except DatasetError as problem:
            if not folder.exists():  # The episode has just been committed or discarded.
                continue
            episodes.append(Unfinished(folder.name, "", 0, since, str(problem)))
        else:
            episodes.append(Unfinished(folder.name, staged.about.task, staged.table.num_rows, since))
    return episodes
