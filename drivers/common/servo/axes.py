"""Per joint, the line between units and counts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from strands_actors.contract import axis as contract
from strands_actors.drivers.common.calibration import MotorCalibration

COUNTS = 4096
"""Encoder counts a turn: Feetech STS and SMS, Dynamixel X."""

TOP = COUNTS - 1
MIDDLE = COUNTS // 2
"""The count at 0 rad of the model."""

COUNTS_PER_DEGREE = TOP / 360
"""4095, not 4096, a turn: what lerobot uses, so that its data sets mean the same here (0.024 % of
scale)."""

COUNTS_PER_RADIAN = COUNTS / math.tau


class Axis(msgspec.Struct, frozen=True):
    """One joint. A value in its unit and a count lie on one line: ``count = zero + scale *
    value``."""

    key: str
    id: int
    model: str
    unit: str  # "deg" or "percent"
    zero: float  # counts at value 0
    scale: float  # counts per unit; negative when the drive is inverted
    low: int  # travel, counts
    high: int
    speed: float  # units per second, unloaded

    def count(self, value: float) -> int:
        return round(self.zero + self.scale * value)

    def value(self, count: int) -> float:
        return (count - self.zero) / self.scale

    @property
    def limits(self) -> tuple[float, float]:
        """Travel in units, lower first."""
        first, second = self.value(self.low), self.value(self.high)
        return min(first, second), max(first, second)

    @property
    def mode(self) -> contract.AxisMode:
        return contract.AxisMode.POSITION

    @property
    def label(self) -> str:
        return f"{self.key} (id {self.id})"

    @property
    def declared(self) -> contract.Axis:
        """Return the joint as the contract has it, without counts."""
        low, high = self.limits
        return contract.Axis(key=self.key, unit=self.unit, low=low, high=high, speed=self.speed, id=self.id)


def axes_of(
    joints: Iterable[Mapping[str, Any]], calibration: Mapping[str, MotorCalibration] | None, host_inverts: bool
) -> tuple[Axis, ...]:
    """Return the ``joints`` of a robot's table, in their order. Without a calibration each has the
    range of its model, around the middle of its servo. ``host_inverts``: drive mode 1 of the
    calibration is ours to apply; otherwise the servo does it."""
    return tuple(
        _axis(joint, None if calibration is None else calibration[joint["key"]], host_inverts) for joint in joints
    )


def _axis(joint: Mapping[str, Any], motor: MotorCalibration | None, host_inverts: bool) -> Axis:
    percent = joint["unit"] == "percent"
    if motor is not None:
        low, high = motor.range_min, motor.range_max
    else:
        low, high = (round(MIDDLE + angle * COUNTS_PER_RADIAN) for angle in joint["range_rad"])
    inverted = host_inverts and motor is not None and motor.drive_mode == 1
    if percent:
        zero = float(high if inverted else low)
        scale = (high - low) / 100
    else:
        zero = TOP / 2 if motor is None else (low + high) / 2
        scale = COUNTS_PER_DEGREE
    return Axis(
        key=joint["key"],
        id=joint["id"],
        model=joint["model"],
        unit=joint["unit"],
        zero=zero,
        scale=-scale if inverted else scale,
        low=max(0, low),
        high=min(TOP, high),
        speed=joint["speed_rad_s"] * COUNTS_PER_RADIAN / scale,
    )
