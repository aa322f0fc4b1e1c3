"""Let one robot move, stop and resume, for ``check_driver``.

The command is ``python -m strands_actors.testing.life JSON``. The JSON object has ``robot``, ``port`` and
``driver``. On success the program prints one line about the robot and ends with code 0. Otherwise it prints the
problem.
"""

from __future__ import annotations

import json
import math
import sys
import time
from typing import Any

from strands_actors import Robot

from .registering import register

STILL_S = 3.0
"""Seconds after which a robot that fell lies still."""
ON_THE_WIRE_S = 0.1
"""Seconds after which a setpoint has left, also on a wire that may only answer its robot once in a cycle."""


def main(text: str) -> None:
    """Connect the robot, command its present position, stop it, and resume it.

    Args:
        text: The settings as JSON.

    Raises:
        SystemExit: A step has failed. The text describes the problem.
    """
    settings = json.loads(text)
    register(settings["driver"], settings["robot"])
    robot: Any = Robot(settings["robot"], mode="real", port=settings["port"])
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
    """Command the first axis to its present position, and return that action.

    A robot that has just fallen may have moved before the command arrives, so the command is repeated.
    """
    until_s = time.monotonic() + STILL_S
    while True:
        observation = robot.get_observation()
        _must(bool(observation), "an armed robot shows no observation")
        axis, position = next(iter(observation.items()))
        _must(math.isfinite(position), f"{axis} was not measured")
        still = dict(observation) if robot.driver.WHOLE_ACTIONS else {axis: position}
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


def _must_do(answer: dict[str, Any], step: str) -> None:
    _must(answer["status"] == "success", f"{step}: {answer['content'][0].get('text')}")


if __name__ == "__main__":
    main(sys.argv[1])
