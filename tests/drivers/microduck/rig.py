"""Shared by the tests of the whole tree: a twin with a duck that is driven, and the twin's log."""

from __future__ import annotations

import json
import time
from typing import Any

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, until
from tests.trees import armed

"""Added to the published bounds, for a busy machine."""


def method(entry: Entry) -> str:
    found: str = json.loads(entry.data)["method"]
    return found


def params(entry: Entry) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(entry.data)["params"]
    return found


def moves(twin: Twin, since_ns: int) -> list[Entry]:
    return [one for one in twin.log.host("setpoint", since_ns) if method(one) == "robot.move"]


def act(duck: RealRobot, twin: Twin, **action: Any) -> int:
    """Send an action to a driven duck and wait until it is on the wire. Return when it was sent."""
    armed(duck)
    json_of(duck.service("enable"))
    began_ns = time.monotonic_ns()
    json_of(duck.send_action(action))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns
