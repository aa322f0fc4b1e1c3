"""Simulate force mode: the tool gives way along some axes of a frame, until it presses with a given wrench.

Nothing touches the tool of the simulated arm, so the wrench is never reached. Along a compliant axis the tool moves
in the direction of the force. Along the other axes it is held.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import msgspec

from .pose import Frame

UNTURNED = 2
"""Type of force mode in which the frame stays as the program gives it. It is the only type that is simulated."""

M_S_PER_N = 0.01
"""Speed of a tool that nothing touches, for each newton of force, without damping [assumed]. In rad/s for each
newton metre it is the same number. The speed is never above the limit of the axis."""

SCRIPT_DAMPING, SCRIPT_GAIN = 0.025, 0.5
"""Values that ur-rtde's control script sets at its start."""
MOST_DAMPING, MOST_GAIN = 1.0, 2.0


class ForceMode(msgspec.Struct, frozen=True):
    """One call of ``force_mode``: the frame, 1 for each compliant axis, the wrench (N, Nm), and the limits of the
    compliant axes (m/s, rad/s)."""

    frame: Frame
    compliant: Sequence[int]
    wrench: Sequence[float]
    limits: Sequence[float]

    def velocity(self, damping: float, gain: float) -> tuple[float, ...]:
        """Return the velocity of the tool along and about the axes of the base, in m/s and rad/s.

        Args:
            damping: From ``force_mode_set_damping``: 0 to 1. At 1 the tool moves least.
            gain: From ``force_mode_set_gain_scaling``: 0 to 2.
        """
        share = gain * M_S_PER_N * (MOST_DAMPING - damping)
        rates = [
            math.copysign(min(abs(force) * share, abs(limit)), force) if compliant else 0.0
            for compliant, force, limit in zip(self.compliant, self.wrench, self.limits, strict=True)
        ]
        x, y, z, rx, ry, rz = rates
        return (*self.frame.turned((x, y, z)), *self.frame.turned((rx, ry, rz)))
