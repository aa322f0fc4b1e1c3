"""Load the robots that the RB-Y1 driver supports from ``robots.toml``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.drivers.common.kit.robot_tables import RobotTables

from .commands import PARTS

TABLES = RobotTables(__package__, "RB-Y1")

_KINDS = {"torso": PartKind.TORSO, "right_arm": PartKind.ARM, "left_arm": PartKind.ARM, "head": PartKind.HEAD}

FIRST_JOINT = 2
"""Index of the first driven joint on a model A: the wheels come before it. The list of joints that the
robot sends decides on the real one."""


def parts_of(table: Mapping[str, Any]) -> tuple[Part, ...]:
    """Return the body parts of a robot, with the joint ranges and speeds from its table."""
    axes = [
        Axis(key=joint["key"], unit="rad", low=low, high=high, speed=joint["speed_rad_s"], id=number)
        for number, joint in enumerate(table["joints"], FIRST_JOINT)
        for low, high in (joint["range_rad"],)
    ]
    parts, start = [], 0
    for name, count in PARTS.items():
        side = name.removesuffix("_arm") if name.endswith("_arm") else ""
        parts.append(Part(_KINDS[name], tuple(axes[start : start + count]), side))
        start += count
    return tuple(parts)
