"""Estimate a robot's clock from another host.

Each reading bounds the offset between the two clocks. Deadlines use the lower bound, so they are never
later on the robot than intended. Pure: no clock, no I/O.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from strands_actors.kernel.clock import NS

GOOD_NS = round(25.0 * NS)
"""How long a reading is used. The robot drops the session of a reading after 30 s."""
DRIFT = 2e-4
"""Largest drift between two quartzes [assumed: 100 ppm each]."""
_KEPT = 16


class Bounds(NamedTuple):
    """Bounds of the offset: the robot's clock minus this host's clock."""

    lowest_ns: int
    highest_ns: int


class _Reading(NamedTuple):
    bounds: Bounds
    at_ns: int


class RobotClock:
    """The clock of one robot. Of several readings the tightest bounds count, so read it often.

    An older reading that contradicts a newer one is dropped: one of the two computers was suspended in
    between, and its clock stood still.
    """

    def __init__(self) -> None:
        self._readings: deque[_Reading] = deque(maxlen=_KEPT)

    def read(self, robot_ns: int, asked_ns: int, answered_ns: int) -> None:
        """Add a reading: the robot's clock was ``robot_ns`` at some time between ``asked_ns`` and
        ``answered_ns`` of this host's clock."""
        self._readings.append(_Reading(Bounds(robot_ns - answered_ns, robot_ns - asked_ns), answered_ns))
        while (both := _bounds(self._readings, answered_ns)).lowest_ns > both.highest_ns:
            self._readings.popleft()  # The loop ends: a single reading has no contradiction.

    def forget(self) -> None:
        """Drop all readings, because the robot has restarted or is another one."""
        self._readings.clear()

    def bounds(self, now_ns: int) -> Bounds | None:
        """Return the present bounds; None without a recent reading."""
        good = [reading for reading in self._readings if now_ns - reading.at_ns < GOOD_NS]
        if not good:
            return None
        return _bounds(good, now_ns)

    def deadline(self, at_ns: int, now_ns: int) -> int | None:
        """Convert a time of this host's clock to the robot's clock. The result is never too late. None
        without a recent reading."""
        bounds = self.bounds(now_ns)
        return None if bounds is None else at_ns + bounds.lowest_ns


def _bounds(readings: Collection[_Reading], now_ns: int) -> Bounds:
    """Return the intersection of all readings. The lowest is above the highest if they contradict each
    other."""
    drifts = [round(DRIFT * max(0, now_ns - reading.at_ns)) for reading in readings]
    return Bounds(
        max(reading.bounds.lowest_ns - drift for reading, drift in zip(readings, drifts, strict=True)),
        min(reading.bounds.highest_ns + drift for reading, drift in zip(readings, drifts, strict=True)),
    )
