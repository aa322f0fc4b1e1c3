"""Waves for the built-in policies. They begin at the robot's position, and the robot's axes can follow them. Pure.

A wave begins slowly at the observed position of the axis, and has its full amplitude after ``EASE_S``. The
amplitude is at most the requested one, and small enough for speed and range of the axis. Near an end of the range,
the center of the wave is moved inwards.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import Axis, AxisMode

EASE_S = 1.0
OF_SPEED = 0.4
"""Share of an axis's top speed that a wave uses. A gate needs the rest for jitter of the period."""
OF_TRAVEL = 0.25
"""Share of an axis's range that a wave's amplitude uses at most."""
STEEPEST = 1.5
"""Top speed of ``eased``, as a multiple of its mean speed."""


class Swing(msgspec.Struct, frozen=True):
    """The wave of one axis, with the positions and the amplitude in the axis's unit."""

    start: float
    center: float
    amplitude: float
    hz: float

    def target(self, t_s: float, wave: float, ease_s: float = EASE_S) -> float:
        """Return the target of the axis.

        Args:
            t_s: Time since the wave began, in seconds.
            wave: Value of the wave, -1 to 1.
            ease_s: Time until the wave has its full amplitude, in seconds.
        """
        return self.start + eased(t_s / ease_s) * (self.center + self.amplitude * wave - self.start)


def eased(share: float) -> float:
    """Return a smooth step: 0 for a share below 0, 1 for a share above 1, and a smooth transition between them."""
    share = min(1.0, max(0.0, share))
    return share * share * (3 - 2 * share)


def fit(
    axis: Axis, position: float, amplitude: float, hz: float, is_requested: bool, ease_s: float = EASE_S
) -> Swing:
    """Return a wave that this axis can follow from its observed position.

    Args:
        axis: Range and speed of the axis.
        position: The observed position of the axis.
        amplitude: Requested amplitude, in the axis's unit.
        hz: Frequency of the wave.
        is_requested: True if the user gave this amplitude. It is then not reduced, and the robot may refuse the
            targets.
        ease_s: Time until the wave has its full amplitude, in seconds.
    """
    low, high = axis.low, axis.high
    start = axis.rest if axis.mode is AxisMode.VELOCITY else position
    if not is_requested:
        steepest = math.tau * hz + 2 * STEEPEST / ease_s
        amplitude = min(amplitude, OF_TRAVEL * (high - low), OF_SPEED * axis.speed / steepest)
    center = min(max(start, low + amplitude), high - amplitude) if high - low >= 2 * amplitude else start
    return Swing(start, center, amplitude, hz)


def swings(
    table: Sequence[Axis], positions: Mapping[str, float], amplitude: float, hz: Sequence[float], is_requested: bool
) -> dict[str, Swing]:
    """Return a wave for each axis of ``table`` (the robot's axes), by the axis's name.

    An axis that is commanded by position gets no wave if its position was not read.
    """
    waves: dict[str, Swing] = {}
    for axis, frequency in zip(table, hz, strict=True):
        position = positions.get(axis.key, math.nan)
        if math.isfinite(position) or axis.mode is AxisMode.VELOCITY:
            waves[axis.key] = fit(axis, position, amplitude, frequency, is_requested)
    return waves
