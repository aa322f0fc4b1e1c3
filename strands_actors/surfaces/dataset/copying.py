"""Copy episodes of one or several datasets into few large files, as LeRobot does. The sources are not changed.

Every frame of the copy is read and compared with its source. The copy is made in a temporary folder. At the end
this folder gets the final name, so that an incomplete copy never has this name.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from .check import check
from .copied_files import Chosen, CopiedFiles
from .errors import DamagedError, DatasetError
from .index import RESTORE, Index
from .info import Info
from .layout import STAGING
from .storage import STAGED_SUFFIX, Storage


class Copied(msgspec.Struct, frozen=True):
    dataset: str
    copy: str
    episodes: int
    frames: int
    files_before: int
    files: int
    bytes: int


def copy_dataset(index: Index, copy: Path, document: dict[str, Any], storage: Storage | None = None) -> Copied:
    """Copy every episode of a dataset.

    Args:
        index: The dataset. It must be undamaged, since every episode is copied.
        copy: The folder of the copy, which must not exist.
        document: The contents of the copy's ``info.json``. The totals are added.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: An episode is damaged, or a frame of the copy differs from its source.
        DatasetError: The folder of the copy exists, or the temporary folder exists.
    """
    index.require_certain()
    check(index).require_sound(index.root)
    chosen = [Chosen(index, number) for number in sorted(index.rows)]
    return copy_episodes(chosen, copy, index.info, document, index.tasks, storage)


def copy_episodes(
    chosen: Sequence[Chosen],
    copy: Path,
    info: Info | None,
    document: dict[str, Any],
    tasks: Sequence[str] = (),
    storage: Storage | None = None,
) -> Copied:
    """Copy episodes in the given order.

    Args:
        chosen: The episodes. Their datasets must have the same features, and the episodes must not be damaged.
        copy: The folder of the copy, which must not exist.
        info: The features and the rate of the episodes.
        document: The contents of the copy's ``info.json``. The totals are added.
        tasks: Tasks that the copy has in any case. Others get the next numbers.
        storage: The disk; a test may replace it.

    Raises:
        DamagedError: A frame of the copy differs from its source.
        DatasetError: The folder of the copy exists, or the temporary folder exists.
    """
    assert info is not None
    storage = storage or Storage()
    if copy.exists():
        raise DatasetError(f"{copy} exists already. Give another name, or remove it")
    staged = copy.with_name(copy.name + STAGED_SUFFIX)
    try:
        staged.mkdir(0o700, parents=True)
    except FileExistsError:
        reason = "another copy is being made, or a copy was interrupted"
        raise DatasetError(f"{staged} exists already: {reason}. Give another name, or remove it") from None
    try:
        made = CopiedFiles(chosen, staged, info, document, tasks)
        files = made.write()
        for path in files:
            storage.sync_path(path)
        os.rename(staged, copy)
    except BaseException:
        storage.remove(staged)
        raise
    storage.sync_path(copy.parent)
    size = sum(path.stat().st_size for path in copy.rglob("*") if path.is_file())
    roots = list(dict.fromkeys(each.index.root for each in chosen))
    before = sum(path.is_file() and STAGING.name not in path.parts for root in roots for path in root.rglob("*"))
    names = ", ".join(map(str, roots))
    return Copied(names, str(copy), len(chosen), made.frames, before, len(files), size)


def damage_of(index: Index) -> dict[int, str]:
    """Read a whole dataset. Return why episodes are damaged, by number. Raise ``DamagedError`` if it is not certain
    which episodes it has."""
    index.require_certain()
    return check(index).damaged


def require_sound(index: Index, damaged: Mapping[int, str], numbers: Iterable[int]) -> None:
    """Raise ``DamagedError`` if one of these episodes is damaged."""
    for number in numbers:
        if number in damaged:
            raise DamagedError(f"{index.root}: episode {number} is damaged: {damaged[number]}. {RESTORE}")
