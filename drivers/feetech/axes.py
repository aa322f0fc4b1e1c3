"""The robots of this wire, as data: ``robots.toml``, and per joint the line between units and counts."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import Any

import msgspec

from strands_actors.drivers.common.calibration import MotorCalibration

from .protocol import COUNTS

TOP = COUNTS - 1
MIDDLE = COUNTS // 2
"""The count at 0 rad of the model."""

COUNTS_PER_DEGREE = TOP / 360
"""4095, not 4096, a turn: what lerobot uses, so that its data sets mean the same here (0.024 % of scale)."""

COUNTS_PER_RADIAN = COUNTS / math.tau


class Axis(msgspec.Struct, frozen=True):
    """One joint. A value in its unit and a count lie on one line: ``count = zero + scale * value``."""

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
    def label(self) -> str:
        return f"{self.key} (id {self.id})"


@cache
def robots() -> Mapping[str, Mapping[str, Any]]:
    """The tables of ``robots.toml`` by robot name."""
    return tomllib.loads(resources.files(__package__).joinpath("robots.toml").read_text("utf-8"))


@cache
def aliases() -> Mapping[str, str]:
    """Other names a robot answers to -> its name."""
    return {alias: name for name, table in robots().items() for alias in table.get("aliases", ())}


def canonical(robot: str) -> str:
    """The name of ``robot``'s table. Raise ``ValueError`` for a robot that is not of this wire."""
    name = aliases().get(robot, robot)
    if name not in robots():
        raise ValueError(f"{robot} is not a Feetech robot. Use one of {', '.join(robots())}")
    return name


def motor_ids(robot: str) -> dict[str, int]:
    return {joint["key"]: joint["id"] for joint in robots()[robot]["joints"]}


def axes_of(robot: str, calibration: Mapping[str, MotorCalibration] | None) -> tuple[Axis, ...]:
    """The joints of ``robot`` in action order. Without a calibration a joint in degrees has the whole turn,
    and a gripper's percent spans the range of its model."""
    return tuple(
        _axis(joint, None if calibration is None else calibration[joint["key"]])
        for joint in robots()[robot]["joints"]
    )


def _axis(joint: Mapping[str, Any], motor: MotorCalibration | None) -> Axis:
    percent = joint["unit"] == "percent"
    if motor is not None:
        low, high = motor.range_min, motor.range_max
    elif percent:
        low, high = (round(MIDDLE + angle * COUNTS_PER_RADIAN) for angle in joint["range_rad"])
    else:
        low, high = 0, TOP
    inverted = motor is not None and motor.drive_mode == 1
    if percent:
        zero = float(high if inverted else low)
        scale = (high - low) / 100
    else:
        zero = (low + high) / 2
        scale = COUNTS_PER_DEGREE
    return Axis(
        key=joint["key"],
        id=joint["id"],
        model=joint["model"],
        unit=joint["unit"],
        zero=zero,
        scale=-scale if inverted else scale,
        low=low,
        high=high,
        speed=joint["speed_rad_s"] * COUNTS_PER_RADIAN / scale,
    )
