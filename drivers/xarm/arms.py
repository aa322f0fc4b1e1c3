"""Read the arms of this wire from ``robots.toml``: a robot's table, the type of one arm, and the model of
its twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.kit.robot_tables import RobotTables

from .protocol import JOINTS, Version

TABLES = RobotTables(__package__, "xArm")

AXES = tuple(f"joint{number}" for number in range(1, JOINTS + 1))
"""Keys of the joints, in the order of the wire."""

Range = tuple[float, float]

ANY_SERIAL = (0, 9999)


class ArmType(msgspec.Struct, frozen=True):
    """The properties in which arms of the same name differ."""

    number: int
    range_rad: tuple[Range, Range, Range, Range, Range, Range, Range]
    mirrored: tuple[int, ...] = ()
    serials: Range = ANY_SERIAL

    def fits(self, version: Version) -> bool:
        digits = version.serial[2:6]
        first, last = self.serials
        return version.arm_type == self.number and first <= (int(digits) if digits.isdecimal() else 0) <= last


class Arm(msgspec.Struct, frozen=True):
    """One robot's table."""

    speed_rad_s: float
    effort_nm: tuple[float, ...]
    home_rad: tuple[float, ...]
    types: tuple[ArmType, ...]

    @property
    def usual(self) -> ArmType:
        """The type of most arms."""
        return next(kind for kind in self.types if not kind.mirrored and kind.serials == ANY_SERIAL)

    def type_at(self, version: Version) -> int | None:
        """Return the index in ``types`` of an arm's type, the first that fits; None if no type fits."""
        if version.axes != JOINTS:
            return None
        return next((at for at, kind in enumerate(self.types) if kind.fits(version)), None)


@cache
def arm_of(robot: str) -> Arm:
    """Return a robot's table. Raise ``ValueError`` if the robot does not belong to this wire."""
    return msgspec.convert(TABLES.table(robot), Arm)


def axes_of(arm: Arm) -> tuple[Axis, ...]:
    """Return the joints, with the ranges of the usual type."""
    rows = enumerate(zip(AXES, arm.usual.range_rad, strict=True), 1)
    return tuple(
        Axis(key=key, unit="rad", low=low, high=high, speed=arm.speed_rad_s, id=number)
        for number, (key, (low, high)) in rows
    )


def model_table(robot: str, kind: ArmType) -> Mapping[str, Any]:
    """Return the arm of this type in the form that ``drivers/common/model_rows`` takes."""
    table, arm = TABLES.table(robot), arm_of(robot)
    rows = []
    for at, row in enumerate(table["model_rows"].strip().splitlines()):
        columns = row.split()
        low, high = kind.range_rad[at]
        columns[3] = "-z" if at + 1 in kind.mirrored else "z"
        columns[6:9] = f"{low},{high}", str(arm.effort_nm[at]), str(arm.speed_rad_s)
        rows.append(" ".join(columns))
    return {
        **table,
        "joints": [{"key": axis} for axis in AXES],
        "home_rad": mirrored(kind, arm.home_rad),
        "model_rows": "\n".join(rows),
    }


def mirrored(kind: ArmType, rad: Sequence[float]) -> tuple[float, ...]:
    """Convert a pose of an arm without mirrored joints to the same shape of an arm of this type."""
    return tuple(-value if at + 1 in kind.mirrored else value for at, value in enumerate(rad))
