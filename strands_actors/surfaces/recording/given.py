"""What a script gives to be recorded or read: a slip is refused by name, before anything is begun."""

from __future__ import annotations

import os
from pathlib import Path

from strands_actors.contract.shown import shown

from .errors import RecordingError


def name_of(what: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """Return the name of a robot, or of one that has that name. Raise ``error``."""
    name = robot if isinstance(robot, str | os.PathLike) else getattr(robot, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise error(f"{what}: robot is {shown(robot)}. give a connected robot, or the name of one that runs")
    return name


def started(what: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """Return the name of a robot that runs: one that is given as an object is connected first, as its
    first command would connect it. Raise ``error``."""
    name = name_of(what, robot, error)
    connect = getattr(robot, "ensure_connected", None)
    if connect is not None and (problem := connect()):
        raise error(f"{what}: {problem}")
    return name


def path_of(what: str, which: str, path: object, error: type[RecordingError] = RecordingError) -> Path:
    """Return a path that was given as text, or as a path. Raise ``error``."""
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str) or not text.strip() or "\0" in text:
        raise error(f"{what}: {which} is {shown(path)}. give a path, as text")
    return Path(text)
