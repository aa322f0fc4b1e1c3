"""Two simulated so101 arms as one robot, and what the tests read of them."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from strands_actors import Robot
from strands_actors.testing import Twin, WireLog

PATIENCE_S = 20.0
"""Seconds to wait on a busy machine."""
PARTS = ("left", "right")


class Cell:
    """A ``bi_so101`` on two simulated arms. ``logs`` are those of the frames on each wire."""

    def __init__(self, twins: dict[str, Twin], robot: Any) -> None:
        self.twins = twins
        self.robot = robot

    @property
    def logs(self) -> dict[str, WireLog]:
        return {part: twin.log for part, twin in self.twins.items()}

    def pid(self, role: str) -> int:
        processes = self.robot.tree()["processes"]
        return next(int(each["pid"]) for each in processes if each["role"] == role)

    def move(self) -> None:
        """Arm the robot, and give both arms a target that has no end. A part that was broken may still start."""
        deadline_s = time.monotonic() + PATIENCE_S
        while (answer := self.robot.resume())["status"] != "success":
            assert time.monotonic() < deadline_s, answer
        assert ok(self.robot.send_action({"left_shoulder_pan": 3.0, "right_shoulder_pan": -3.0}))

    def kill(self, *roles: str, how: signal.Signals = signal.SIGKILL) -> int:
        """Send a signal to processes at the same time, and return the time (ns)."""
        pids = [self.pid(role) for role in roles]
        now_ns = time.monotonic_ns()
        for pid in pids:
            os.kill(pid, how)
        return now_ns


def ok(answer: dict[str, Any]) -> dict[str, Any]:
    """Return the JSON of a success. Fail with the text of an error."""
    assert answer["status"] == "success", answer
    json: dict[str, Any] = answer["content"][0]["json"]
    return json or {"": ""}


def until(condition: Callable[[], object], what: str, seen: Callable[[], object] = lambda: "") -> None:
    """Wait for a condition. After ``PATIENCE_S`` fail with ``what`` and with the result of ``seen``."""
    deadline_s = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < deadline_s, f"{what}: {seen()}"
        time.sleep(0.01)


def is_limp(log: WireLog, since_ns: int) -> bool:
    return any(entry.safe_state == "limp" for entry in log.host("safe", since_ns))


def setpoints_after_limp(log: WireLog, since_ns: int) -> int:
    """Return how many setpoints were sent after the first limp frame since a time. The order in the log decides."""
    sent = [entry for entry in log.entries(since_ns) if entry.sender == "host"]
    first = next(i for i, entry in enumerate(sent) if entry.kind == "safe" and entry.safe_state == "limp")
    return sum(entry.kind == "setpoint" for entry in sent[first:])


@contextlib.contextmanager
def opened(directory: Path) -> Iterator[Cell]:
    with contextlib.ExitStack() as stack:
        twins: dict[str, Twin] = {}
        for part in PARTS:
            own = directory / part
            own.mkdir()
            twins[part] = stack.enter_context(Twin("so101", own))
        parts = {part: {"port": twin.port} for part, twin in twins.items()}
        robot = Robot("bi_so101", mode="real", parts=parts, on_exit="limp", lifetime=2.0)
        stack.callback(robot.cleanup)
        problem = robot.connect_eagerly()
        assert problem is None, problem
        yield Cell(twins, robot)
