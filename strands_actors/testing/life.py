"""One short life of a robot, for ``check_driver``: ``python -m strands_actors.testing.life JSON``
with ``robot``, ``port`` and ``driver``. Ends with code 0 and a line on what was seen, or with what
went wrong."""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

from strands_actors import Robot

from .registering import register

STILL_S = 3.0
"""By then a robot lies where it fell."""
ON_THE_WIRE_S = 0.1
"""By then a setpoint has left, on a wire too that may only answer its robot once in a cycle."""


def main(text: str) -> None:
    wanted = json.loads(text)
    register(wanted["driver"], wanted["robot"])
    robot: Any = Robot(wanted["robot"], mode="real", port=wanted["port"])
    problem = robot.connect_eagerly()
    _must(problem is None, f"connect: {problem}")
    try:
        _prepare(robot)
        still = _stand_still(robot)
        time.sleep(ON_THE_WIRE_S)
        _must_do(robot.stop(), "stop")
        _must(robot.send_action(still)["status"] == "error", "after a stop a command is accepted")
        _must_do(robot.resume(), "resume")
        _prepare(robot)
        _stand_still(robot)
    finally:
        robot.cleanup()
    print(f"{len(robot.driver.axes)} axes, stopped, resumed")


def _stand_still(robot: Any) -> dict[str, float]:
    """Tell the first axis to be where it is, and return that action. A robot that has just fallen
    may be somewhere else by then: it is asked again."""
    until_s = time.monotonic() + STILL_S
    while True:
        seen = robot.get_observation()
        _must(bool(seen), "an armed robot shows no observation")
        axis, here = next(iter(seen.items()))
        _must(math.isfinite(here), f"{axis} was not measured")
        still = dict(seen) if robot.driver.WHOLE_ACTIONS else {axis: here}
        answer = robot.send_action(still)
        if answer["status"] == "success":
            return still
        _must(time.monotonic() < until_s, f"the measured position is refused: {answer['content'][0].get('text')}")


def _prepare(robot: Any) -> None:
    if robot.driver.BEFORE_MOTION:
        _must_do(robot.service(robot.driver.BEFORE_MOTION), robot.driver.BEFORE_MOTION)


def _must(fact: bool, otherwise: str) -> None:
    if not fact:
        raise SystemExit(otherwise)


def _must_do(answer: dict[str, Any], what: str) -> None:
    _must(answer["status"] == "success", f"{what}: {answer['content'][0].get('text')}")


if __name__ == "__main__":
    main(sys.argv[1])
