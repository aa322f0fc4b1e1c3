"""Options and arguments of several commands, and their checks."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

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


def cameras_of(verb: str, texts: Sequence[str]) -> dict[str, dict[str, Any]] | None:
    """Return the cameras that the option ``--camera`` declares, in the form of ``Robot(cameras=...)``; None for no
    cameras.

    Args:
        verb: The command, for the error.
        texts: ``NAME``, or ``NAME:KEY=VALUE,KEY=VALUE`` with the keys of docs/cameras.md.

    Raises:
        Problem: A text has another form, or two have the same name.
    """
    cameras: dict[str, dict[str, Any]] = {}
    for text in texts:
        # Only the first colon ends the name, since the path of a device may contain colons.
        name, _, settings = text.partition(":")
        if name in cameras:
            raise Problem(f"{verb}: two cameras are named {name}. Use different names")
        remedy = "Give NAME, or NAME:index_or_path=0,fps=30,width=640,height=480"
        cameras[name] = dict(
            _setting(f"{verb}: --camera {text}", setting, remedy) for setting in settings.split(",") if settings
        )
    return cameras or None


Policy = Annotated[
    str,
    typer.Option(
        metavar="NAME|DIR|ws://HOST:PORT|zmq://HOST:PORT|MODULE:CLASS",
        help="A policy by name (mock, sine ...), the folder of a checkpoint or an ONNX policy, or a server.",
    ),
]
PolicyHz = Annotated[
    float | None,
    typer.Option(callback=finite, help="Actions per second. Default: that of the policy, or of the robot."),
]
PolicyOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--option", metavar="KEY=VALUE", help="An option of the policy, such as units=degrees. Can be repeated."
    ),
]
Model = Annotated[
    str | None,
    typer.Option(metavar="FILE", help="Simulate this MJCF or URDF under the robot's name."),
]
Keyframe = Annotated[str | None, typer.Option(help="The keyframe of --model in which the simulation begins.")]
Onboard = Annotated[
    str | None,
    typer.Option(
        metavar="DIR", help="An ONNX policy that keeps a simulated model with legs standing while it holds."
    ),
]


def scene_of(model: str | None, keyframe: str | None, onboard: str | None) -> dict[str, Any]:
    """Return the keywords of ``Robot`` that the options --model, --keyframe and --onboard give."""
    given = {"urdf_path": model, "keyframe": keyframe, "onboard": onboard}
    return {name: value for name, value in given.items() if value is not None}


def settings_of(verb: str, texts: Sequence[str]) -> dict[str, Any]:
    """Return the keyword arguments that the options ``--option KEY=VALUE`` give.

    A value that is JSON is read as JSON (a number, true, a list); any other is text.

    Args:
        verb: The command, for the error.
        texts: The options.

    Raises:
        Problem: A text has another form, or two have the same key.
    """
    settings: dict[str, Any] = {}
    for text in texts:
        key, value = _setting(f"{verb}: --option", text, "Give one, such as units=degrees")
        if key in settings:
            raise Problem(f"{verb}: --option {key} is given twice. Give it once")
        settings[key] = value
    return settings


def _setting(place: str, setting: str, remedy: str) -> tuple[str, Any]:
    key, equals, value = setting.partition("=")
    if not equals or not key:
        raise Problem(f"{place}: {setting!r} is not KEY=VALUE. {remedy}")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


Dialogue = Annotated[bool, typer.Option("--dialogue", help="Ask a program in place of a person, in lines of JSON.")]
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
Running = Annotated[
    str,
    typer.Argument(metavar="ROBOT", help="The robot's name, as `tree` shows it.", autocompletion=_running),
]
Kind = Annotated[
    str, typer.Argument(metavar="ROBOT", help="The robot's type, as `list` shows it.", autocompletion=_robot_types)
]
Id = Annotated[
    str | None,
    typer.Option("--id", help="The robot's id: its name here, and that of its calibration (LeRobot's `id`)."),
]
Cameras = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        metavar="NAME[:KEY=VALUE,...]",
        help="A camera of the robot: wrist:index_or_path=0,fps=30,width=640,height=480. Of a twin or a "
        "simulation: wrist. Can be repeated.",
    ),
]
What = Annotated[str, typer.Argument(metavar="ROBOT|KEY", help="A robot's name, or a key with wildcards.")]
Mesh = Annotated[
    Path | None,
    typer.Option("--mesh", metavar="FILE", help="TOML file with the endpoints of robots on other hosts."),
]
Every = Annotated[bool, typer.Option("--all", help="Also list robots without a driver on this machine.")]
All = Annotated[bool, typer.Option("--all", help="Every robot of this user.")]
