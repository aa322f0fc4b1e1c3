"""Load the robots that the Microduck driver supports from ``robots.toml``."""

from __future__ import annotations

import msgspec

from strands_actors.contract.axis import Axis, AxisMode
from strands_actors.drivers.common.kit.robot_tables import RobotTables

TABLES = RobotTables(__package__, "Microduck")

TWIST = ("vx", "vy", "vyaw")
HEAD = ("neck_pitch", "head_pitch", "head_yaw", "head_roll")
POSE = ("z", "roll", "pitch", "active")
MOUTH = ("open",)
AXES = (*TWIST, *HEAD, *POSE, *MOUTH)
"""All axes, in the order of a row."""

HEAD_AT = slice(3, 7)
POSE_AT = slice(7, 11)
ACTIVE, OPEN = 10, 11

HEAD_JOINTS = slice(5, 9)
"""The joints of the head in one of robotd's rows."""


class ModeLimits(msgspec.Struct, frozen=True):
    """The limits of a twist in one drive mode."""

    forward: float  # largest speed forward, m/s
    backward: float
    side: float
    turn: float  # largest turn rate, rad/s


def axes_of(robot: str) -> tuple[Axis, ...]:
    """Return the axes of a robot, in the order of a target's values. Raise ``ValueError`` for an unknown robot."""
    rows = TABLES.table(robot)["axes"]
    modes = {"v": AxisMode.VELOCITY, "p": AxisMode.POSITION}
    return tuple(
        Axis(key=key, unit=unit, low=float(low), high=float(high), mode=modes[mode], id=number)
        for number, (key, (unit, low, high, mode)) in enumerate(rows.items(), 1)
    )


def modes_of(robot: str) -> dict[str, ModeLimits]:
    """Return the drive modes of a robot by name, in the order of their codes. Raise ``ValueError`` for an
    unknown robot."""
    return msgspec.convert(TABLES.table(robot)["modes"], dict[str, ModeLimits])
