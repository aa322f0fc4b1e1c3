"""A small arm on a pseudo-terminal, and robots on it with a user's class."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers import register_native_driver, register_robot

from .rig import SmallArm

NewRobot = Callable[..., RealRobot]


@pytest.fixture
def small_arm_known() -> None:
    register_robot("small_arm")


@pytest.fixture
def small_arm(tmp_path: Path) -> Iterator[SmallArm]:
    with SmallArm(tmp_path / "port") as arm:
        yield arm


@pytest.fixture
def wrong(tmp_path: Path) -> Path:
    """Return the file that names the fault which the class simulates."""
    return tmp_path / "wrong"


@pytest.fixture
def new_robot(small_arm_known: None, small_arm: SmallArm, wrong: Path) -> Iterator[NewRobot]:
    """Make a robot of a class, and connect it."""
    made: list[RealRobot] = []

    def new(cls: type[Any], **keywords: Any) -> RealRobot:
        register_native_driver("small_arm", cls, overwrite=True)
        robot = Robot("small_arm", mode="real", port=small_arm.port, wrong=str(wrong), **keywords)
        made.append(robot)
        assert robot.connect_eagerly() is None
        return robot

    yield new
    small_arm.answers = True
    wrong.unlink(missing_ok=True)
    for robot in made:
        robot.cleanup()


@pytest.fixture
def small_port(small_arm: SmallArm) -> str:
    return small_arm.port
