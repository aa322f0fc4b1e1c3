"""Simulate the current of one stepper motor: that of its load, and more while something blocks the joint."""

from __future__ import annotations

import math

from strands_actors.drivers.stretch import protocol as p

FRICTION_A = 0.3
"""Current that a moving joint needs beside its load [assumed]."""
MOVES_RAD_S = 0.05

TICKS_PER_A = 255 * 0.75 / 3.3
"""Unit of the reported effort: 255 ticks for 3.3 V, over 5 times a resistor of 0.15 ohm (the vendor's client)."""

_GAIN, _LOWEST, _HIGHEST, _FILTER = (
    p.GAINS_ORDER.index(name) for name in ("pKp_d", "iMax_neg", "iMax_pos", "effort_LPF")
)


class Effort:
    """The current of a motor in A. It is positive if it drives the joint in the positive direction.

    A blocked motor falls behind the profile of its motion, and the controller answers each degree with ``pKp_d``
    ticks of effort. The board reports and compares the filtered effort.

    Args:
        load_a: Current that carries the load of the joint. The lift's is its feed-forward current.
    """

    def __init__(self, load_a: float) -> None:
        self._load_a = load_a
        self._behind_rad = 0.0
        self.filtered_a = 0.0
        self.is_at_limit = False

    def step(self, step_s: float, gains: p.Gains, velocity: float, blocked: int, falls_behind: float) -> None:
        """Compute the current after a time step in which the motor was driven.

        Args:
            step_s: Duration of the step.
            gains: The gains of the board, which have the limits of the current and its filter.
            velocity: Velocity of the motor, rad/s.
            blocked: 1 or -1 if the motor pushes in this direction against an end of its travel or an obstacle;
                otherwise 0.
            falls_behind: Speed at which a blocked motor falls behind its profile, rad/s. Infinite without a
                profile.
        """
        if blocked:
            self._behind_rad += falls_behind * step_s
        else:
            self._behind_rad = 0.0
        moves = math.copysign(1.0, velocity) if abs(velocity) > MOVES_RAD_S else 0.0
        push_a = gains.values[_GAIN] * math.degrees(self._behind_rad) / TICKS_PER_A
        lowest, highest = gains.values[_LOWEST], gains.values[_HIGHEST]
        current_a = min(max(self._load_a + moves * FRICTION_A + blocked * push_a, lowest), highest)
        self.is_at_limit = current_a in (lowest, highest)
        self._filter(step_s, gains, current_a)

    def coast(self, step_s: float, gains: p.Gains) -> None:
        """Compute the current after a time step in which the motor had no torque."""
        self._behind_rad, self.is_at_limit = 0.0, False
        self._filter(step_s, gains, 0.0)

    def reset(self) -> None:
        self._behind_rad, self.filtered_a, self.is_at_limit = 0.0, 0.0, False

    def _filter(self, step_s: float, gains: p.Gains, current_a: float) -> None:
        share = 1.0 - math.exp(-math.tau * gains.values[_FILTER] * step_s)
        self.filtered_a += share * (current_a - self.filtered_a)
