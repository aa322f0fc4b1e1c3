"""Simulate the rover behind its twin's service: a base in the plane that follows its last command."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Hand

_STEP_S = 0.01
_LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""


_FULL_RPM = 100.0
"""Speed of the wheels at full speed [assumed]."""


class Rover:
    """The rover. The SDK process sends zero after ``watchdog_s`` without a command; 0 for never."""

    def __init__(self, table: Mapping[str, Any], watchdog_s: float, now_s: Callable[[], float]) -> None:
        self._full = float(table["full_m_s"]), float(table["full_rad_s"])
        self._ramp_s = float(table["ramp_s"])
        self._report_s = float(table["report_s"])
        self._watchdog_s = watchdog_s
        self._now_s = now_s
        self._seen_s = now_s()
        self.time_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Put the rover where it began, at rest."""
        self.hand = Hand.NONE
        self.told = (0.0, 0.0)  # fractions of full speed
        self.lamp = 0.0
        self.runs = (0.0, 0.0)  # present speed, in the same unit
        self.x_m = self.y_m = self.heading_rad = 0.0
        self.stuck = False
        self._told_s = self._now_s()
        self._report()

    def tell(self, linear: float, angular: float, lamp: float, hand: Hand) -> None:
        """Take a command, from the wire or from the simulation."""
        self.pass_time()
        self.told, self.lamp = (linear, angular), lamp
        self._told_s = self._now_s()
        self.hand = hand

    def pass_time(self) -> None:
        """Advance to the present time."""
        now_s = self._now_s()
        passed_s, self._seen_s = now_s - self._seen_s, now_s
        overdue = self._watchdog_s and now_s - self._told_s > self._watchdog_s
        if overdue and self.hand is Hand.WIRE:
            self.told, self.hand = (0.0, 0.0), Hand.NONE
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        """Advance by so many seconds."""
        while seconds > 0:
            step_s = min(seconds, _STEP_S)
            seconds -= step_s
            self._step(step_s)

    def _step(self, step_s: float) -> None:
        self.time_s += step_s
        most = step_s / self._ramp_s
        goals = (0.0, 0.0) if self.stuck else self.told
        self.runs = (_towards(self.runs[0], goals[0], most), _towards(self.runs[1], goals[1], most))
        linear_m_s, angular_rad_s = (run * full for run, full in zip(self.runs, self._full, strict=True))
        self.heading_rad += angular_rad_s * step_s
        self.x_m += linear_m_s * math.cos(self.heading_rad) * step_s
        self.y_m += linear_m_s * math.sin(self.heading_rad) * step_s
        if self.time_s - self.reported_s >= self._report_s:
            self._report()

    def _report(self) -> None:
        """Make the report that the SDK process repeats until the next one."""
        self.reported_s = self.time_s
        linear, angular = self.runs
        self.reported_speed = abs(linear)  # 0 for a rover that turns on the spot
        left, right = (_FULL_RPM * (linear + side * angular) for side in (-1, 1))
        self.reported_rpms = (left, right, left, right)
        self.reported_heading_deg = math.degrees(-self.heading_rad) % 360.0


def _towards(now: float, goal: float, most: float) -> float:
    return now + max(-most, min(most, goal - now))
