"""One config and one class of LeRobot's for every arm and base there is a driver for."""

import re
from dataclasses import dataclass
from typing import Any

from lerobot.robots import RobotConfig

from strands_actors import Robot, list_native_drivers
from strands_actors.contract import PartKind

from .configs import LocalConfig, RemoteConfig
from .robot import StrandsRobot

KINDS = {PartKind.ARM, PartKind.GRIPPER, PartKind.BASE}
"""A robot with one of these. What is legs alone, or flies, no loop of LeRobot's is quick enough for."""


def robots() -> list[str]:
    """Return the robots that LeRobot gets, sorted."""
    return [name for name in list_native_drivers() if _kinds(name) & KINDS]


def all_made(module: str) -> dict[str, Any]:
    """Return all classes by name. ``module``: where LeRobot will look for them."""
    made = [_made(module, f"strands_{robot}", LocalConfig, {"ROBOT": robot}) for robot in robots()]
    made.append(_made(module, "strands_remote", RemoteConfig, {}))
    return {one.__name__: one for pair in made for one in pair}


def _made(module: str, name: str, base: type[Any], members: dict[str, Any]) -> tuple[type[Any], type[Any]]:
    """Return config and robot ``name``, which LeRobot knows as its ``--robot.type``."""
    title = "".join(part.capitalize() for part in re.split(r"[^a-z0-9]+", name))
    own = {"__module__": module, "__doc__": base.__doc__}
    config: type[Any] = dataclass(kw_only=True)(type(f"{title}Config", (base,), {**own, **members}))
    RobotConfig.register_subclass(name)(config)
    return config, type(title, (StrandsRobot,), {**own, "config_class": config, "name": name})


def _kinds(name: str) -> set[PartKind]:
    driver = Robot(name, mode="real", transport="twin").driver  # nothing is started
    return {part.kind for part in driver.parts}
