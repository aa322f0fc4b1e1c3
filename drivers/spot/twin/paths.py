"""Paths in time: what a trajectory of the API asks of the simulated Spot. Pure: no clock.

The same rule holds for the place of the robot, the pose of its body, the joints of its arm and its claw. A point
with a time is reached by a straight line that ends at this time. A point without a time is the goal at once. The
limits of speed are those of the part that follows the path.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

Values = tuple[float, ...]


class Path:
    """A path through points.

    Args:
        begins_s: The time of the command.
        start: The values at that time.
        points: The times and the values of the points, in the order of time. At least one.
    """

    def __init__(self, begins_s: float, start: Values, points: Sequence[tuple[float, Values]]) -> None:
        self._points = [(begins_s, start), *points]
        self.last = points[-1][1]
        self.ends_s = points[-1][0]

    def values_at(self, time_s: float) -> Values:
        """Return the values that the path asks for at a time."""
        if time_s >= self.ends_s:
            return self.last
        for (before_s, before), (after_s, after) in pairwise(self._points):
            if before_s <= time_s < after_s:
                share = (time_s - before_s) / (after_s - before_s)
                return tuple(a + (b - a) * share for a, b in zip(before, after, strict=True))
        return self._points[0][1]

    def has_ended(self, time_s: float) -> bool:
        return time_s >= self.ends_s


def held(values: Sequence[float]) -> Path:
    """Return the path that stays at these values."""
    return Path(0.0, tuple(values), [(0.0, tuple(values))])
