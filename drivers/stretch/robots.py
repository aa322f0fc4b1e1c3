"""The robots of this wire, as data: ``robots.toml`` and ``nominal.toml``."""

from __future__ import annotations

import copy
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import msgspec

from strands_actors.drivers.common.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Stretch")

HEAD = ("head_pan", "head_tilt")


class Tool(msgspec.Struct, frozen=True):
    joints: tuple[str, ...]
    gripper: int


class Robot(msgspec.Struct, frozen=True):
    """One table."""

    model_name: str
    tool: str
    tools: Mapping[str, Tool]
    home: tuple[float, ...]
    watchdog_s: float
    nominal: Mapping[str, Any]


@cache
def robot_of(name: str) -> Robot:
    """Raise ``ValueError`` for a robot that is not of this wire."""
    return msgspec.convert(TABLES.table(name), Robot)


def nominal_of(name: str) -> dict[str, Any]:
    """Return what all robots of a model have in common, in the words of the robot's YAML."""
    return merged(_common(), robot_of(name).nominal)


@cache
def _common() -> dict[str, Any]:
    return tomllib.loads(resources.files(__package__).joinpath("nominal.toml").read_text("utf-8"))


def merged(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Return both, table by table; where both say something, ``above`` does."""
    whole = copy.deepcopy(dict(below))
    for key, value in above.items():
        found = whole.get(key)
        both = isinstance(found, dict) and isinstance(value, Mapping)
        whole[key] = merged(found or {}, value) if both else copy.deepcopy(value)
    return whole
