"""Check the arguments of recording functions before anything begins. A message names the wrong argument."""

from __future__ import annotations

import os
from pathlib import Path

from strands_actors.contract.shown import shown

from .errors import RecordingError


def name_of_robot(function: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """Return the name of a robot that is given as an object or by its name.

    Args:
        function: The calling function, for the message.
        robot: The robot, or its name.
        error: The exception to raise for anything else.
    """
    name = robot if isinstance(robot, str | os.PathLike) else getattr(robot, "name", None)
    if not isinstance(name, str) or not name.strip():
        raise error(f"{function}: robot is {shown(robot)}. Give a connected robot, or the name of one that runs")
    return name


def name_of_started(function: str, robot: object, error: type[RecordingError] = RecordingError) -> str:
    """Return the name of a robot like ``name_of_robot``, and make sure that the robot runs. A robot object that is
    not connected is connected first. Raise ``error`` if that fails."""
    name = name_of_robot(function, robot, error)
    connect = getattr(robot, "ensure_connected", None)
    if connect is not None and (problem := connect()):
        raise error(f"{function}: {problem}")
    return name


def path_of(function: str, argument: str, path: object, error: type[RecordingError] = RecordingError) -> Path:
    """Return an argument as a ``Path``. Raise ``error`` if it is neither text nor a path.

    Args:
        function: The calling function, for the message.
        argument: The name of its argument, for the message.
        path: The path.
        error: The exception to raise.
    """
    text = os.fspath(path) if isinstance(path, str | os.PathLike) else None
    if not isinstance(text, str) or not text.strip() or "\0" in text:
        raise error(f"{function}: {argument} is {shown(path)}. Give a path, as text")
    return Path(text)
