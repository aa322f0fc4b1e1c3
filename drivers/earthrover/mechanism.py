"""Simulate the motion of the rover: a base in the plane that follows its last command."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.common.physics.stepped import PlanarBase, towards

_FULL_RPM = 100.0
"""Speed of the wheels at full speed [assumed]."""


class Rover(PlanarBase):
    """The simulated rover. After ``watchdog_s`` seconds without a command it gets a zero command, as from the
    vendor's SDK process. ``watchdog_s`` 0 switches this off."""

    def __init__(self, table: Mapping[str, Any], watchdog_s: float, now_s: Callable[[], float]) -> None:
        self._full = float(table["full_m_s"]), float(table["full_rad_s"])
        self._ramp_s = float(table["ramp_s"])
        self._report_s = float(table["report_s"])
        super().__init__(watchdog_s, now_s)
        self.reset()

    def reset(self) -> None:
        """Put the rover where it began, at rest."""
        self.commander = Commander.NONE
        self.commanded = (0.0, 0.0)  # commanded speeds, as fractions of full speed
        self.lamp = 0.0
        self.runs = (0.0, 0.0)  # present speeds, as fractions of full speed
        self.x_m = self.y_m = self.yaw_rad = 0.0
        self.stuck = False
        self._commanded_s = self.now_s()
        self._report()

    def tell(self, linear: float, angular: float, lamp: float, commander: Commander) -> None:
        """Set a new command. ``commander`` is its sender: a client of the wire protocol, or the simulation."""
        self.pass_time()
        self.commanded, self.lamp = (linear, angular), lamp
        self._commanded_s = self.now_s()
        self.commander = commander

    def pass_time(self) -> None:
        if self.is_overdue:
            self.commanded, self.commander = (0.0, 0.0), Commander.NONE
        super().pass_time()

    def _step(self, step_s: float) -> None:
        most = step_s / self._ramp_s
        # A rover that is commanded to run faster than it can runs at its full speed [assumed].
        goals = (0.0, 0.0) if self.stuck else tuple(max(-1.0, min(1.0, share)) for share in self.commanded)
        self.runs = (towards(self.runs[0], goals[0], most), towards(self.runs[1], goals[1], most))
        linear_m_s, angular_rad_s = (run * full for run, full in zip(self.runs, self._full, strict=True))
        self._roll(linear_m_s, 0.0, angular_rad_s, step_s)
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
        self.reported_heading_deg = math.degrees(-self.yaw_rad) % 360.0
