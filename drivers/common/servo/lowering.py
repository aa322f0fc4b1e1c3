"""Bring a servo arm down under control, before its torque is switched off. Pure: no clock, no I/O.

A stopped arm has no torque, so a raised arm falls. It is lowered instead, if nothing is wrong. There are two ways:

* to a rest pose that the user gave or taught: the goals move there along a smooth path,
* without one: the torque limits fall until the arm gives way, and come down further as it sinks.

Both end with torque limits that have fallen to zero. The speed of the whole arm is watched on every way. Close to
the table it is at most ``SLOW_M_S``, and higher up it may be more (``allowed_m_s``). While some point of the arm is
faster, the torque limits rise again, in proportion. So the weight of the arm and of what it carries need not be
known.

The model of the arm (``kinematics.chain``) turns joint speeds into speeds of points. It need not be exact: an arm
that is not calibrated, or stands higher, is lowered more slowly or faster by the error, and the time for it is
limited.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.drivers.common.kinematics.chain import Chain, Vector

SLOW_M_S = 0.12
"""Highest speed of any point of the arm at the table."""
FASTER_PER_M = 1.0
"""How much faster a point may be for each metre of height, in m/s."""
FASTEST_M_S = 0.25
"""The usual limit for a robot beside a person."""

FALL_S = 1.0
"""Time in which the torque limits fall to zero, if the arm stays slow enough."""
RELEASE_S = 0.4
"""The same at a rest pose, where little is carried."""
LEAST_SHARE = 0.04
"""A servo that carries nothing starts at this share of its torque."""
START = 1.15
"""The limits start at this multiple of the torque that each servo needs to hold."""
STEADY_PACE = 0.7
"""At this share of the allowed speed the limits stay as they are. Below it they fall, above it they rise."""
RISE_PER_S = 8.0
"""How fast the limits change with the pace of the arm, per second, as a share of themselves."""

SAMPLES = 40
_STEP_S = 1e-3


class LoweringConfig(msgspec.Struct, frozen=True):
    """How an arm is lowered.

    Attributes:
        seconds: Longest time for it. The torque is switched off then, wherever the arm is.
        rest: The goal of each servo in the rest pose, in counts by id; None without a rest pose.
        model: The robot's table, with ``model_rows`` and ``base``.
    """

    seconds: float
    rest: Mapping[int, int] | None
    model: Mapping[str, object]


def allowed_m_s(height_m: float) -> float:
    """Return the highest speed of a point at this height above the plane on which the arm stands."""
    return min(FASTEST_M_S, SLOW_M_S + FASTER_PER_M * max(0.0, height_m))


def pace_of(before: Sequence[Vector], after: Sequence[Vector], seconds: float) -> float:
    """Return how fast the arm moves, as a share of the allowed speed. It is the share of the fastest point."""
    paces = []
    for (x, y, z), (to_x, to_y, to_z) in zip(before, after, strict=True):
        way_m = math.dist((x, y, z), (to_x, to_y, to_z))
        paces.append(way_m / seconds / allowed_m_s(min(z, to_z)))
    return max(paces)


def pace(chain: Chain, rad: Sequence[float], rad_s: Sequence[float]) -> float:
    """Return how fast the arm moves, as a share of the allowed speed.

    Args:
        chain: The model of the arm.
        rad: The angle of each joint.
        rad_s: The speed of each joint.
    """
    ahead = [angle + speed * _STEP_S for angle, speed in zip(rad, rad_s, strict=True)]
    return pace_of(chain.points(rad), chain.points(ahead), _STEP_S)


class FallingTorque:
    """The torque limits of the servos while they fall.

    They fall fast while the arm stands, the more slowly the faster it moves, and rise when it is close to the
    allowed speed.

    Args:
        efforts: The torque that each servo needs to hold, as a share (0 to 1) of its full torque, by id.
        seconds: Time in which the limits fall to zero, if the arm never moves.
    """

    def __init__(self, efforts: Mapping[int, float], seconds: float) -> None:
        self._highest = {motor: max(LEAST_SHARE, START * abs(effort)) for motor, effort in efforts.items()}
        self._seconds = seconds
        self.shares = {motor: min(1.0, share) for motor, share in self._highest.items()}
        """The present limits, as shares of the full torque, by id."""

    @property
    def done(self) -> bool:
        return not any(self.shares.values())

    def step(self, pace: float, seconds: float) -> Mapping[int, float]:
        """Return the limits after the next ``seconds``. ``pace`` is the speed as a share of the allowed one."""
        change = max(-1.0 / self._seconds, RISE_PER_S * (pace - STEADY_PACE))
        for motor, highest in self._highest.items():
            # A limit that has risen far falls as fast as it must to reach zero in the same time.
            share = self.shares[motor] = min(1.0, max(0.0, self.shares[motor] + highest * change * seconds))
            self._highest[motor] = max(highest, share)
        return self.shares


class RestPath:
    """A smooth path from a pose to the rest pose. It begins and ends at rest.

    The time for it is the shortest in which no point of the arm is faster than allowed.

    Args:
        chain: The model of the arm.
        start_rad: The present angle of each joint.
        rest_rad: The angle of each joint in the rest pose.
    """

    def __init__(self, chain: Chain, start_rad: Sequence[float], rest_rad: Sequence[float]) -> None:
        self._start = tuple(start_rad)
        self._way = tuple(last - first for first, last in zip(start_rad, rest_rad, strict=True))
        progress = [_smooth(number / SAMPLES) for number in range(SAMPLES + 1)]
        points = [chain.points(self._pose(part)) for part in progress]
        self.seconds = max(pace_of(*pair, 1.0 / SAMPLES) for pair in itertools.pairwise(points))
        """Duration of the whole path."""

    def pose_after(self, seconds: float) -> tuple[float, ...]:
        """Return the angle of each joint this long after the begin of the path."""
        return self._pose(_smooth(min(1.0, seconds / self.seconds)) if self.seconds else 1.0)

    def _pose(self, part: float) -> tuple[float, ...]:
        return tuple(first + way * part for first, way in zip(self._start, self._way, strict=True))


def _smooth(part: float) -> float:
    """Return the progress (0 to 1) of a motion with the least jerk, after this part of its time."""
    return part**3 * (10 - 15 * part + 6 * part**2)
