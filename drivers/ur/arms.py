"""Read the supported UR arms and their joints from ``robots.toml``."""

from __future__ import annotations

import math
from functools import cache
from typing import Literal

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
"""The names of the joints, in the order in which the controller sends and receives them."""

IDS = tuple(range(len(JOINTS)))

GRIPPER_ID = len(JOINTS)
"""The number of the gripper on the flange, which is the last axis."""

Gripper = Literal["robotiq_2f85", "robotiq_2f85_v4"]
"""The grippers that an arm can have on its flange."""

URCAP = "strands_actors.drivers.robotiq.urcap_client"
GRIPPERS = "strands_actors.drivers.robotiq.robots"
GRIPPER_GATES = "strands_actors.drivers.robotiq.gates"
MOUNTED = "strands_actors.drivers.robotiq.mounted"
"""Modules that drive, check and simulate such a gripper. They are loaded by name, since no driver imports another
one."""

ACTIVATION_S = 12.0
"""Longest time to activate the gripper, which an arming may have to do."""


class Arm(msgspec.Struct, frozen=True):
    """One UR arm: its table in ``robots.toml``, with its dimensions and the limits of its joints."""

    dh_m: tuple[float, float, float, float, float, float]
    range_deg: tuple[float, ...]
    speed_deg_s: tuple[float, ...]
    effort_nm: tuple[float, ...]
    link_kg: tuple[float, ...]
    radius_m: float

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Return the joints as axes. The range of each joint is the same in both directions."""
        rows = zip(JOINTS, map(math.radians, self.range_deg), map(math.radians, self.speed_deg_s), strict=True)
        return tuple(
            Axis(key=key, unit="rad", low=-reach, high=reach, speed=speed, id=number)
            for number, (key, reach, speed) in enumerate(rows)
        )


@cache
def arm_of(robot: str) -> Arm:
    """Return the arm with this robot name. Raise ``ValueError`` if no UR arm has this name."""
    return msgspec.convert(TABLES.table(robot), Arm)
