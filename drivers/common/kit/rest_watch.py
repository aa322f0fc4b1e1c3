"""Decide by a robot's own reports whether it stands still. Pure: no clock, no I/O.

The answer to a stop command confirms nothing: a service may answer before the motors have received the command.
Only the robot's reports of its motion confirm a stop. Three rules hold for every robot:

* The first report after the stop command is only the reference. It may have been made before the robot received the
  command.
* A later report counts only if its time stamp is newer than all stamps before. A controller that hangs, and a relay
  that repeats its last packet, send an old stamp again.
* An axis rests when every counted report of the last period ``steady`` shows it at rest. A single report is not
  enough: an axis that changes direction shows speed zero for a moment, and a command that is still on its way may
  set it in motion.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable


class Rest(enum.Enum):
    """Whether a robot stands still, as its reports show. The value of a member is the reason why the robot does
    not count as still, for messages; it is empty if the robot stands still."""

    NOTHING_SINCE = "it has reported nothing since"
    MOVES = "it moves"
    TOO_SHORT = "it has not stood still for long enough"
    RESTS = ""


class RestWatch:
    """Find which axes of a robot stand still since a stop command.

    Args:
        axes: Number of axes.
        steady: How long an axis must be reported at rest, in the unit of the times that are given to ``report``.
            0 means that one counted report is enough.

    Attributes:
        repeats: True if the last report had an old stamp. This is normal if a robot is read more often than it
            makes a new report.
    """

    def __init__(self, axes: int = 1, steady: float = 0.0) -> None:
        self._axes = range(axes)
        self._steady = steady
        self.restart()

    def restart(self) -> None:
        """Forget all reports, for example because an earlier command may still take effect. The next report is the
        reference."""
        self._newest: float | None = None  # the newest stamp; None before the first report
        self._counted = False
        self.repeats = False
        self._time = 0.0  # time of the last report that counted
        self._since: dict[int, float] = {}  # for each axis at rest: time of the first report that shows it at rest

    def report(self, stamp: float, moving: Iterable[int] = (), time: float | None = None) -> bool:
        """Take a report of the robot.

        Args:
            stamp: The time of the report by the robot's clock, or the number of the report.
            moving: Indices of the axes that the report shows in motion.
            time: Time at which the report was received, in the unit of ``steady``. The default is the stamp.

        Returns:
            True if the report counts.
        """
        if self._newest is None:
            self._newest = stamp
            return False
        self.repeats = not stamp > self._newest  # also True if the stamp is NaN
        if self.repeats:
            return False
        self._newest, self._counted = stamp, True
        self._time = stamp if time is None else time
        in_motion = frozenset(moving)
        self._since = {axis: self._since.get(axis, self._time) for axis in self._axes if axis not in in_motion}
        return True

    @property
    def unsteady(self) -> frozenset[int]:
        """Indices of the axes that are not known to stand still."""
        return frozenset(
            axis for axis in self._axes if not self._time - self._since.get(axis, math.inf) >= self._steady
        )

    @property
    def rest(self) -> Rest:
        """Whether the whole robot stands still, as the counted reports show."""
        if not self.unsteady:
            return Rest.RESTS
        if not self._counted:
            return Rest.NOTHING_SINCE
        return Rest.TOO_SHORT if len(self._since) == len(self._axes) else Rest.MOVES
