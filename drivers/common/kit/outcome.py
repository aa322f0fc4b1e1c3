"""The result of a stop that a robot confirms for all axes at once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import MotorReport


class Outcome(NamedTuple):
    """The result of a stop for the whole robot.

    Attributes:
        written: The safe frame has left.
        acknowledged: The robot has answered.
        detail: Why the robot is not known to be safe; empty if it is.
    """

    written: bool
    acknowledged: bool
    detail: str

    def reports(
        self, axes: Sequence[str], ids: Sequence[int] = (), targets: Sequence[float | None] = ()
    ) -> tuple[MotorReport, ...]:
        """Return one report per axis, all with the same result.

        Args:
            axes: Keys of the axes.
            ids: Number of each motor. The default is 1, 2, 3 and so on.
            targets: Position at which each axis holds. The default is None for each.
        """
        written, acknowledged, detail = self
        numbers = ids or range(1, len(axes) + 1)
        held = targets or (None,) * len(axes)
        return tuple(
            MotorReport(axis, number, written, acknowledged, not detail, detail, target)
            for axis, number, target in zip(axes, numbers, held, strict=True)
        )


NOT_CONNECTED = Outcome(False, False, "not connected")


def names_of(axes: Sequence[Axis]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the keys and the ids of the axes, as ``Outcome.reports`` takes them."""
    return tuple(axis.key for axis in axes), tuple(axis.id for axis in axes)
