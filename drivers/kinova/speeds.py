"""Compute joint speeds from targets. Pure.

The base takes speeds only. The plain formula reaches a target in one control period: speed = (target -
position) / period. If it is sent anew in every cycle, the arm oscillates: it follows a speed late, so
the distance is measured before the last speed has taken effect.

A ``Course`` therefore leads from one target to the next in one period. It corrects the arm's lag behind
the course at a quarter of that rate. In a simulation of arms that follow a speed with up to 10 ms of
delay and 50 ms of lag, the course settled on all of them. The plain formula settled on the ideal arm
only. The delay of a real arm is [assumed].
"""

from __future__ import annotations

from collections.abc import Sequence

CORRECTION = 0.25
"""Share of the lag that is corrected in one period."""

STANDING_RAD = 5e-4
"""A joint nearer to its target than this (0.03 degrees) counts as arrived [assumed], because measured
positions are noisy."""

Row = Sequence[float]


def position_now(position: Row, velocity: Row, age_s: float) -> tuple[float, ...]:
    """Return the present joint positions, from a measurement of ``age_s`` ago."""
    return tuple(rad + rad_s * age_s for rad, rad_s in zip(position, velocity, strict=True))


def needed(target: Row, position: Row, period_s: float) -> tuple[float, ...]:
    """Return the speeds that reach ``target`` in one period."""
    return tuple((goal - rad) / period_s for goal, rad in zip(target, position, strict=True))


class Course:
    """A path from the planned position to a target within one period. Times are in seconds, of any clock."""

    def __init__(self, start: Row, goal: Row, begun_s: float, period_s: float) -> None:
        self.goal = tuple(goal)
        self._start = start
        self._begun_s = begun_s
        self._period_s = period_s

    def at(self, now_s: float) -> tuple[float, ...]:
        """Return the planned position."""
        share = min(1.0, (now_s - self._begun_s) / self._period_s)
        return tuple(a + (b - a) * share for a, b in zip(self._start, self.goal, strict=True))

    def speeds(self, now_s: float, position: Row, fastest: float) -> tuple[float, ...]:
        """Return the speeds to send now, each at most ``fastest``, for an arm at ``position``."""
        ahead = now_s - self._begun_s < self._period_s
        rows = zip(self._start, self.goal, self.at(now_s), position, strict=True)
        speeds = []
        for start, goal, planned, rad in rows:
            lead = goal - start if ahead else 0.0
            near = not lead and abs(goal - rad) < STANDING_RAD
            speed = 0.0 if near else (lead + CORRECTION * (planned - rad)) / self._period_s
            speeds.append(max(-fastest, min(fastest, speed)))
        return tuple(speeds)
