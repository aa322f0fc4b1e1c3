"""The arms of this wire, as data: a table of ``robots.toml``, and its joints as axes."""

from __future__ import annotations

import math
from functools import cache

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "UR")

JOINTS = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
"""The joints, in the order of the wire."""

IDS = tuple(range(len(JOINTS)))


class Arm(msgspec.Struct, frozen=True):
    """One table of ``robots.toml``."""

    dh_m: tuple[float, float, float, float, float, float]
    range_deg: tuple[float, ...]
    speed_deg_s: tuple[float, ...]
    effort_nm: tuple[float, ...]
    link_kg: tuple[float, ...]
    radius_m: float

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Return the joints. Each turns equally far to both sides."""
        rows = zip(JOINTS, map(math.radians, self.range_deg), map(math.radians, self.speed_deg_s), strict=True)
        return tuple(
            Axis(key=key, unit="rad", low=-reach, high=reach, speed=speed, id=number)
            for number, (key, reach, speed) in enumerate(rows)
        )


@cache
def arm_of(robot: str) -> Arm:
    """Return the table of a robot. Raise ``ValueError`` if it is no robot of this wire."""
    return msgspec.convert(TABLES.table(robot), Arm)
