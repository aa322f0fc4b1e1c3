"""Load the robots that the Stretch driver supports from ``robots.toml`` and ``nominal.toml``."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import msgspec

from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Stretch")

HEAD = ("head_pan", "head_tilt")


class Tool(msgspec.Struct, frozen=True):
    joints: tuple[str, ...]
    gripper: int


class Robot(msgspec.Struct, frozen=True):
    """One robot's table in ``robots.toml``."""

    model_name: str
    tool: str
    tools: Mapping[str, Tool]
    home: tuple[float, ...]
    watchdog_s: float
    nominal: Mapping[str, Any]


@cache
def robot_of(name: str) -> Robot:
    """Return a robot's table. Raise ``ValueError`` if this driver does not support the robot."""
    return msgspec.convert(TABLES.table(name), Robot)


def nominal_of(name: str) -> dict[str, Any]:
    """Return the values that all robots of a model share, with the names of the robot's YAML."""
    return merged(_common(), robot_of(name).nominal)


@cache
def _common() -> dict[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath("nominal.toml").read_text("utf-8"))


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Merge two tables. Where both have a value, that of ``above`` is used."""
    whole = copy.deepcopy(dict(below))
    for key, value in above.items():
        lower = whole.get(key)
        both = isinstance(lower, dict) and isinstance(value, Mapping)
        whole[key] = merged(lower or {}, value) if both else copy.deepcopy(value)
    return whole
