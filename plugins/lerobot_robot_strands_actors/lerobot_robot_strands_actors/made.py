"""Generate a LeRobot config class and robot class for every arm and base that has a driver."""

import re
from dataclasses import dataclass
from typing import Any

from strands_actors import Robot, list_native_drivers
from strands_actors.contract import PartKind

from .configs import LocalConfig, RemoteConfig
from .lerobot_api import RobotConfig
from .robot import StrandsRobot

KINDS = {PartKind.ARM, PartKind.GRIPPER, PartKind.BASE}
"""A robot needs at least one of these parts. LeRobot's loops are too slow for robots that only have legs
or that fly."""


def robots() -> list[str]:
    """Return the names of the robots that LeRobot can use, sorted."""
    return [name for name in list_native_drivers() if _kinds(name) & KINDS]


def all_made(module: str) -> dict[str, Any]:
    """Return all generated classes by name.

    Args:
        module: The module in which LeRobot looks for the classes.
    """
    pairs = [_made(module, f"strands_{robot}", LocalConfig, {"ROBOT": robot}) for robot in robots()]
    pairs.append(_made(module, "strands_remote", RemoteConfig, {}))
    return {generated.__name__: generated for pair in pairs for generated in pair}


def _made(module: str, name: str, base: type[Any], members: dict[str, Any]) -> tuple[type[Any], type[Any]]:
    """Return the config class and the robot class for ``--robot.type=<name>``."""
    title = "".join(part.capitalize() for part in re.split(r"[^a-z0-9]+", name))
    own = {"__module__": module, "__doc__": base.__doc__}
    config: type[Any] = dataclass(kw_only=True)(type(f"{title}Config", (base,), {**own, **members}))
    RobotConfig.register_subclass(name)(config)
    return config, type(title, (StrandsRobot,), {**own, "config_class": config, "name": name})


def _kinds(name: str) -> set[PartKind]:
    driver = Robot(name, mode="real", transport="twin").driver  # The constructor starts no process.
    return {part.kind for part in driver.parts}
