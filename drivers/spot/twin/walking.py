"""How the simulated Spot walks: limits of its speed, and trajectories to a place. Pure: no clock.

A speed past a limit has no error status in the API. The robot walks as fast as it can (its top speed is 1.6 m/s,
docs/concepts/about_spot.md), and not faster than ``MobilityParams.vel_limit``.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from .geometry import turned, wrapped
from .paths import Path

Twist = tuple[float, float, float]
Place = tuple[float, float, float]
"""x, y in metres and yaw in radians, in the frame of odometry."""
REST: Twist = (0.0, 0.0, 0.0)

DEFAULT_SPEED: Twist = (1.0, 0.5, 1.0)
"""Speed of a trajectory whose command has no limit: m/s and rad/s [assumed]."""
NEAR = 0.1
"""Distance from the goal below which the robot reports that it is stopping, m and rad [assumed]."""
_ARRIVED = 0.005
_BRAKING = 0.5
"""Part of the robot's acceleration with which a trajectory brakes."""


class SpeedLimits:
    """The highest and the lowest speed of each axis."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        self.high: Twist = (float(table["vx_m_s"]), float(table["vy_m_s"]), float(table["wz_rad_s"]))
        self.low: Twist = (-self.high[0], -self.high[1], -self.high[2])

    def narrow(self, low: Sequence[float] | None, high: Sequence[float] | None) -> None:
        """Apply the limits of a command. None is no limit."""
        if high is not None:
            self.high = _three(min(own, given) for own, given in zip(self.high, high, strict=True))
        if low is not None:
            self.low = _three(max(own, given) for own, given in zip(self.low, low, strict=True))

    def limit(self, twist: Sequence[float]) -> Twist:
        return _three(
            max(low, min(high, value)) for low, high, value in zip(self.low, self.high, twist, strict=True)
        )


class Trajectory:
    """A walk to a place, or along several places.

    Args:
        path: The places, in the frame of odometry.
        limits: The limits of the speed.
        acceleration: The robot's acceleration, m/s^2 and rad/s^2.
    """

    def __init__(self, path: Path, limits: SpeedLimits, acceleration: float) -> None:
        self._path = path
        self._limits = limits
        self._braking = acceleration * _BRAKING
        self.is_near = False
        self.has_arrived = False
        self.is_over = False
        """True once the robot no longer follows this trajectory."""

    def twist(self, time_s: float, place: Place) -> Twist:
        """Return the speed, in the robot's own frame, that leads to the goal of this time."""
        x, y, yaw = self._path.values_at(time_s)
        ahead, aside = turned(-place[2], x - place[0], y - place[1])
        turn = wrapped(yaw - place[2])
        far, angle = math.hypot(ahead, aside), abs(turn)
        ended = self._path.has_ended(time_s)
        self.is_near = ended and far < NEAR and angle < NEAR
        self.has_arrived = ended and far < _ARRIVED and angle < _ARRIVED
        if self.has_arrived:
            return REST
        speed = math.sqrt(2 * self._braking * far)
        scale = speed / far if far > _ARRIVED / 2 else 0.0
        spin = math.copysign(math.sqrt(2 * self._braking * angle), turn) if angle > _ARRIVED / 2 else 0.0
        return self._limits.limit((ahead * scale, aside * scale, spin))


def _three(values: Any) -> Twist:
    x, y, z = values
    return x, y, z
