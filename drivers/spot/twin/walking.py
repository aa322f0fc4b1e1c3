"""How the simulated Spot walks: limits of its speed, and trajectories to a place. Pure: no clock.

A speed past a limit has no error status in the API. The robot walks as fast as it can (its top speed is 1.6 m/s,
docs/concepts/about_spot.md), and not faster than ``MobilityParams.vel_limit``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from .geometry import turned, wrapped
from .paths import Path, held

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
        self.waits = False
        """True while there is nothing to do for it."""

    def twist(self, time_s: float, place: Place) -> Twist:
        """Return the speed, in the robot's own frame, that leads to the goal of this time."""
        goal, ended = self._path.values_at(time_s), self._path.has_ended(time_s)
        far, angle = way_to(goal, place)
        self.is_near = ended and far < NEAR and angle < NEAR
        self.has_arrived = ended and far < _ARRIVED and angle < _ARRIVED
        return REST if self.has_arrived else self._towards(goal, place)

    def _towards(self, goal: Sequence[float], place: Place) -> Twist:
        ahead, aside = turned(-place[2], goal[0] - place[0], goal[1] - place[1])
        turn = wrapped(goal[2] - place[2])
        far, angle = math.hypot(ahead, aside), abs(turn)
        speed = math.sqrt(2 * self._braking * far)
        scale = speed / far if far > _ARRIVED / 2 else 0.0
        spin = math.copysign(math.sqrt(2 * self._braking * angle), turn) if angle > _ARRIVED / 2 else 0.0
        return self._limits.limit((ahead * scale, aside * scale, spin))


class ArmFollow(Trajectory):
    """A walk that keeps the body behind the goal of the hand (``FollowArmCommand``).

    Args:
        hand: Returns the place of the hand's goal on the floor; None if it has no goal that stays in the world.
        offset: The place of the hand in front of the body, metres.
        limits: The limits of the speed.
        acceleration: The robot's acceleration, m/s^2 and rad/s^2.
    """

    def __init__(
        self,
        hand: Callable[[], tuple[float, float] | None],
        offset: tuple[float, float],
        limits: SpeedLimits,
        acceleration: float,
    ) -> None:
        super().__init__(held(REST), limits, acceleration)
        self._hand = hand
        self._offset = offset

    def twist(self, time_s: float, place: Place) -> Twist:
        hand = self._hand()
        if hand is None:
            return self._rest()
        ahead, aside = turned(place[2], *self._offset)
        goal = hand[0] - ahead, hand[1] - aside, place[2]
        if way_to(goal, place)[0] < _ARRIVED:
            return self._rest()
        self.waits = False
        return self._towards(goal, place)

    def _rest(self) -> Twist:
        self.waits = True
        return REST


def way_to(goal: Sequence[float], place: Place) -> tuple[float, float]:
    """Return how far a place is away: metres and radians."""
    return math.dist(goal[:2], place[:2]), abs(wrapped(goal[2] - place[2]))


def _three(values: Any) -> Twist:
    x, y, z = values
    return x, y, z
