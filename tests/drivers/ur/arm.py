"""A UR twin, and arms on it that are cleaned up whatever the test does."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from strands_actors import Robot
from strands_actors.caller.robot import RealRobot
from strands_actors.testing import Twin

PAN, LIFT, ELBOW = "shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint"
STEP_RAD = 0.01
"""Within what a joint may be sent in one period."""


@contextlib.contextmanager
def arm_on(twin: Twin, robot: str = "ur5e") -> Iterator[RealRobot]:
    """Connected and armed."""
    arm = Robot(robot, mode="real", port=twin.port)
    try:
        problem = "never tried"
        for _ in range(3):  # on a busy machine a process may be late enough to count as frozen
            problem = arm.connect_eagerly() or ""
            if not problem:
                break
        assert not problem
        yield arm
    finally:
        arm.cleanup()


def pid(arm: RealRobot, role: str) -> int:
    tree = arm.tree()
    assert tree is not None
    found: int = next(process["pid"] for process in tree["processes"] if process["role"] == role)
    return found


def nudge(arm: Any, joint: str = PAN) -> Mapping[str, Any]:
    """A small step from where the joint is, towards zero."""
    now = arm.get_observation().get(joint, 0.0)
    answer: Mapping[str, Any] = arm.send_action({joint: now - math.copysign(STEP_RAD, now)})
    return answer


def wave(amplitude: float = 0.3, rate: float = 2.0) -> Callable[[Mapping[str, float]], dict[str, float]]:
    """A policy: the shoulder goes to and fro from where it is. A pause does not make it jump."""
    zero: list[float] = []
    phase = [0.0]

    def step(observation: Mapping[str, float]) -> dict[str, float]:
        zero.append(observation[PAN])
        phase[0] += rate * 0.008
        return {PAN: zero[0] + amplitude * (1 - math.cos(phase[0])) / 2}

    return step
