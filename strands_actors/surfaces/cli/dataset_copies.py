"""The commands that copy a dataset: ``dataset copy``, ``compact``, ``convert``, ``label``, ``split``, ``merge``."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from strands_actors.contract.shown import harmless
from strands_actors.surfaces.dataset import compact as compacting
from strands_actors.surfaces.dataset import editing
from strands_actors.surfaces.dataset.copying import Copied
from strands_actors.surfaces.dataset.errors import DamagedError
from strands_actors.surfaces.dataset.second.bring import copy_all
from strands_actors.surfaces.dataset.second.opening import open_place
from strands_actors.surfaces.dataset.second.place import PlaceError
from strands_actors.surfaces.recording.errors import RecordingError

from .dataset import Screen, not_achieved
from .errors import Problem


def copy(root: Path, url: str, verify: bool, as_json: bool) -> int:
    """Copy what a second place lacks. Return 1 if the dataset is damaged or the place cannot be used, else 0."""
    screen = Screen(as_json)
    try:
        place = open_place(url, root)
        try:
            done = copy_all(root, place, verify, lambda there, of: screen.count(f"{there}/{of} episodes"))
        finally:
            place.close()
            screen.clear()
    except (DamagedError, PlaceError) as problem:
        return not_achieved("copy", problem)
    except RecordingError as problem:
        raise Problem(f"dataset copy: {harmless(str(problem))}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(done)))
    else:
        if done.uncounted:
            print(f"files of no episode, and LeRobot would read them: {harmless(', '.join(done.uncounted))}")
        print(f"{harmless(done.place)}: {done.episodes} episodes, {done.copied} of them copied now, "
              f"{done.bytes / 1e6:.1f} MB")  # fmt: skip
    return 0


def compact(root: Path, out: Path, as_json: bool) -> int:
    """Copy a dataset into few files. Return 1 if the dataset is damaged, else 0."""
    return _copy("compact", lambda: [compacting.compact(root, out)], as_json)


def convert(root: Path, out: Path, as_json: bool) -> int:
    """Copy a dataset of version 2, and convert the copy to version 3. Return 1 if the dataset is damaged, else
    0."""
    return _copy("convert", lambda: [compacting.convert(root, out)], as_json)


def label(root: Path, out: Path, episodes: str, task: str | None, mark: str | None, as_json: bool) -> int:
    """Copy a dataset with other tasks or marks. Return 1 if the dataset is damaged, else 0."""
    return _copy("label", lambda: [editing.label(root, out, episodes, task, mark)], as_json)


def split(root: Path, parts: Sequence[str], seed: int | None, as_json: bool) -> int:
    """Copy parts of a dataset. Return 1 if a needed episode is damaged, else 0."""
    by_part: dict[Path, str] = {}
    for part in parts:
        folder, equals, episodes = part.rpartition("=")
        if not equals or not folder or Path(folder) in by_part:
            raise Problem(f"dataset split: {part!r} cannot be read. Write FOLDER=EPISODES, each folder once")
        by_part[Path(folder)] = episodes
    return _copy("split", lambda: editing.split(root, by_part, seed), as_json)


def merge(roots: Sequence[Path], out: Path, as_json: bool) -> int:
    """Copy several datasets into one. Return 1 if one of them is damaged, else 0."""
    return _copy("merge", lambda: [editing.merge(roots, out)], as_json)


def _copy(command: str, make: Callable[[], Sequence[Copied]], as_json: bool) -> int:
    try:
        made = make()
    except DamagedError as damage:
        return not_achieved(command, damage)
    except (RecordingError, OSError) as problem:
        raise Problem(f"dataset {command}: {harmless(str(problem))}") from problem
    if as_json:
        print(json.dumps(msgspec.to_builtins(made if command == "split" else made[0])))
    else:
        for done in made:
            print(f"{done.copy}: {done.episodes} episodes, {done.frames} frames in {done.files} files "
                  f"instead of {done.files_before}, {done.bytes / 1e6:.1f} MB")  # fmt: skip
    return 0
