"""Make pictures of the terminal, as SVG: ``top`` with robots that run, and a drill. All text was printed so."""

from __future__ import annotations

import asyncio
import contextlib
import io
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.text import Text

from strands_actors import Robot
from strands_actors.surfaces.cli.top.app import Top

SIZE = (110, 29)
DRILLED = "xarm7"
DRILL_COLUMNS = 96
ROBOTS = ("so101", "ur5e", "xarm7")
PATIENCE_S = 60.0
SETTLED_S = 4.0

FONTS = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
"""The fonts that a picture would load from a network."""


def make_top(path: Path) -> None:
    """Start some robots on twins, and write the picture of ``top``."""
    with contextlib.ExitStack() as stack:
        # Robots of other programs must not be in the picture.
        run = stack.enter_context(tempfile.TemporaryDirectory(prefix="sa-"))
        stack.callback(os.environ.__setitem__, "STRANDS_ACTORS_RUN", os.environ.get("STRANDS_ACTORS_RUN", ""))
        os.environ["STRANDS_ACTORS_RUN"] = run
        robots = []
        for name in ROBOTS:
            robot = stack.enter_context(Robot(name, mode="real", transport="twin"))
            if (problem := robot.connect_eagerly()) is not None:
                raise RuntimeError(problem)
            robot.start_task("wave", policy_provider="sine", duration=600.0)
            robots.append(robot)
        picture = asyncio.run(_top())
        if not all(robot.get_task_status()["content"][0]["json"]["running"] for robot in robots):
            raise RuntimeError("a policy ended, probably because this computer is busy. Try again")
        path.write_text(without_fonts(picture))


async def _top() -> str:
    app = Top()
    async with app.run_test(size=SIZE) as pilot:
        await _until(pilot.pause, lambda: app.query_one("#robots").row_count == len(ROBOTS))  # type: ignore[attr-defined]
        await pilot.pause(SETTLED_S)
        picture = app.export_screenshot(title="strands-actors top")
        await pilot.press("q")
    return picture


async def _until(pause: Callable[..., object], condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        if time.monotonic() > deadline_s:
            raise RuntimeError("not all robots appeared in top")
        await asyncio.sleep(0.05)


def make_drill(path: Path) -> None:
    """Run the drill of a twin, and write the picture of its output. The home folder is shown as ``~``."""
    command = ["drill", DRILLED, "--twin"]
    with tempfile.TemporaryDirectory(prefix="sa-") as home:
        environment = {**os.environ, "COLUMNS": str(DRILL_COLUMNS), "HOME": home}
        environment.pop("XDG_DATA_HOME", None)
        done = subprocess.run(
            [str(Path(sys.executable).with_name("strands-actors")), *command],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        printed = done.stdout.rstrip().replace(home, "~")
    if done.returncode:
        raise RuntimeError(f"the drill failed, probably because this computer is busy:\n{printed}")
    console = Console(record=True, width=DRILL_COLUMNS, file=io.StringIO())
    console.print(Text("$ strands-actors " + " ".join(command), style="bold"))
    console.print(Text.from_ansi(printed))
    path.write_text(without_fonts(console.export_svg(title="strands-actors drill")))


def without_fonts(svg: str) -> str:
    """Return a picture that loads nothing from a network: the reader's own monospace font is used."""
    return FONTS.sub("", svg).replace("Fira Code", "ui-monospace, Menlo, DejaVu Sans Mono")
