"""Options and arguments of several commands, and their checks."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from .errors import Problem


def finite(value: float | None) -> float | None:
    """Refuse NaN and infinity, which a minimum does not exclude."""
    if value is not None and not math.isfinite(value):
        raise typer.BadParameter(f"{value} is no finite number")
    return value


def one_or_all(verb: str, robot: str | None, every: bool) -> None:
    """Refuse a name together with --all, because either may be meant."""
    if robot is not None and every:
        raise Problem(f"{verb}: {robot} and --all are both given. name a robot, or say --all")


Json = Annotated[bool, typer.Option("--json", help="Print JSON instead.")]


def _running() -> list[str]:
    """Return the running robots, for the shell's completion."""
    from strands_actors.caller.processes.run_directory import notes

    return [note.robot for note in notes()]


def _known() -> list[str]:
    from strands_actors.drivers import list_native_drivers

    return list(list_native_drivers())


Which = Annotated[
    str | None,
    typer.Argument(metavar="[ROBOT]", help="Its name, as `tree` shows it.", autocompletion=_running),
]
Kind = Annotated[str, typer.Argument(metavar="ROBOT", help="As `list` names it.", autocompletion=_known)]
What = Annotated[str, typer.Argument(metavar="ROBOT|KEY", help="A robot, or a key with wildcards.")]
Mesh = Annotated[Path | None, typer.Option("--mesh", metavar="FILE", help="How to reach robots elsewhere (TOML).")]
Every = Annotated[bool, typer.Option("--all", help="Those, too, that nothing here drives.")]
All = Annotated[bool, typer.Option("--all", help="Every robot of this user.")]
