"""Load a robot and its joints from ``robots.toml``."""

from __future__ import annotations

from functools import cache

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.motor_targets import Joint, parse_joints
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Booster")

FIRST_ARM, LAST_ARM = 2, 9
"""Slots of the upper body's motors. No other slot is ever commanded."""

HEAD = {"pitch": "head_pitch", "yaw": "head_yaw"}
"""The joint that each argument of ``rotate_head`` turns."""

BASE = ("vx", "vy", "vyaw")


class Model(msgspec.Struct, frozen=True):
    """One robot type: its motors, and the limits of its commands."""

    name: str
    motors: tuple[Joint, ...]
    """All motors by slot."""
    max_kp: float
    max_kd: float
    twist: tuple[float, float, float]
    """Largest twist that may be requested: vx, vy in m/s, vyaw in rad/s."""

    @property
    def joints(self) -> tuple[Joint, ...]:
        """Return the motors that may be commanded."""
        return self.motors[FIRST_ARM : LAST_ARM + 1]

    @property
    def table(self) -> tuple[Axis, ...]:
        return tuple(joint.axis for joint in self.joints)

    def limits(self, joint: str) -> tuple[float, float]:
        """Return the range of a motor, in radians."""
        return next((motor.low, motor.high) for motor in self.motors if motor.key == joint)


@cache
def model_of(robot: str) -> Model:
    """Return a robot type by its name or alias. Raise ``ValueError`` if this driver does not
    support it."""
    table = TABLES.table(robot)
    return Model(
        TABLES.canonical(robot),
        parse_joints(table["joints"]),
        float(table["max_kp"]),
        float(table["max_kd"]),
        (float(table["vx_m_s"]), float(table["vy_m_s"]), float(table["vyaw_rad_s"])),
    )
