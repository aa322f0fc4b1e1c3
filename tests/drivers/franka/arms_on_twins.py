"""Franka arms on twins, cleaned up after every test."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from strands_actors.caller.handle.robot import RealRobot
from tests.answers import pids, until

NEAR_RAD = 2e-3


def cycle_of(arm: RealRobot) -> int:
    """Return the process that sends the commands: the wire's only child."""
    wire = pids(arm)["wire"]
    (child,) = Path(f"/proc/{wire}/task/{wire}/children").read_text().split()
    return int(child)


def away(arm: RealRobot, rad: float) -> dict[str, float]:
    """Return a goal at this distance from each joint's position."""
    return {joint: here + rad for joint, here in arm.get_observation().items()}


def is_at(arm: RealRobot, goal: Mapping[str, float]) -> bool:
    seen = arm.get_observation()
    return bool(seen) and all(abs(seen[joint] - rad) < NEAR_RAD for joint, rad in goal.items())


def wait_at(arm: RealRobot, goal: Mapping[str, float]) -> None:
    until(lambda: is_at(arm, goal), "it is there")
