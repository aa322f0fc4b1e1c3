"""A script that holds an arm raised. The drill kills it.

It reads its settings as one line of JSON: ``robot``, ``port``, ``options``, and ``pose`` (a value for each joint to
move; null if a person raises the arm). It prints a line of JSON for each state that it has reached:

* ``connected``: a person may raise the arm, which has no torque then,
* ``raised``: the arm is energised and holds its pose.

It ends with code 1 and the text of the error if it cannot go on.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Mapping
from typing import Any

from strands_actors import Robot
from strands_actors.caller.poses.tool_targets import ToolTargets

RAISE_S = 2.0
HIGHER_M = 0.1
"""A person has to raise the tool by so much."""
STILL_M = 0.005
STILL_S = 1.0
"""The arm is raised when its tool has moved by less than ``STILL_M`` for so long."""
BY_HAND_S = 90.0
LOOK_S = 0.1


def main() -> int:
    """Raise the arm, hold it, and wait to be killed. Return 1 if that is not possible."""
    settings = json.loads(sys.stdin.readline())
    robot: Any = Robot(settings["robot"], mode="real", port=settings["port"], **settings["options"])
    problem = robot.connect_eagerly()
    if problem is None:
        problem = _moved(robot, settings["pose"]) if settings["pose"] else _raised_by_hand(robot)
    if problem is not None:
        print(problem, file=sys.stderr)
        return 1
    _tell("raised")
    while True:
        time.sleep(1.0)


def _tell(state: str) -> None:
    print(json.dumps({"state": state}), flush=True)


def _moved(robot: Any, pose: Mapping[str, float]) -> str | None:
    _tell("connected")
    return _problem(robot.move_to(pose, seconds=RAISE_S))


def _problem(answer: Mapping[str, Any]) -> str | None:
    return None if answer["status"] == "success" else answer["content"][0]["text"]


def _raised_by_hand(robot: Any) -> str | None:
    """Wait until a person has raised the arm and holds it still, then energise it where it is."""
    # A person cannot move an arm that holds itself.
    if (problem := _problem(robot.stop())) is not None:
        return problem
    tool = ToolTargets(robot.driver)
    first = tool.place(robot.get_observation())
    if first is None:
        return "not every joint can be read"
    before = first
    _tell("connected")
    still_s, deadline_s = time.monotonic(), time.monotonic() + BY_HAND_S
    while time.monotonic() < deadline_s:
        time.sleep(LOOK_S)
        here = tool.place(robot.get_observation()) or before
        if math.dist(here, before) > STILL_M:
            before, still_s = here, time.monotonic()
        if here[2] - first[2] >= HIGHER_M and time.monotonic() - still_s >= STILL_S:
            return _problem(robot.resume())
    return f"the tool was not raised by {HIGHER_M * 100:.0f} cm and held still within {BY_HAND_S:.0f} s"


if __name__ == "__main__":
    sys.exit(main())
