"""Simulate the trajectories of a stepper board: a sequence of polynomials of the fifth degree.

A segment has a duration, six coefficients and a number. The first segment has the number 2. While a segment runs,
the board takes the one with the next number. Without one the trajectory ends with the segment.
"""

from __future__ import annotations

import struct
from typing import NamedTuple

FIRST, WAITING = 2, 1
"""Number of the first segment, and the number that the board reports until it begins."""
_SEGMENT = struct.Struct("<7fB")


class Segment(NamedTuple):
    duration_s: float
    coefficients: tuple[float, ...]
    number: int

    def position_after(self, time_s: float) -> float:
        """Return the position at a time of the segment, in motor radians."""
        return sum(factor * time_s**power for power, factor in enumerate(self.coefficients))


def segment_of(data: bytes) -> Segment | None:
    """Decode a segment; None for data of another length."""
    if len(data) != _SEGMENT.size:
        return None
    duration_s, *coefficients, number = _SEGMENT.unpack(data)
    return Segment(duration_s, tuple(coefficients), number)


class Trajectory:
    """The trajectory of one board. ``goal`` is its present position in motor radians."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """End the trajectory where it is."""
        self._segment: Segment | None = None
        self._next: Segment | None = None
        self._time_s = 0.0
        self.waits = False
        self.goal = 0.0

    @property
    def is_active(self) -> bool:
        return self._segment is not None and not self.waits

    @property
    def number(self) -> int:
        """Return the number of the segment that the board reports."""
        if self._segment is None:
            return 0
        return WAITING if self.waits else self._segment.number

    def start(self, segment: Segment | None, waits: bool) -> bool:
        """Begin a trajectory, at the next sync pulse if it ``waits``. Return False if the board refuses it."""
        if segment is None or segment.number != FIRST or self._segment is not None:
            return False
        self._segment, self._next, self._time_s, self.waits = segment, None, 0.0, waits
        self.goal = segment.position_after(0.0)
        return True

    def append(self, segment: Segment | None) -> None:
        """Take the next segment. The board ignores one with another number. The duration 0 means that none
        follows."""
        if segment is not None and self.is_active and segment.number == self.number + 1:
            self._next = segment if segment.duration_s > 0 else None

    def step(self, step_s: float) -> None:
        if self._segment is None or self.waits:
            return
        self._time_s += step_s
        while self._segment is not None and self._time_s >= self._segment.duration_s:
            self.goal = self._segment.position_after(self._segment.duration_s)
            self._time_s -= self._segment.duration_s
            self._segment, self._next = self._next, None
        if self._segment is not None:
            self.goal = self._segment.position_after(self._time_s)
