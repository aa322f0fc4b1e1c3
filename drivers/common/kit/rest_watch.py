"""Decide by a robot's own reports whether it stands still. Pure: no clock, no I/O.

The answer to a stop order confirms nothing: a service may answer before the motors have received the order. Only
reports of the robot do. Three rules hold for every robot:

* The first report after the order is only the reference. It may have been made before the robot took the order.
* A later report counts only if its stamp is newer than all before. A controller that hangs, and a relay that
  repeats its last packet, send an old stamp again.
* An axis rests when every counted report of the last ``steady`` shows it at rest. An axis that changes direction
  shows speed zero for a moment, and an order on its way may still set it in motion.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable


class Rest(enum.Enum):
    """A conclusion from the reports. The value is the text for people."""

    NOTHING_SINCE = "it has reported nothing since"
    MOVES = "it moves"
    TOO_SHORT = "it has not stood still for long enough"
    RESTS = ""


class RestWatch:
    """Tells which axes of a robot stand still since a stop order.

    Args:
        axes: Number of axes.
        steady: How long an axis must be reported at rest, in the unit of the times that are given to ``report``.
            0 means that one counted report is enough.

    Attributes:
        repeats: The last report had an old stamp. A robot that reports seldom may be read in between.
    """

    def __init__(self, axes: int = 1, steady: float = 0.0) -> None:
        self._axes = range(axes)
        self._steady = steady
        self.restart()

    def restart(self) -> None:
        """Forget all reports, because an earlier command may still take effect. The next one is a reference."""
        self._newest: float | None = None  # the newest stamp
        self._counted = False
        self.repeats = False
        self._time = 0.0  # of the last report that counted
        self._since: dict[int, float] = {}  # axis at rest: time of the first report of this rest

    def report(self, stamp: float, moving: Iterable[int] = (), time: float | None = None) -> bool:
        """Take a report of the robot.

        Args:
            stamp: The robot's clock, or the number of the report.
            moving: Indices of the axes that it shows in motion.
            time: When it was received, for ``steady``. Default: the stamp.

        Returns:
            True if the report counts.
        """
        if self._newest is None:
            self._newest = stamp
            return False
        self.repeats = not stamp > self._newest  # True for NaN, too
        if self.repeats:
            return False
        self._newest, self._counted = stamp, True
        self._time = stamp if time is None else time
        in_motion = frozenset(moving)
        self._since = {axis: self._since.get(axis, self._time) for axis in self._axes if axis not in in_motion}
        return True

    @property
    def unsteady(self) -> frozenset[int]:
        """Indices of the axes that are not known to rest."""
        return frozenset(
            axis for axis in self._axes if not self._time - self._since.get(axis, math.inf) >= self._steady
        )

    @property
    def rest(self) -> Rest:
        """The conclusion for the whole robot, from the counted reports."""
        if not self.unsteady:
            return Rest.RESTS
        if not self._counted:
            return Rest.NOTHING_SINCE
        return Rest.TOO_SHORT if len(self._since) == len(self._axes) else Rest.MOVES
