"""Convert between a robot's axes and LeRobot's features, without I/O.

A feature is ``shoulder_pan.pos`` in degrees, or from -100 to 100 over the joint's calibrated range.
"""

import math
from collections.abc import Mapping

from strands_actors.contract import Axis, AxisMode, ReadOnlyJoint

DEGREES = {"rad": math.degrees(1.0), "rad/s": math.degrees(1.0)}
"""Factors to LeRobot's unit of angles, degrees. Some of our drivers use radians."""


class Feature:
    """One number of an action or observation. ``key`` is its name in LeRobot."""

    def __init__(self, axis: str, scale: float, offset: float, is_velocity: bool = False) -> None:
        self.axis = axis
        self.is_velocity = is_velocity
        self.key = f"{axis}.{'vel' if self.is_velocity else 'pos'}"
        self._scale = scale
        self._offset = offset

    def to_lerobot(self, value: float) -> float:
        return self._offset + self._scale * value

    def from_lerobot(self, value: float) -> float:
        return (value - self._offset) / self._scale


def features(
    robot: str, axes: tuple[Axis, ...], travel: Mapping[str, tuple[float, float]], use_degrees: bool
) -> tuple[Feature, ...]:
    """Return one feature per axis, in order.

    Args:
        robot: The robot's name, for the error message.
        axes: The driver's axes.
        travel: Calibrated range (low, high) of each axis; empty without a calibration.
        use_degrees: True for degrees, False for -100 to 100 over the calibrated range.

    Raises:
        ValueError: ``use_degrees`` is False and there is no calibration.
    """
    if not use_degrees and not travel:
        raise ValueError(
            f"use_degrees=false needs a calibration of {robot}, and there is none. "
            "Leave out use_degrees, or give the id of the robot's calibration (--robot.id)"
        )
    return tuple(_feature(axis, None if use_degrees else travel.get(axis.key)) for axis in axes)


def observed_features(joints: tuple[ReadOnlyJoint, ...]) -> tuple[Feature, ...]:
    """Return a feature for each joint that is observed but not commanded. Its angle is in degrees."""
    return tuple(Feature(joint.key, DEGREES.get(joint.unit, 1.0), 0.0) for joint in joints)


def _feature(axis: Axis, travel: tuple[float, float] | None) -> Feature:
    is_velocity = axis.mode is AxisMode.VELOCITY
    if travel is None or axis.unit == "percent" or is_velocity:
        return Feature(axis.key, DEGREES.get(axis.unit, 1.0), 0.0, is_velocity)
    low, high = travel
    scale = 200.0 / (high - low)
    return Feature(axis.key, scale, -100.0 - scale * low)
