"""Between a robot's own axes and LeRobot's features: ``shoulder_pan.pos`` in degrees, or in shares
of the calibrated range. Pure."""

import math
from collections.abc import Mapping

from strands_actors.contract import Axis, AxisMode, ReadOnlyJoint

DEGREES = {"rad": math.degrees(1.0), "rad/s": math.degrees(1.0)}
"""LeRobot counts angles in degrees; some of our robots in radians."""


class Feature:
    """One number of an action or observation. ``key``: its name in LeRobot."""

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
    """Return a feature an axis, in order. Raise ``ValueError`` when shares of a calibrated range
    are wanted and there is no calibration."""
    if not use_degrees and not travel:
        raise ValueError(
            f"use_degrees=false counts in shares of each joint's calibrated range, and {robot} has no calibration. "
            "leave it out, or give the id that the robot was calibrated under (--robot.id)"
        )
    return tuple(_feature(axis, None if use_degrees else travel.get(axis.key)) for axis in axes)


def observed_features(joints: tuple[ReadOnlyJoint, ...]) -> tuple[Feature, ...]:
    """Return a feature for each joint that is observed and takes no action, always in degrees."""
    return tuple(Feature(joint.key, DEGREES.get(joint.unit, 1.0), 0.0) for joint in joints)


def _feature(axis: Axis, travel: tuple[float, float] | None) -> Feature:
    is_velocity = axis.mode is AxisMode.VELOCITY
    if travel is None or axis.unit == "percent" or is_velocity:
        return Feature(axis.key, DEGREES.get(axis.unit, 1.0), 0.0, is_velocity)
    low, high = travel
    scale = 200.0 / (high - low)
    return Feature(axis.key, scale, -100.0 - scale * low)
