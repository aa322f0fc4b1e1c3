"""The result of a stop that a robot confirms for all axes at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import MotorReport


class Outcome(NamedTuple):
    """The result of a stop for the whole robot.

    Attributes:
        written: True if the stop command was sent.
        acknowledged: True if the robot has answered the stop command.
        detail: Why it is unknown whether the robot is safe; empty if the robot is safe.
    """

    written: bool
    acknowledged: bool
    detail: str

    def reports(
        self, axes: Sequence[str], ids: Sequence[int] = (), targets: Sequence[float | None] = ()
    ) -> tuple[MotorReport, ...]:
        """Return one ``MotorReport`` per axis, all with the result of this stop.

        Args:
            axes: Keys of the axes.
            ids: Id of each axis's motor. The default is 1, 2, 3 and so on.
            targets: Position at which each axis holds. The default is None for each.
        """
        written, acknowledged, detail = self
        numbers = ids or range(1, len(axes) + 1)
        goals = targets or (None,) * len(axes)
        return tuple(
            MotorReport(axis, number, written, acknowledged, not detail, detail, target)
            for axis, number, target in zip(axes, numbers, goals, strict=True)
        )


NOT_CONNECTED = Outcome(False, False, "not connected")


def names_of(axes: Sequence[Axis]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the keys and the ids of the axes, as arguments for ``Outcome.reports``."""
    return tuple(axis.key for axis in axes), tuple(axis.id for axis in axes)
