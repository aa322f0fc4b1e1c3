"""A robot on a twin, the console in front of it, and a browser."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from tests.cli.command import Command, RobotProcess
from tests.cli.conftest import cli

from .browser import Visitor
from .serving import console_of

__all__ = ["cli"]


class Bench(NamedTuple):
    """A robot and a browser in front of it. ``estop`` is the address of the e-stop's page."""

    robot: RobotProcess
    visitor: Visitor
    estop: str


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    """Give a robot, the console in front of it, and a browser that was let in as operator. The tests of a module
    share them, and leave the robot armed."""
    directory = Path(tempfile.mkdtemp(prefix="sa-"))
    command = Command(directory)
    command.environment["STRANDS_ACTORS_ALLOW"] = "set_joints"
    try:
        with RobotProcess(command) as robot, console_of(command) as facts, Visitor(facts["url"]) as visitor:
            robot.call("release")
            yield Bench(robot, visitor, facts["estop"])
        command.wait_until_gone()
    finally:
        shutil.rmtree(directory, ignore_errors=True)


@pytest.fixture(scope="module")
def shared_visitor() -> Iterator[Visitor]:
    """Give a browser in front of a console without robots, which the tests of a module share."""
    directory = Path(tempfile.mkdtemp(prefix="sa-"))
    try:
        with console_of(Command(directory)) as facts, Visitor(facts["url"]) as visitor:
            yield visitor
    finally:
        shutil.rmtree(directory, ignore_errors=True)
