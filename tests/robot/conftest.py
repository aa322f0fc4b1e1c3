"""An SO-101 twin on a real pty, and arms on it that are cleaned up whatever the test does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.robot import RealRobot
from strands_actors.testing import Twin

NewArm = Callable[..., RealRobot]


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as process:
        yield process


@pytest.fixture
def new_arm(run_dir: Path) -> Iterator[NewArm]:
    """Make an unconnected arm."""
    made: list[RealRobot] = []

    def new(**keywords: Any) -> RealRobot:
        made.append(Robot("so101", mode="real", **keywords))
        return made[-1]

    yield new
    for arm in made:
        arm.cleanup()


@pytest.fixture
def arm(twin: Twin, new_arm: NewArm) -> RealRobot:
    """Connected to the twin and armed."""
    robot = new_arm(port=twin.port)
    assert robot.connect_eagerly() is None
    return robot
