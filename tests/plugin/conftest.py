"""Import the plugin as LeRobot does, with a stand-in for LeRobot."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
PLUGIN = HERE.parents[1] / "plugins" / "lerobot_robot_strands_actors"

Make = Callable[..., Any]


@pytest.fixture(scope="module")
def plugin() -> Iterator[Any]:
    paths = [str(HERE / "standin"), str(PLUGIN)]
    sys.path[:0] = paths
    try:
        yield importlib.import_module("lerobot_robot_strands_actors")
    finally:
        for path in paths:
            sys.path.remove(path)
        for name in [name for name in sys.modules if name.partition(".")[0] in ("lerobot", PLUGIN.name)]:
            del sys.modules[name]


@pytest.fixture
def make(plugin: Any) -> Iterator[Make]:
    """Make a robot as LeRobot does, from its type and the options of a command line, and disconnect it after
    the test."""
    made: list[Any] = []

    def new(robot_type: str, **said: Any) -> Any:
        choice = sys.modules["lerobot.robots"].RobotConfig.choices[robot_type]  # type: ignore[attr-defined]
        robot_class = getattr(sys.modules[choice.__module__], choice.__name__.removesuffix("Config"))
        robot = robot_class(choice(**said))
        made.append(robot)
        return robot

    yield new
    for robot in made:
        if robot.is_connected:
            robot.disconnect()
