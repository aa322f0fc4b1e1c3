"""The twin of ``tests/robot``, and an arm on it."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of
from tests.robot.conftest import NewArm, new_arm, twin, twin_process
from tests.trees import armed, connected

__all__ = ["arm", "new_arm", "twin", "twin_process"]

LIFETIME_S = 1.0
"""The motions here last up to 5 s. On a busy machine one setpoint of them may be late by more than 0.1 s."""


READY = {"shoulder_pan": 0.0, "shoulder_lift": -60.0, "elbow_flex": 60.0, "wrist_flex": 20.0, "wrist_roll": 0.0}
"""Joint positions of an SO-101 from which its tool has room on all sides."""


@pytest.fixture
def arm(twin: Twin, new_arm: NewArm) -> RealRobot:
    """Return an arm that is connected to the twin and armed."""
    return connected(new_arm(port=twin.port, lifetime=LIFETIME_S))


@pytest.fixture
def ready(arm: RealRobot) -> RealRobot:
    """Return the arm on the twin, in a pose with room around it."""
    armed(arm)
    json_of(arm.move_to(READY, seconds=1.5))
    return arm


@pytest.fixture(scope="module")
def ur(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealRobot]:
    """Give a UR5e that is connected to its twin and armed."""
    with Twin("ur5e", tmp_path_factory.mktemp("ur")) as twin:
        robot = Robot("ur5e", mode="real", port=twin.port)
        try:
            yield connected(robot)
        finally:
            robot.cleanup()
