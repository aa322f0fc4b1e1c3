"""What the tests of the whole tree share: a twin with a duck that is driven, and what it heard."""

from __future__ import annotations

import json
import time
from typing import Any

from strands_actors.caller.robot import RealRobot
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, state, until

SLACK_S = 1.0
"""On the published bounds, for a busy machine."""


def connected(robot: RealRobot) -> RealRobot:
    problem: str | None = "never tried"
    for _ in range(3):  # on a busy machine a process may be late enough to count as frozen
        problem = robot.connect_eagerly()
        if problem is None:
            break
    assert problem is None
    return robot


def pid(duck: RealRobot, role: str) -> int:
    tree = duck.tree()
    assert tree is not None
    found: int = next(process["pid"] for process in tree["processes"] if process["role"] == role)
    return found


def method(entry: Entry) -> str:
    found: str = json.loads(entry.data)["method"]
    return found


def params(entry: Entry) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(entry.data)["params"]
    return found


def moves(twin: Twin, since_ns: int) -> list[Entry]:
    return [one for one in twin.log.host("setpoint", since_ns) if method(one) == "robot.move"]


def act(duck: RealRobot, twin: Twin, **action: Any) -> int:
    """Send it to a duck that is driven, and see it on the wire; when."""
    if state(duck) not in ("armed", "holding"):
        until(lambda: duck.resume()["status"] == "success", "it is armed")
    json_of(duck.service("enable"))
    began_ns = time.monotonic_ns()
    json_of(duck.send_action(action))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def first_safe(twin: Twin, since_ns: int) -> Entry:
    return until(lambda: twin.log.first_safe(since_ns), "a safe frame")
