"""From targets to joint speeds. Pure.

The base takes speeds only. A target is reached in one control period: speed = (target - position) /
period. Sent anew in every cycle that would ring: the arm follows a speed late, and what it still
has to go is measured before it got there. So a ``Course`` leads from one target to the next in one
period, and what the arm lags behind it is corrected at a quarter of that rate. In a simulation of
arms that follow a speed with up to 10 ms of delay and 50 ms of lag this settled on all of them, and
the formula alone on the ideal one only. How late a real arm is: [assumed].
"""

from __future__ import annotations

from collections.abc import Sequence

CORRECTION = 0.25
"""Share of a lag that is made up for in one period."""

STANDING_RAD = 5e-4
"""Nearer to its target than this (0.03 degrees) a joint stands [assumed]: measured positions are
not still."""

Row = Sequence[float]


def position_now(position: Row, velocity: Row, age_s: float) -> tuple[float, ...]:
    """Return where the joints are by now, measured ``age_s`` ago."""
    return tuple(rad + rad_s * age_s for rad, rad_s in zip(position, velocity, strict=True))


def needed(target: Row, position: Row, period_s: float) -> tuple[float, ...]:
    """Return the speeds that reach ``target`` in one period."""
    return tuple((goal - rad) / period_s for goal, rad in zip(target, position, strict=True))


class Course:
    """From where the arm was to be, to a target, within one period. Times in seconds, of any
    clock."""

    def __init__(self, start: Row, goal: Row, begun_s: float, period_s: float) -> None:
        self.goal = tuple(goal)
        self._start = start
        self._begun_s = begun_s
        self._period_s = period_s

    def at(self, now_s: float) -> tuple[float, ...]:
        """Return where the arm is to be."""
        share = min(1.0, (now_s - self._begun_s) / self._period_s)
        return tuple(a + (b - a) * share for a, b in zip(self._start, self.goal, strict=True))

    def speeds(self, now_s: float, position: Row, fastest: float) -> tuple[float, ...]:
        """Return what to send now, for an arm that is at ``position``; never faster than
        ``fastest``."""
        ahead = now_s - self._begun_s < self._period_s
        rows = zip(self._start, self.goal, self.at(now_s), position, strict=True)
        speeds = []
        for start, goal, wanted, rad in rows:
            lead = goal - start if ahead else 0.0
            near = not lead and abs(goal - rad) < STANDING_RAD
            speed = 0.0 if near else (lead + CORRECTION * (wanted - rad)) / self._period_s
            speeds.append(max(-fastest, min(fastest, speed)))
        return tuple(speeds)
