"""Simulate the motion of the rover: a base in the plane that follows its last command."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Commander

_STEP_S = 0.01
_LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""


_FULL_RPM = 100.0
"""Speed of the wheels at full speed [assumed]."""


class Rover:
    """The simulated rover. After ``watchdog_s`` seconds without a command it gets a zero command, as from the
    vendor's SDK process. ``watchdog_s`` 0 switches this off."""

    def __init__(self, table: Mapping[str, Any], watchdog_s: float, now_s: Callable[[], float]) -> None:
        self._full = float(table["full_m_s"]), float(table["full_rad_s"])
        self._ramp_s = float(table["ramp_s"])
        self._report_s = float(table["report_s"])
        self._watchdog_s = watchdog_s
        self._now_s = now_s
        self._simulated_s = now_s()
        self.time_s = 0.0
        self.reset()

    def reset(self) -> None:
        """Put the rover where it began, at rest."""
        self.commander = Commander.NONE
        self.commanded = (0.0, 0.0)  # commanded speeds, as fractions of full speed
        self.lamp = 0.0
        self.runs = (0.0, 0.0)  # present speeds, as fractions of full speed
        self.x_m = self.y_m = self.heading_rad = 0.0
        self.stuck = False
        self._commanded_s = self._now_s()
        self._report()

    def tell(self, linear: float, angular: float, lamp: float, commander: Commander) -> None:
        """Set a new command. ``commander`` is its sender: a client of the wire protocol, or the simulation."""
        self.pass_time()
        self.commanded, self.lamp = (linear, angular), lamp
        self._commanded_s = self._now_s()
        self.commander = commander

    def pass_time(self) -> None:
        """Simulate the time that has passed since the last call."""
        now_s = self._now_s()
        passed_s, self._simulated_s = now_s - self._simulated_s, now_s
        overdue = self._watchdog_s and now_s - self._commanded_s > self._watchdog_s
        if overdue and self.commander is Commander.WIRE:
            self.commanded, self.commander = (0.0, 0.0), Commander.NONE
        self.run(min(passed_s, _LONGEST_S))

    def run(self, seconds: float) -> None:
        """Simulate this number of seconds."""
        while seconds > 0:
            step_s = min(seconds, _STEP_S)
            seconds -= step_s
            self._step(step_s)

    def _step(self, step_s: float) -> None:
        self.time_s += step_s
        most = step_s / self._ramp_s
        # A rover that is commanded to run faster than it can runs at its full speed [assumed].
        goals = (0.0, 0.0) if self.stuck else tuple(max(-1.0, min(1.0, share)) for share in self.commanded)
        self.runs = (_towards(self.runs[0], goals[0], most), _towards(self.runs[1], goals[1], most))
        linear_m_s, angular_rad_s = (run * full for run, full in zip(self.runs, self._full, strict=True))
        self.heading_rad += angular_rad_s * step_s
        self.x_m += linear_m_s * math.cos(self.heading_rad) * step_s
        self.y_m += linear_m_s * math.sin(self.heading_rad) * step_s
        if self.time_s - self.reported_s >= self._report_s:
            self._report()

    def _report(self) -> None:
        """Store the present speeds and heading of the simulated rover. ``GET /data`` reports these values until
        the next call."""
        self.reported_s = self.time_s
        linear, angular = self.runs
        # Only the forward speed is reported, so a rover that turns on the spot reports 0.
        self.reported_speed = abs(linear)
        left_rpm, right_rpm = (_FULL_RPM * (linear + side * angular) for side in (-1, 1))
        self.reported_rpms = (left_rpm, right_rpm, left_rpm, right_rpm)
        self.reported_heading_deg = math.degrees(-self.heading_rad) % 360.0


def _towards(now: float, goal: float, most: float) -> float:
    return now + max(-most, min(most, goal - now))
