"""The arms of this wire, as data: a table of ``robots.toml``, the type of one arm, and the model of
its twin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import msgspec

from strands_actors.contract.axis import Axis
from strands_actors.drivers.common.robot_tables import RobotTables

from .protocol import JOINTS, Version

TABLES = RobotTables(__package__, "xArm")

AXES = tuple(f"joint{number}" for number in range(1, JOINTS + 1))
"""In the order of the wire."""

Range = tuple[float, float]

ANY_SERIAL = (0, 9999)


class ArmType(msgspec.Struct, frozen=True):
    """What differs between arms of one name."""

    number: int
    range_rad: tuple[Range, Range, Range, Range, Range, Range, Range]
    mirrored: tuple[int, ...] = ()
    serials: Range = ANY_SERIAL

    def fits(self, version: Version) -> bool:
        digits = version.serial[2:6]
        first, last = self.serials
        return version.arm_type == self.number and first <= (int(digits) if digits.isdecimal() else 0) <= last


class Arm(msgspec.Struct, frozen=True):
    """One table."""

    speed_rad_s: float
    effort_nm: tuple[float, ...]
    home_rad: tuple[float, ...]
    types: tuple[ArmType, ...]

    @property
    def usual(self) -> ArmType:
        """Return the type of which most arms are."""
        return next(kind for kind in self.types if not kind.mirrored and kind.serials == ANY_SERIAL)

    def type_at(self, version: Version) -> int | None:
        """Return where in ``types`` an arm's type stands (the first that fits), else None."""
        if version.axes != JOINTS:
            return None
        return next((at for at, kind in enumerate(self.types) if kind.fits(version)), None)


@cache
def arm_of(robot: str) -> Arm:
    """Return a robot's table. Raise ``ValueError`` for a robot that is not of this wire."""
    return msgspec.convert(TABLES.table(robot), Arm)


def axes_of(arm: Arm) -> tuple[Axis, ...]:
    """Return the joints, with the ranges of the usual type."""
    rows = enumerate(zip(AXES, arm.usual.range_rad, strict=True), 1)
    return tuple(
        Axis(key=key, unit="rad", low=low, high=high, speed=arm.speed_rad_s, id=number)
        for number, (key, (low, high)) in rows
    )


def model_table(robot: str, kind: ArmType) -> Mapping[str, Any]:
    """Return the arm as ``drivers/common/model_rows`` takes it, of this type."""
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
    """Return the pose of an arm of this type that looks as ``rad`` does on one without mirrored
    joints."""
    return tuple(-value if at + 1 in kind.mirrored else value for at, value in enumerate(rad))
