"""Wait for the standby of an earlier tree of a robot, and log its report.

As long as that standby runs, it may write to the robot. So no other tree is started before its end.
"""

from __future__ import annotations

import contextlib
import logging
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import msgspec
import trio

from strands_actors.kernel.health.processor import is_stopped
from strands_actors.supervisors.standby.report import LOCK, REPORT, holder, read

from .robot_processes import NotConnected
from .run_directory import run_dir

WAIT_S = 3.0
FROZEN_S = 0.3
"""A standby that the system has stopped (SIGSTOP) for so long is killed. It would block the robot for
ever."""
LOOK_S = 0.01

_log = logging.getLogger("strands_actors")


async def until_over(robot: str, place: str) -> str | None:
    """Wait for the standbys of earlier trees, and return their reports since the last start of a robot.

    Args:
        robot: Name of the robot. Standbys of this name count.
        place: Its place (``port_claim.place``), or empty for a twin. Standbys of this place count, too.

    Returns:
        The reports as text; None if there are no reports.

    Raises:
        NotConnected: A standby still runs after ``WAIT_S``.
    """
    for path in _lives(robot, place):
        await _until_ended(path)
    texts = [text for path in _reports(robot, place) if (text := _take(path))]
    for text in texts:
        _log.warning("%s", text)
    return "; ".join(texts) or None


def _lives(robot: str, place: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{LOCK}"):
        found, name = holder(path), path.name.removesuffix(LOCK)
        if found is None:
            continue
        # The caller holds the lock of the place (``port_claim.py``). So no root has it, and a standby of
        # this place belongs to an earlier tree.
        if name == robot or (place and found.place == place):
            yield path


async def _until_ended(path: Path) -> None:
    began_s = trio.current_time()
    while (standby := holder(path)) is not None:
        waited_s = trio.current_time() - began_s
        if waited_s > FROZEN_S and standby.pid and is_stopped(standby.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(standby.pid, signal.SIGKILL)
        if waited_s > WAIT_S:
            report = read(path.with_name(path.name.removesuffix(LOCK) + REPORT))
            doing = f"{report.text}." if report is not None else "root or wire of that tree still run."
            raise NotConnected(
                f"the standby of an earlier tree has not ended (process {standby.pid}): {doing} "
                "Try again when it has; it gives up after a minute"
            )
        await trio.sleep(LOOK_S)


def _reports(robot: str, place: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{REPORT}"):
        report = read(path)
        if report is not None and (path.name == f"{robot}{REPORT}" or (place and report.place == place)):
            yield path


def _take(path: Path) -> str:
    """Return the text of a report, and remove the file, so that it is logged once."""
    report = read(path)
    path.unlink(missing_ok=True)
    if report is None:
        return ""
    return f"{report.robot}: {msgspec.structs.replace(report, over=True).text}"
