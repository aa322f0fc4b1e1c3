"""What the tests of the whole tree share: a twin with a duck that is driven, and what it heard."""

from __future__ import annotations

import json
import time
from typing import Any

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, until
from tests.trees import armed

"""On the published bounds, for a busy machine."""


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
    armed(duck)
    json_of(duck.service("enable"))
    began_ns = time.monotonic_ns()
    json_of(duck.send_action(action))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns
