"""Load the robots that this driver supports from ``robots.toml``, and convert between radians and
servo degrees. No other module converts them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache

import msgspec

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Yahboom")

BASE = ("linear.x", "linear.y", "angular.z")
"""Keys of the base, in the order of a ``Twist``."""

ARM_JOINTS = 5
"""Number of joints with a sign in ``joint_signs``. The last of the six servos is the gripper's."""


class Servo(msgspec.Struct, frozen=True):
    """One servo. It is commanded in whole degrees."""

    key: str
    low_deg: int
    high_deg: int
    zero_deg: float
    scale: float = 180.0 / math.pi
    """Degrees per radian; negative if the servo turns the other way."""

    def degrees(self, rad: float) -> float:
        return self.zero_deg + self.scale * rad

    def whole_degrees(self, rad: float) -> int:
        """Convert radians to the whole degrees that the servo is commanded in. Raise ``ValueError``
        for a value that is not finite."""
        return round(self.degrees(rad))

    def radians(self, degrees: float) -> float:
        return (degrees - self.zero_deg) / self.scale

    def turned(self, reported_rad: float) -> float:
        """Convert a position that the robot reports to the sign of the commands. The robot knows
        nothing of ``joint_signs``, and its reported radians increase with the servo's degrees
        [assumed]."""
        return reported_rad if self.scale > 0 else -reported_rad

    @property
    def limits_rad(self) -> tuple[float, float]:
        low, high = sorted((self.radians(self.low_deg), self.radians(self.high_deg)))
        return low, high


class M3Pro(msgspec.Struct, frozen=True):
    """The table of one robot in ``robots.toml``."""

    max_m_s: float
    max_rad_s: float
    home_deg: tuple[int, ...]
    watchdog_s: float
    odometry_hz: float
    ramp_m_s2: float
    ramp_rad_s2: float
    servo_deg_s: float
    servos: tuple[Servo, ...]

    def servos_by(self, signs: Sequence[float]) -> tuple[Servo, ...]:
        """Return the servos with the signs of the option ``joint_signs`` applied to the arm joints."""
        return tuple(
            msgspec.structs.replace(servo, scale=sign * servo.scale)
            for servo, sign in zip(self.servos, (*signs, 1.0), strict=True)
        )


@cache
def table_of(robot: str) -> M3Pro:
    """Return a robot's table. Raise ``ValueError`` if this driver does not support the robot."""
    return msgspec.convert(TABLES.table(robot), M3Pro)


def base_axes(table: M3Pro) -> tuple[Axis, ...]:
    """Return the axes of the base. Their ids are 7 to 9, since the servos have 1 to 6."""
    limits = (table.max_m_s, table.max_m_s, table.max_rad_s)
    units = ("m/s", "m/s", "rad/s")
    return tuple(
        Axis(key=key, unit=unit, low=-limit, high=limit, mode=AxisMode.VELOCITY, id=number)
        for number, (key, unit, limit) in enumerate(zip(BASE, units, limits, strict=True), 7)
    )


def servo_axes(servos: Sequence[Servo]) -> tuple[Axis, ...]:
    """Return the axes of the arm and its gripper."""
    return tuple(
        Axis(key=servo.key, unit="rad", low=servo.limits_rad[0], high=servo.limits_rad[1], id=number)
        for number, servo in enumerate(servos, 1)
    )
