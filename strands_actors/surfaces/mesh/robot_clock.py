"""Estimate a robot's clock from another host.

Each reading bounds the offset between the two clocks. Deadlines use the lower bound, so they are never
later on the robot than intended. The functions read no clock and do no I/O.
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
    """Lower and upper bound of the offset (the robot's clock minus this host's clock), in nanoseconds."""

    lowest_ns: int
    highest_ns: int


class _Reading(NamedTuple):
    bounds: Bounds
    at_ns: int


class RobotClock:
    """The clock of one robot, estimated from several readings.

    Each reading gives bounds of the offset, and the tightest bounds are used. So more readings make the
    estimate better. An older reading that contradicts a newer one is dropped, because one of the two
    computers was suspended in between, and its clock did not run.
    """

    def __init__(self) -> None:
        self._readings: deque[_Reading] = deque(maxlen=_KEPT)

    def read(self, robot_ns: int, requested_ns: int, answered_ns: int) -> None:
        """Add a reading. The robot's clock was ``robot_ns`` at some time between ``requested_ns`` and
        ``answered_ns`` on this host's clock."""
        self._readings.append(_Reading(Bounds(robot_ns - answered_ns, robot_ns - requested_ns), answered_ns))
        while (both := _bounds(self._readings, answered_ns)).lowest_ns > both.highest_ns:
            self._readings.popleft()  # The loop ends at the latest when one reading is left.

    def forget(self) -> None:
        """Drop all readings, because the robot has restarted or is another one."""
        self._readings.clear()

    def bounds(self, now_ns: int) -> Bounds | None:
        """Return the bounds of the offset now, or None if there is no recent reading."""
        good = [reading for reading in self._readings if now_ns - reading.at_ns < GOOD_NS]
        if not good:
            return None
        return _bounds(good, now_ns)

    def deadline(self, at_ns: int, now_ns: int) -> int | None:
        """Convert a deadline from this host's clock to the robot's clock. The result may be too early, never
        too late. Return None if there is no recent reading."""
        bounds = self.bounds(now_ns)
        return None if bounds is None else at_ns + bounds.lowest_ns


def _bounds(readings: Collection[_Reading], now_ns: int) -> Bounds:
    """Return the bounds on which all readings agree. If readings contradict each other, ``lowest_ns`` is above
    ``highest_ns``."""
    drifts = [round(DRIFT * max(0, now_ns - reading.at_ns)) for reading in readings]
    return Bounds(
        max(reading.bounds.lowest_ns - drift for reading, drift in zip(readings, drifts, strict=True)),
        min(reading.bounds.highest_ns + drift for reading, drift in zip(readings, drifts, strict=True)),
    )
