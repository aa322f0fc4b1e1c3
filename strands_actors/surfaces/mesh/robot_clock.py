"""A robot's clock, as read from another host: a measured offset between bounds, and times that are
never later than meant. Pure: no clock, no I/O."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection
from typing import NamedTuple

from strands_actors.kernel.clock import NS

GOOD_NS = round(25.0 * NS)
"""A reading is used for so long; the robot forgets who made it after 30 s."""
DRIFT = 2e-4
"""Of two quartzes against each other, at worst [assumed: 100 ppm each]."""
_KEPT = 16


class Bounds(NamedTuple):
    """The robot's clock is ahead of ours by something between the two."""

    lowest_ns: int
    highest_ns: int


class _Reading(NamedTuple):
    bounds: Bounds
    at_ns: int


class RobotClock:
    """Read it often: of several readings the tightest counts. Those that a newer one excludes are
    dropped: one of the two computers slept meanwhile, and its clock stood still."""

    def __init__(self) -> None:
        self._readings: deque[_Reading] = deque(maxlen=_KEPT)

    def read(self, robot_ns: int, asked_ns: int, answered_ns: int) -> None:
        """It said ``robot_ns`` at some time between ``asked_ns`` and ``answered_ns`` of ours."""
        self._readings.append(_Reading(Bounds(robot_ns - answered_ns, robot_ns - asked_ns), answered_ns))
        while (both := _bounds(self._readings, answered_ns)).lowest_ns > both.highest_ns:
            self._readings.popleft()  # one alone contradicts nothing

    def forget(self) -> None:
        """It is another robot's now, or the robot was started anew."""
        self._readings.clear()

    def bounds(self, now_ns: int) -> Bounds | None:
        """None: it is not known."""
        good = [reading for reading in self._readings if now_ns - reading.at_ns < GOOD_NS]
        if not good:
            return None
        return _bounds(good, now_ns)

    def deadline(self, at_ns: int, now_ns: int) -> int | None:
        """Return a time of ours as one of the robot's, never later than meant."""
        bounds = self.bounds(now_ns)
        return None if bounds is None else at_ns + bounds.lowest_ns


def _bounds(readings: Collection[_Reading], now_ns: int) -> Bounds:
    """Return what all of these allow; the lowest is above the highest when they exclude each
    other."""
    drifts = [round(DRIFT * max(0, now_ns - reading.at_ns)) for reading in readings]
    return Bounds(
        max(reading.bounds.lowest_ns - drift for reading, drift in zip(readings, drifts, strict=True)),
        min(reading.bounds.highest_ns + drift for reading, drift in zip(readings, drifts, strict=True)),
    )
