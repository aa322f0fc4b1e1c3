"""SAF: what one part suffers, or the processes that command all parts, stops every part. Read on both wires."""

from __future__ import annotations

import signal
from pathlib import Path

from .cells import Cell, is_limp, ok, opened, setpoints_after_limp, until

FAULTS: tuple[tuple[tuple[str, ...], signal.Signals], ...] = (
    (("left/wire",), signal.SIGKILL),
    (("right/root",), signal.SIGKILL),
    (("wire",), signal.SIGKILL),
    (("wire",), signal.SIGSTOP),
    (("left/wire", "wire"), signal.SIGKILL),
    (("wire", "root"), signal.SIGKILL),
    (("left/wire",), signal.SIGSTOP),
)
"""Processes that are broken at the same time, and how. After ``wire`` and ``root`` nothing commands the parts."""


def test_every_part_is_stopped_after_any_process_is_broken(tmp_path: Path) -> None:
    """SAF-003: a death is followed by a safe frame, here on every wire. SAF-002: no setpoint after it."""
    with opened(tmp_path) as cell:
        for roles, how in FAULTS:
            cell.move()
            since_ns = cell.kill(*roles, how=how)
            _check_both_stop(cell, since_ns, f"{how.name} {roles}")


def _check_both_stop(cell: Cell, since_ns: int, fault: str) -> None:
    for part, log in cell.logs.items():
        until(lambda log=log: is_limp(log, since_ns), f"{fault}: {part} did not stop")  # type: ignore[misc]
    until(lambda: ok(cell.robot.get_status())["state"] not in ("armed", "holding", "stopping"), f"{fault}: armed")
    for part, log in cell.logs.items():
        assert setpoints_after_limp(log, since_ns) == 0, f"{fault}: {part}: {log.story(since_ns)}"
