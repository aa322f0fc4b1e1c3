"""Provide an SO-101 twin on a real pty, and arms on it that are always cleaned up."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.trees import connected

NewArm = Callable[..., RealRobot]


@pytest.fixture(scope="session")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    """Start one twin for all tests, because starting it takes longer than most of them. Its joints stay
    where the last test left them."""
    with Twin("so101", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    """Give a test a healthy robot at rest, with an empty log, and repair it afterwards."""
    os.truncate(twin_process.log.path, 0)
    yield twin_process
    twin_process.go_on()
    twin_process.fault("ok")
    twin_process.plug()


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
    """Return an arm that is connected to the twin and armed."""
    return connected(new_arm(port=twin.port))
