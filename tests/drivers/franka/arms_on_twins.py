"""Franka arms on twins, cleaned up whatever the test does."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from strands_actors import Robot
from strands_actors.caller.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import until

NEAR_RAD = 2e-3


@contextlib.contextmanager
def arm_on(twin: Twin, robot: str = "panda", **options: Any) -> Iterator[RealRobot]:
    """Connected and armed."""
    arm = Robot(robot, mode="real", port=twin.port, **options)
    try:
        until(lambda: arm.connect_eagerly() is None, "it connects")
        yield arm
    finally:
        arm.cleanup()


def pid(arm: RealRobot, role: str) -> int:
    tree = arm.tree()
    assert tree is not None
    found: int = next(process["pid"] for process in tree["processes"] if process["role"] == role)
    return found


def cycle_of(arm: RealRobot) -> int:
    """The process that sends the commands: the wire's only child."""
    wire = pid(arm, "wire")
    (child,) = Path(f"/proc/{wire}/task/{wire}/children").read_text().split()
    return int(child)


def away(arm: RealRobot, rad: float) -> dict[str, float]:
    """A goal so far from where each joint is."""
    return {joint: here + rad for joint, here in arm.get_observation().items()}


def is_at(arm: RealRobot, goal: Mapping[str, float]) -> bool:
    seen = arm.get_observation()
    return bool(seen) and all(abs(seen[joint] - rad) < NEAR_RAD for joint, rad in goal.items())


def wait_at(arm: RealRobot, goal: Mapping[str, float]) -> None:
    until(lambda: is_at(arm, goal), "it is there")
