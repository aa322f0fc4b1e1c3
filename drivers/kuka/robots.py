"""Read the supported KUKA arms and their joints from ``robots.toml``."""

from __future__ import annotations

import math
from functools import cache

import msgspec

from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "KUKA")

FLANGE_M = 0.045
"""From the origin of the last link to the flange: ``attachment_site`` of the model that ``robots.toml`` names."""


class Joint(msgspec.Struct, frozen=True):
    """One joint: its range, top speed and torque, in the units of the data sheet (deg, deg/s, Nm)."""

    key: str
    range_deg: float
    speed_deg_s: float
    effort_nm: float

    @property
    def reach_rad(self) -> float:
        """The largest angle of the joint in rad. Its range is the same in both directions."""
        return math.radians(self.range_deg)

    @property
    def speed_rad_s(self) -> float:
        return math.radians(self.speed_deg_s)


class Arm(msgspec.Struct, frozen=True):
    """One robot."""

    name: str
    joints: tuple[Joint, ...]

    @property
    def part(self) -> Part:
        """The joints as axes that can be commanded. Their ids count from 1."""
        axes = (
            Axis(
                key=joint.key,
                unit="rad",
                low=-joint.reach_rad,
                high=joint.reach_rad,
                speed=joint.speed_rad_s,
                id=number,
            )
            for number, joint in enumerate(self.joints, 1)
        )
        return Part(PartKind.ARM, tuple(axes))

    @property
    def axes(self) -> tuple[str, ...]:
        return tuple(joint.key for joint in self.joints)

    @property
    def speed_rad_s(self) -> tuple[float, ...]:
        return tuple(joint.speed_rad_s for joint in self.joints)


@cache
def arm_of(robot: str) -> Arm:
    """Return an arm by name or alias. Raise ``ValueError`` if no KUKA arm has this name."""
    joints = []
    for line in TABLES.table(robot)["joints"].splitlines():
        if line.strip():
            key, range_deg, speed_deg_s, effort_nm = line.split()
            joints.append(Joint(key, float(range_deg), float(speed_deg_s), float(effort_nm)))
    return Arm(TABLES.canonical(robot), tuple(joints))
