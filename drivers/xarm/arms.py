"""Read the arms of this driver from ``robots.toml``: the table of each robot, the types of its arm, and the model
for simulation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.robot_tables import RobotTables

from .grippers import with_gripper
from .protocol import JOINTS, Version

TABLES = RobotTables(__package__, "xArm")

AXES = tuple(f"joint{number}" for number in range(1, JOINTS + 1))
"""Keys of the joints, in the order of the wire."""

Range = tuple[float, float]

ANY_SERIAL = (0, 9999)


class ArmType(msgspec.Struct, frozen=True):
    """One type of an arm. Arms with the same robot name may be of different types."""

    number: int
    range_rad: tuple[Range, Range, Range, Range, Range, Range, Range]
    mirrored: tuple[int, ...] = ()
    serials: Range = ANY_SERIAL

    def fits(self, version: Version) -> bool:
        digits = version.serial[2:6]
        first, last = self.serials
        return version.arm_type == self.number and first <= (int(digits) if digits.isdecimal() else 0) <= last


class Arm(msgspec.Struct, frozen=True):
    """The table of one robot in ``robots.toml``."""

    speed_rad_s: float
    effort_nm: tuple[float, ...]
    home_rad: tuple[float, ...]
    types: tuple[ArmType, ...]

    @property
    def usual(self) -> ArmType:
        """Return the most common type of this arm."""
        return next(arm_type for arm_type in self.types if not arm_type.mirrored and arm_type.serials == ANY_SERIAL)

    def type_of_ranges(self, reported: Sequence[Range]) -> ArmType:
        """Return the type with the joint ranges nearest to those that a controller reports."""

        def difference(arm_type: ArmType) -> float:
            rows = zip(arm_type.range_rad, reported, strict=True)
            return sum(abs(least - low) + abs(most - high) for (least, most), (low, high) in rows)

        return min(self.types, key=difference)

    def type_index(self, version: Version) -> int | None:
        """Return the index in ``types`` of the first type that fits an arm's version; None if no type fits."""
        if version.axes != JOINTS:
            return None
        return next((index for index, arm_type in enumerate(self.types) if arm_type.fits(version)), None)


@cache
def arm_of(robot: str) -> Arm:
    """Return the table of a robot. Raise ``ValueError`` if this driver does not know the robot."""
    return msgspec.convert(TABLES.table(robot), Arm)


def axes_of(arm: Arm) -> tuple[Axis, ...]:
    """Return the axes of an arm, with the joint ranges of its most common type."""
    rows = enumerate(zip(AXES, arm.usual.range_rad, strict=True), 1)
    return tuple(
        Axis(key=key, unit="rad", low=low, high=high, speed=arm.speed_rad_s, id=number)
        for number, (key, (low, high)) in rows
    )


def model_table(robot: str, arm_type: ArmType, gripper: str = "") -> Mapping[str, Any]:
    """Return the table of an arm of this type, in the form that ``drivers/common/physics/model_rows`` reads.

    Args:
        robot: Name of the robot.
        arm_type: The type of its arm.
        gripper: The gripper on its flange (``grippers``); empty for none.
    """
    table, arm = TABLES.table(robot), arm_of(robot)
    rows = []
    for index, row in enumerate(table["model_rows"].strip().splitlines()):
        columns = row.split()
        low, high = arm_type.range_rad[index]
        columns[3] = "-z" if index + 1 in arm_type.mirrored else "z"
        columns[6:9] = f"{low},{high}", str(arm.effort_nm[index]), str(arm.speed_rad_s)
        rows.append(" ".join(columns))
    own = {
        **table,
        "joints": [{"key": axis} for axis in AXES],
        "home_rad": mirrored(arm_type, arm.home_rad),
        "model_rows": "\n".join(rows),
    }
    return with_gripper(own, gripper)


def mirrored(arm_type: ArmType, rad: Sequence[float]) -> tuple[float, ...]:
    """Convert a pose to an arm of this type. Some types turn a joint in the opposite direction, so the signs of
    these joints change, and the arm has the same shape."""
    return tuple(-value if index + 1 in arm_type.mirrored else value for index, value in enumerate(rad))
