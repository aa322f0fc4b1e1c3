"""``view``: show a running robot live in Foxglove or Rerun."""

from __future__ import annotations

import importlib.util
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import trio

from strands_actors.contract.extras import require
from strands_actors.surfaces.view.sinks import Sink
from strands_actors.surfaces.view.viewer import Viewer
from strands_actors.surfaces.view.watch import NotRunning, find, watch

from .errors import Problem
from .until_signal import mesh_until_signal


class Choice(msgspec.Struct, frozen=True):
    """The options of the command line.

    Attributes:
        robot: Name of the robot.
        foxglove: Serve Foxglove, at ``host`` and ``port``.
        rerun: Show the robot in Rerun: in a window, or with ``save`` in a file.
        waits: Wait until the robot runs.
        seconds: End after so many seconds; None for no limit.
        cameras: Show the cameras.
        model: Show the model in 3-D.
        model_file: A model file of the user; empty for the robot's own model.
    """

    robot: str
    foxglove: bool
    rerun: bool
    host: str
    port: int
    save: Path | None
    waits: bool
    seconds: float | None
    cameras: bool
    model: bool
    model_file: str


def view(choice: Choice, mesh: Path | None, as_json: bool) -> None:
    """Show a robot until Ctrl-C, or for a number of seconds.

    Raises:
        Problem: The robot does not run, or the display cannot be opened.
    """
    if not (choice.foxglove or choice.rerun):
        raise Problem("view: give --foxglove or --rerun, or both")
    if choice.save is not None and not choice.rerun:
        raise Problem("view: --save is for --rerun. Add --rerun")
    if choice.foxglove:
        require("foxglove", "view --foxglove")
    if choice.rerun:
        _check_rerun(choice.save)
    if choice.model_file and not Path(choice.model_file).is_file():
        raise Problem(
            f"view: there is no file {choice.model_file}. Give the model file (MJCF or URDF) of the robot"
        )
    trio.run(_view, choice, mesh, as_json)


async def _view(choice: Choice, mesh: Path | None, as_json: bool) -> None:
    async with mesh_until_signal(mesh) as client:
        try:
            await find(client, choice.robot, choice.waits, lambda: _say(f"waiting for {choice.robot}"))
        except NotRunning as reason:
            raise Problem(f"view: {reason}") from None
        sinks, facts = _open_sinks(choice, trio.lowlevel.current_trio_token().run_sync_soon)
        try:
            print(json.dumps(facts) if as_json else _lines(facts), flush=True)
            with trio.move_on_after(float("inf") if choice.seconds is None else choice.seconds):
                viewer = Viewer(choice.robot, sinks, lambda text: _say(f"view: {text}"))
                await watch(client, viewer, choice.cameras, choice.model, choice.model_file)
        finally:
            for sink in sinks:
                sink.close()


def _open_sinks(choice: Choice, soon: Callable[[Callable[[], None]], None]) -> tuple[list[Sink], dict[str, str]]:
    """Open the displays. Return them, and the facts to print."""
    sinks: list[Sink] = []
    facts = {"robot": choice.robot}
    if choice.foxglove:
        from strands_actors.surfaces.view.foxglove_sink import LAYOUT, FoxgloveSink

        try:
            server = FoxgloveSink(choice.robot, choice.host, choice.port, soon)
        except OSError as error:
            raise Problem(f"view: {error}. Give another --port, or --port 0 for a free one") from error
        sinks.append(server)
        facts |= {"foxglove": server.url, "layout": str(LAYOUT)}
    if choice.rerun:
        from strands_actors.surfaces.view.rerun_sink import RerunSink

        try:
            sinks.append(RerunSink(choice.robot, choice.save))
        except OSError as error:
            raise Problem(f"view: Rerun: {error}. Write a recording instead, with --save FILE.rrd") from error
        facts["rerun"] = "its viewer" if choice.save is None else str(choice.save)
    return sinks, facts


def _check_rerun(file: Path | None) -> None:
    """Raise ``Problem`` if Rerun cannot show the robot."""
    # Rerun is not in ``contract.extras``: it is too large to be installed for the tests of that table.
    if importlib.util.find_spec("rerun") is None:
        raise Problem("view --rerun needs rerun. pip install 'strands-actors[rerun]'")
    if file is None:
        if not any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY"))):
            raise Problem("view: Rerun's window needs a display, and there is none. Write a file: --save FILE.rrd")
    elif file.exists():
        raise Problem(f"view: {file} exists already. Give another name, or remove it")
    elif not os.access(file.absolute().parent, os.W_OK):
        raise Problem(f"view: {file.absolute().parent} is no folder that can be written. Give another path")


def _lines(facts: dict[str, str]) -> str:
    lines = [f"showing {facts['robot']}; Ctrl-C ends this"]
    if "foxglove" in facts:
        lines += [f"Foxglove: open a connection to {facts['foxglove']}", f"its layout: {facts['layout']}"]
    if "rerun" in facts:
        lines.append(f"Rerun: {facts['rerun']}")
    return "\n".join(lines)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)
