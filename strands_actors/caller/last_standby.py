"""The standby of an earlier tree of a robot: it is waited for, and what it did is told.

As long as it lives it may write to the robot, so no other tree is started.
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

from .processes import NotConnected
from .run_directory import run_dir

WAIT_S = 3.0
FROZEN_S = 0.3
"""One that the system has stopped for so long is ended: it would keep the robot for ever."""
LOOK_S = 0.01

_log = logging.getLogger("strands_actors")


async def until_over(robot: str, place: str) -> str | None:
    """Return what standbys of this robot, or of this place (``port_claim.place``; empty: a twin's),
    did since a robot was last started. None: nothing. Raise ``NotConnected`` when one is still at
    work."""
    for path in _lives(robot, place):
        await _until_ended(path)
    told = [text for path in _reports(robot, place) if (text := _take(path))]
    for text in told:
        _log.warning("%s", text)
    return "; ".join(told) or None


def _lives(robot: str, place: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{LOCK}"):
        found, name = holder(path), path.name.removesuffix(LOCK)
        if found is None:
            continue
        # Whoever asks holds the place (``port_claim.py``): no root has it, so it is an earlier tree's.
        if name == robot or (place and found.place == place):
            yield path


async def _until_ended(path: Path) -> None:
    began_s = trio.current_time()
    while (found := holder(path)) is not None:
        waited_s = trio.current_time() - began_s
        if waited_s > FROZEN_S and found.pid and is_stopped(found.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(found.pid, signal.SIGKILL)
        if waited_s > WAIT_S:
            report = read(path.with_name(path.name.removesuffix(LOCK) + REPORT))
            doing = f"{report.text}." if report is not None else "root or wire of that tree still run."
            raise NotConnected(
                f"the standby of an earlier tree has not ended (process {found.pid}): {doing} "
                "Try again when it has; it gives up after a minute"
            )
        await trio.sleep(LOOK_S)


def _reports(robot: str, place: str) -> Iterator[Path]:
    for path in run_dir().glob(f"*{REPORT}"):
        report = read(path)
        if report is not None and (path.name == f"{robot}{REPORT}" or (place and report.place == place)):
            yield path


def _take(path: Path) -> str:
    """Return the report, which is told once."""
    report = read(path)
    path.unlink(missing_ok=True)
    if report is None:
        return ""
    return f"{report.robot}: {msgspec.structs.replace(report, over=True).text}"
