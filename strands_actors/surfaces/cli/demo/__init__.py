"""``demo``: run a simulated SO-101, kill or freeze its processes one after the other, and show how it stops."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rich.console import Console

from strands_actors.caller.handle.robot import Robot
from strands_actors.contract.driver import Driver
from strands_actors.contract.extras import missing
from strands_actors.drivers import get_native_driver_class
from strands_actors.surfaces.cli.errors import Problem

from . import summary
from .scenario import FAULTS, Failed, Scenario
from .screen import Screen
from .story import Story
from .watch import Watch, wait_for

ROBOT = "so101"
GONE_S = 5.0
LOG_VARIABLE = "STRANDS_ACTORS_TWIN_LOG"


def run(seconds: float, *, faults: bool, as_json: bool, out: Path) -> int:
    """Run the demo.

    Args:
        seconds: Length of the demo, without the time in which processes start.
        faults: True to kill and freeze processes, False to only move the arm.
        as_json: Print one JSON object and nothing else.
        out: The path of the picture.

    Returns:
        The exit code: 0 if every fault led to the safe state in time, and no setpoint was sent afterwards.
    """
    if not out.absolute().parent.is_dir():
        raise Problem(f"demo: there is no folder {out.absolute().parent} for the picture")
    driver_class = get_native_driver_class(ROBOT)
    assert driver_class is not None and issubclass(driver_class, Driver)
    console = Console(quiet=as_json, highlight=False)
    live = console.is_terminal and not console.is_dumb_terminal and not as_json
    story = Story((lambda line: None) if live else console.print)
    chosen = FAULTS if faults else ()
    problem = ""
    with _twin_log() as log:
        robot = Robot(ROBOT, mode="real", transport="twin")
        watch = Watch(robot, log)
        scenario = Scenario(robot, watch, driver_class, story.note)
        screen = Screen(console, watch, story, scenario) if live else contextlib.nullcontext()
        try:
            with screen:
                scenario.start()
                scenario.run(seconds, chosen)
        except Failed as failure:
            problem = str(failure)
            story.note(problem, "bad")
        except KeyboardInterrupt:
            console.print("interrupted: making the arm safe and ending everything")
            raise
        finally:
            with _deaf_to_interrupts():
                answer = robot.cleanup()
                watch.stop()
    if answer["status"] != "success":
        problem = problem or answer["content"][0]["text"]
        story.note(problem, "bad")
    if wait_for(lambda: not watch.left_over(), GONE_S):
        story.note("stopped; every process that was started is gone", "plain")
    else:
        problem = problem or f"these processes are still there: {watch.left_over()}"
        story.note(problem, "bad")
    if live:
        for line in story.lines:
            console.print(line)
    outcomes = scenario.outcomes
    ok = not problem and len(outcomes) == len(chosen) and all(outcome.safe for outcome in outcomes)
    no_picture = missing("demo", f"{out.name}, the picture of it,")
    picture = None if no_picture else _draw(out, watch, scenario, story)
    summary.show(console, outcomes, scenario.pace)
    if picture is not None:
        console.print(f"\npicture: {picture}")
    elif no_picture:
        console.print(f"\n{no_picture}", markup=False)
    if as_json:
        print(
            json.dumps(summary.as_plain(outcomes, scenario.pace, story.seconds(), picture, problem, ok)),
            flush=True,
        )
    return 0 if ok else 1


def _draw(out: Path, watch: Watch, scenario: Scenario, story: Story) -> Path | None:
    if not watch.positions:
        return None
    from . import picture  # Import this late, because it imports matplotlib, which is slow.

    picture.draw(out, watch, scenario.outcomes, story.began_ns)
    return out


@contextlib.contextmanager
def _twin_log() -> Iterator[Path]:
    """Yield the path of a log file. While the block runs, a simulated robot that is started writes all frames
    of its protocol into this file."""
    with tempfile.TemporaryDirectory(prefix="strands-demo-") as directory:
        before = os.environ.get(LOG_VARIABLE)
        log = Path(directory) / "wire.ndjson"
        os.environ[LOG_VARIABLE] = str(log)
        try:
            yield log
        finally:
            if before is None:
                del os.environ[LOG_VARIABLE]
            else:
                os.environ[LOG_VARIABLE] = before


@contextlib.contextmanager
def _deaf_to_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C while the block runs, so that a second Ctrl-C does not interrupt the cleanup."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
