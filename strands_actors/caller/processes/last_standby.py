"""Wait until the standby process of a robot's earlier run has ended, and log its report.

A standby is the last process that can stop a robot. While it runs, it may write to the robot. So no other
process is started for the robot before the standby has ended.
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


async def until_over(robot: str, port_identity: str) -> str | None:
    """Wait for the end of the standby processes of earlier runs. Return those reports of them that were not
    returned before.

    Args:
        robot: Name of the robot. The standby processes of this robot are waited for.
        port_identity: Identifies the robot's port (``port_claim.port_identity``); empty for a simulated robot. The
            standby processes of this port are waited for, too.

    Returns:
        The reports as one text; None if there are no reports.

    Raises:
        NotConnected: A standby still runs after ``WAIT_S``.
    """
    for path in _lives(robot, port_identity):
        await _until_ended(path)
    texts = [text for path in _reports(robot, port_identity) if (text := _take(path))]
    for text in texts:
        _log.warning("%s", text)
    return "; ".join(texts) or None


def _lives(robot: str, port_identity: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{LOCK}"):
        standby, name = holder(path), path.name.removesuffix(LOCK)
        if standby is None:
            continue
        # The caller holds the lock of this port (``port_claim.py``), so no root process holds it. A standby of
        # this port therefore belongs to an earlier run.
        if name == robot or (port_identity and standby.place == port_identity):
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


def _reports(robot: str, port_identity: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{REPORT}"):
        report = read(path)
        if report is not None and (
            path.name == f"{robot}{REPORT}" or (port_identity and report.place == port_identity)
        ):
            yield path


def _take(path: Path) -> str:
    """Return the text of a standby's report, and remove its file, so that the report is logged only once."""
    report = read(path)
    path.unlink(missing_ok=True)
    if report is None:
        return ""
    return f"{report.robot}: {msgspec.structs.replace(report, over=True).text}"
