"""The robots of this wire, as data: a table of ``robots.toml`` and its joints."""

from __future__ import annotations

from functools import cache

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.motor_targets import Joint, parse_joints
from strands_actors.drivers.common.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Booster")

FIRST_ARM, LAST_ARM = 2, 9
"""Slots of the upper body's motors: no other slot is ever commanded."""

HEAD = {"pitch": "head_pitch", "yaw": "head_yaw"}
"""What turns the head, and the joint that it turns."""

BASE = ("vx", "vy", "vyaw")


class Model(msgspec.Struct, frozen=True):
    """One robot: what is said to it, and what it may be told."""

    name: str
    motors: tuple[Joint, ...]
    """All of them, by slot."""
    max_kp: float
    max_kd: float
    twist: tuple[float, float, float]
    """Fastest that may be asked for: vx, vy in m/s, vyaw in rad/s."""

    @property
    def joints(self) -> tuple[Joint, ...]:
        """Those that may be commanded."""
        return self.motors[FIRST_ARM : LAST_ARM + 1]

    @property
    def table(self) -> tuple[Axis, ...]:
        return tuple(joint.axis for joint in self.joints)

    def limits(self, joint: str) -> tuple[float, float]:
        """Range of any motor, radians."""
        return next((motor.low, motor.high) for motor in self.motors if motor.key == joint)


@cache
def model_of(robot: str) -> Model:
    """By name or alias. Raise ``ValueError`` for a robot that is not of this wire."""
    table = TABLES.table(robot)
    return Model(
        TABLES.canonical(robot),
        parse_joints(table["joints"]),
        float(table["max_kp"]),
        float(table["max_kd"]),
        (float(table["vx_m_s"]), float(table["vy_m_s"]), float(table["vyaw_rad_s"])),
    )
