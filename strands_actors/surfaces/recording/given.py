"""Check the arguments of recording functions before anything begins. A message names the wrong argument."""

from __future__ import annotations

import os
from pathlib import Path

from strands_actors.contract.shown import shown

from .errors import RecordingError


def name_of(what: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """Return the name of a robot that is given as an object or by its name.

    Args:
        what: The calling function, for the message.
        robot: The robot, or its name.
        error: The exception to raise for anything else.
    """
    name = robot if isinstance(robot, str | os.PathLike) else getattr(robot, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise error(f"{what}: robot is {shown(robot)}. give a connected robot, or the name of one that runs")
    return name


def started(what: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """As ``name_of``, for a robot that must run. One that is given as an object is connected first, as its
    first command would connect it. Raise ``error`` if that fails."""
    name = name_of(what, robot, error)
    connect = getattr(robot, "ensure_connected", None)
    if connect is not None and (problem := connect()):
        raise error(f"{what}: {problem}")
    return name


def path_of(what: str, which: str, path: object, error: type[RecordingError] = RecordingError) -> Path:
    """Return a path that is given as text or as a path. Raise ``error`` for anything else.

    Args:
        what: The calling function, for the message.
        which: The name of its argument, for the message.
        path: The path.
        error: The exception to raise.
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str) or not text.strip() or "\0" in text:
        raise error(f"{what}: {which} is {shown(path)}. give a path, as text")
    return Path(text)
