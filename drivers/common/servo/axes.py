"""Convert the values of a joint between its unit (degrees or percent) and encoder counts."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import msgspec

from strands_actors.contract import axis as contract
from strands_actors.drivers.common.kit.calibration import MotorCalibration

COUNTS = 4096
"""Encoder counts per turn: Feetech STS and SMS, Dynamixel X."""

TOP = COUNTS - 1
MIDDLE = COUNTS // 2
"""The count at 0 rad of the model."""

COUNTS_PER_DEGREE = TOP / 360
"""lerobot uses 4095 counts per turn, not 4096. With the same factor its data sets have the same meaning here
(0.024 % of scale)."""

COUNTS_PER_RADIAN = COUNTS / math.tau


class Axis(msgspec.Struct, frozen=True):
    """One joint and its servo. A value (degrees or percent) and its encoder count are related by
    ``count = zero + scale * value``."""

    key: str
    id: int
    model: str
    unit: str  # "deg" or "percent"
    zero: float  # encoder count at value 0
    scale: float  # encoder counts per unit; negative if the drive is inverted
    low: int  # lowest encoder count of the joint's travel
    high: int
    speed: float  # top speed without load, in units per second

    def count(self, value: float) -> int:
        return round(self.zero + self.scale * value)

    def value(self, count: int) -> float:
        return (count - self.zero) / self.scale

    @property
    def limits(self) -> tuple[float, float]:
        """Lowest and highest value of the joint, in its unit."""
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
        """The joint as an axis in the form that other modules use, without encoder counts."""
        low, high = self.limits
        return contract.Axis(key=self.key, unit=self.unit, low=low, high=high, speed=self.speed, id=self.id)


def axes_of(
    joints: Iterable[Mapping[str, Any]], calibration: Mapping[str, MotorCalibration] | None, host_inverts: bool
) -> tuple[Axis, ...]:
    """Return the axes of a robot, in the order of its table.

    Args:
        joints: The entry ``joints`` of the robot's table.
        calibration: Calibration of each motor, by joint. Without it each joint has the range of its model, around
            the middle of its servo.
        host_inverts: True if this program must reverse a joint with drive mode 1; False if the servo does it.
    """
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
