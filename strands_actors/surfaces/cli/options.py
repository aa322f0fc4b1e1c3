"""Options and arguments of several commands, and their checks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from .errors import Problem


def finite(value: float | None) -> float | None:
    """Check that a number is finite. The option ``min`` of typer accepts NaN and infinity."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number")
    return value


def one_or_all(verb: str, robot: str | None, every: bool) -> None:
    """Raise ``Problem`` if a robot and --all are both given, because it is not clear which of them is meant."""
    if robot is not None and every:
        raise Problem(f"{verb}: {robot} and --all are both given. Give only one of them")


Json = Annotated[bool, typer.Option("--json", help="Print JSON instead.")]


def _running() -> list[str]:
    """Return the names of the running robots, for completion in the shell."""
    from strands_actors.caller.processes.run_directory import notes

    return [note.robot for note in notes()]


def _robot_types() -> list[str]:
    from strands_actors.drivers import list_native_drivers

    return list(list_native_drivers())


Which = Annotated[
    str | None,
    typer.Argument(metavar="[ROBOT]", help="The robot's name, as `tree` shows it.", autocompletion=_running),
]
Kind = Annotated[
    str, typer.Argument(metavar="ROBOT", help="The robot's type, as `list` shows it.", autocompletion=_robot_types)
]
What = Annotated[str, typer.Argument(metavar="ROBOT|KEY", help="A robot's name, or a key with wildcards.")]
Mesh = Annotated[
    Path | None,
    typer.Option("--mesh", metavar="FILE", help="TOML file with the endpoints of robots on other hosts."),
]
Every = Annotated[bool, typer.Option("--all", help="Also list robots without a driver on this machine.")]
All = Annotated[bool, typer.Option("--all", help="Every robot of this user.")]
