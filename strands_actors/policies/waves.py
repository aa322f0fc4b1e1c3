"""What the built-in policies have in common: waves that begin where the robot is, and that its axes
can follow. Pure.

A wave is eased in: at first the axis is where it was seen, and after ``EASE_S`` it is on the wave.
Its amplitude is no larger than asked for, and small enough for the axis's own speed and range. Where
an end of the range is near, the wave swings beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.contract.axis import Axis, AxisMode

EASE_S = 1.0
OF_SPEED = 0.4
"""Share of an axis's top speed that a wave uses: a gate must have room for a period that jitters."""
OF_TRAVEL = 0.25
"""Share of an axis's range that a wave's amplitude uses at most."""
STEEPEST = 1.5
"""Top speed of ``eased``, as a multiple of its mean speed."""


class Swing(msgspec.Struct, frozen=True):
    """The wave of one axis."""

    start: float
    center: float
    amplitude: float
    hz: float

    def at(self, t_s: float, wave: float, ease_s: float = EASE_S) -> float:
        """Return where the axis is to be. ``wave``: -1 to 1."""
        return self.start + eased(t_s / ease_s) * (self.center + self.amplitude * wave - self.start)


def eased(share: float) -> float:
    """Return 0 before 0, 1 after 1, and a smooth way between them."""
    share = min(1.0, max(0.0, share))
    return share * share * (3 - 2 * share)


def fit(axis: Axis, seen: float, amplitude: float, hz: float, is_asked: bool, ease_s: float = EASE_S) -> Swing:
    """Return a wave that this axis can follow from where it was seen.

    Args:
        axis: Its range, and how fast it changes.
        seen: Where it was seen.
        amplitude: In the axis's unit.
        hz: Frequency of the wave.
        is_asked: Whether somebody asked for this amplitude. It is then kept, and the gate may refuse it.
        ease_s: How long the wave is eased in.
    """
    low, high = axis.low, axis.high
    start = axis.rest if axis.mode is AxisMode.VELOCITY else seen
    if not is_asked:
        steepest = math.tau * hz + 2 * STEEPEST / ease_s
        amplitude = min(amplitude, OF_TRAVEL * (high - low), OF_SPEED * axis.speed / steepest)
    center = min(max(start, low + amplitude), high - amplitude) if high - low >= 2 * amplitude else start
    return Swing(start, center, amplitude, hz)


def swings(
    table: Sequence[Axis], seen: Mapping[str, float], amplitude: float, hz: Sequence[float], is_asked: bool
) -> dict[str, Swing]:
    """Return a wave for each axis of ``table`` that is known, by its key."""
    found: dict[str, Swing] = {}
    for axis, one in zip(table, hz, strict=True):
        here = seen.get(axis.key, math.nan)
        if math.isfinite(here) or axis.mode is AxisMode.VELOCITY:
            found[axis.key] = fit(axis, here, amplitude, one, is_asked)
    return found
