"""Compute joint speeds from targets. Pure.

The base accepts only speeds. A simple formula would reach a target in one control period: speed = (target -
position) / period. With this formula in every period the arm oscillates. The arm follows a speed with a delay, so
the next position is measured before the last speed has taken effect.

A ``Course`` avoids this. It plans a straight path from one target to the next within one period, and commands the
speed of this path. In each period it also corrects a quarter of the arm's distance from the path. It was tested in
simulations of arms with up to 10 ms of delay and 50 ms of lag, and it settled in all cases. The simple formula
settled only for an arm without delay and lag. The delay of a real arm is [assumed].
"""

from __future__ import annotations

from collections.abc import Sequence

CORRECTION = 0.25
"""Share of the arm's distance from the planned path that is corrected in one period."""

STANDING_RAD = 5e-4
"""A joint nearer to its target than this (0.03 degrees) counts as arrived [assumed], because measured
positions are noisy."""

Row = Sequence[float]


def position_now(position: Row, velocity: Row, age_s: float) -> tuple[float, ...]:
    """Estimate the present joint positions (rad) from a measurement that is ``age_s`` seconds old."""
    return tuple(rad + rad_s * age_s for rad, rad_s in zip(position, velocity, strict=True))


def needed(target: Row, position: Row, period_s: float) -> tuple[float, ...]:
    """Return the joint speeds (rad/s) that move the arm from ``position`` to ``target`` in one period."""
    return tuple((goal - rad) / period_s for goal, rad in zip(target, position, strict=True))


class Course:
    """A straight path from ``start`` to ``goal`` (rad) that takes one control period.

    All times are in seconds, and must be from the same clock.
    """

    def __init__(self, start: Row, goal: Row, begun_s: float, period_s: float) -> None:
        self.goal = tuple(goal)
        self._start = start
        self._begun_s = begun_s
        self._period_s = period_s

    def position_at(self, now_s: float) -> tuple[float, ...]:
        """Return the planned position of each joint at this time, in rad."""
        share = min(1.0, (now_s - self._begun_s) / self._period_s)
        return tuple(a + (b - a) * share for a, b in zip(self._start, self.goal, strict=True))

    def speeds(self, now_s: float, position: Row, fastest: float) -> tuple[float, ...]:
        """Return the joint speeds to send now (rad/s), for an arm at ``position``. ``fastest`` limits each
        speed."""
        ahead = now_s - self._begun_s < self._period_s
        rows = zip(self._start, self.goal, self.position_at(now_s), position, strict=True)
        speeds = []
        for start, goal, planned, rad in rows:
            lead = goal - start if ahead else 0.0
            near = not lead and abs(goal - rad) < STANDING_RAD
            speed = 0.0 if near else (lead + CORRECTION * (planned - rad)) / self._period_s
            speeds.append(max(-fastest, min(fastest, speed)))
        return tuple(speeds)
