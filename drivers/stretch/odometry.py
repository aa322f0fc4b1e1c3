"""Compute the pose of a base with two wheels from their positions. Pure: no I/O."""

from __future__ import annotations

import math
from typing import NamedTuple


class Pose(NamedTuple):
    x_m: float
    y_m: float
    yaw_rad: float


START = Pose(0.0, 0.0, 0.0)


def moved(pose: Pose, left_m: float, right_m: float, separation_m: float) -> Pose:
    """Return the pose after the wheels have turned by these distances. The base moves on an arc."""
    distance_m, turn_rad = (left_m + right_m) / 2, (right_m - left_m) / separation_m
    # The chord of the arc has the length of the arc times sin(a/2)/(a/2), where a is the turn. It points in the
    # mean direction.
    chord_m = distance_m * (math.sin(turn_rad / 2) / (turn_rad / 2) if abs(turn_rad) > 1e-9 else 1.0)
    heading_rad = pose.yaw_rad + turn_rad / 2
    return Pose(
        pose.x_m + chord_m * math.cos(heading_rad),
        pose.y_m + chord_m * math.sin(heading_rad),
        math.remainder(pose.yaw_rad + turn_rad, math.tau),
    )


class Odometry:
    """The pose of the base. It is zero at the first positions of the wheels."""

    def __init__(self, separation_m: float) -> None:
        self._separation_m = separation_m
        self._wheels_m: tuple[float, float] | None = None
        self.pose = START

    def take(self, left_m: float, right_m: float) -> Pose:
        """Process new positions of the wheels, and return the pose of the base."""
        if self._wheels_m is not None:
            before_left, before_right = self._wheels_m
            self.pose = moved(self.pose, left_m - before_left, right_m - before_right, self._separation_m)
        self._wheels_m = left_m, right_m
        return self.pose
