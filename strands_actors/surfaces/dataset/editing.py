"""Label, split and merge datasets. Each makes a copy: the sources are not changed.

Every copy is read again and compared with its sources, as in ``copying``. A failed command leaves no files behind.
"""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence
from pathlib import Path

from .compact import open_newest
from .copied_files import Chosen
from .copying import Copied, copy_episodes, damage_of, require_sound
from .errors import DatasetError
from .index import Index
from .info import Info
from .layout import difference_of
from .selection import Part, is_share, numbers_in, shares
from .storage import Storage


def label(
    root: Path,
    copy: Path,
    episodes: str,
    task: str | None = None,
    mark: str | None = None,
    storage: Storage | None = None,
) -> Copied:
    """Copy a dataset, and give some of its episodes another task or a mark.

    Args:
        root: The folder of the dataset.
        copy: The folder of the copy, which must not exist.
        episodes: The episodes that get the label, such as ``0-4,7``. ``all`` and ``good`` stand for these.
        task: Their new task, as a sentence. None keeps it.
        mark: Their new mark, such as "failed". Empty removes it, None keeps it. An episode with a mark is not good.
        storage: The disk; a test may replace it.

    Raises:
        DatasetError: An argument is wrong, an episode is damaged, or the copy failed.
    """
    if task is None and mark is None:
        raise DatasetError("nothing would change. Give a task or a mark")
    if task is not None and not task.strip():
        raise DatasetError("the task is empty. Give a sentence that describes it")
    index, info = open_newest(root)
    damaged = damage_of(index)
    labelled = set(numbers_in(index, episodes, damaged))
    require_sound(index, damaged, index.rows)
    chosen = [
        Chosen(index, number, task, mark) if number in labelled else Chosen(index, number)
        for number in sorted(index.rows)
    ]
    return copy_episodes(chosen, copy, info, info.document, storage=storage)


def split(
    root: Path, parts: Mapping[Path, str], seed: int | None = None, storage: Storage | None = None
) -> list[Copied]:
    """Copy parts of a dataset into separate datasets.

    Args:
        root: The folder of the dataset.
        parts: The episodes of each part by its folder, which must not exist. Either lists such as ``0-7,9``,
            ``good`` or ``all``, or shares such as ``80%``. Shares take the episodes in order.
        seed: Choose the episodes of shares at random, always the same for the same number. None takes them in
            order.
        storage: The disk; a test may replace it.

    Raises:
        DatasetError: An argument is wrong, an episode is damaged, or a copy failed.
    """
    storage = storage or Storage()
    index, info = open_newest(root)
    damaged = damage_of(index)
    by_part = _numbers_by_part(index, parts, seed, damaged)
    for part, numbers in by_part.items():
        if part.exists():
            raise DatasetError(f"{part} exists already. Give another name, or remove it")
        if not numbers:
            raise DatasetError(f"{part} would have no episode. The dataset has {len(index.rows)} episodes")
    require_sound(index, damaged, [number for numbers in by_part.values() for number in numbers])
    made: list[Copied] = []
    try:
        for part, numbers in by_part.items():
            chosen = [Chosen(index, number) for number in numbers]
            made.append(copy_episodes(chosen, part, info, info.document, storage=storage))
    except BaseException:
        for each in made:
            storage.remove(Path(each.copy))
        raise
    return made


def _numbers_by_part(
    index: Index, parts: Mapping[Path, str], seed: int | None, damaged: Mapping[int, str]
) -> dict[Path, list[int]]:
    if not any(map(is_share, parts.values())):
        if seed is not None:
            raise DatasetError("a seed is only for shares such as 80%. Leave it out")
        return {part: numbers_in(index, text, damaged) for part, text in parts.items()}
    numbers = sorted(index.rows)
    if seed is not None:
        random.Random(seed).shuffle(numbers)
    return {part: sorted(each) for part, each in shares(numbers, [Part(*item) for item in parts.items()]).items()}


def merge(roots: Sequence[Path], copy: Path, storage: Storage | None = None) -> Copied:
    """Copy several datasets into one, in the given order.

    Args:
        roots: The folders of the datasets. They must be of the same robot, with the same rate, features, units and
            codec.
        copy: The folder of the copy, which must not exist.
        storage: The disk; a test may replace it.

    Raises:
        DatasetError: The datasets do not fit together, an episode is damaged, or the copy failed.
    """
    resolved = [root.resolve() for root in roots]
    if len(roots) < 2 or len(set(resolved)) < len(resolved):
        raise DatasetError("merge: give two datasets or more, each of them once")
    opened = [open_newest(root) for root in roots]
    first, info = opened[0]
    for index, other in opened[1:]:
        if reason := _contradiction(info, other, (str(first.root), str(index.root))):
            raise DatasetError(f"{index.root} cannot be merged with {first.root}: {reason}")
    for index, _ in opened:
        require_sound(index, damage_of(index), index.rows)
    chosen = [Chosen(index, number) for index, _ in opened for number in sorted(index.rows)]
    return copy_episodes(chosen, copy, info, info.document, storage=storage)


def _contradiction(ours: Info, theirs: Info, names: tuple[str, str]) -> str:
    """Return why two datasets cannot be merged. Empty if they can."""
    if ours.robot_type != theirs.robot_type:
        return f"it is of the robot {theirs.robot_type}, not {ours.robot_type}"
    if ours.fps != theirs.fps:
        return f"it has {theirs.fps:g} fps, not {ours.fps:g}"
    if difference := difference_of(ours.features, theirs.features, names):
        return difference
    for key, feature in ours.features.items():
        other = theirs.features[key]
        if bool(feature.flat_units) != bool(other.flat_units):
            # Degrees and normalized numbers have the same columns. A mixture would be dangerous to replay.
            return f"{key} states units in only one of them"
        if feature.codec != other.codec:
            return f"{key} is encoded as {other.codec or 'unknown'}, not {feature.codec or 'unknown'}"
    return ""
