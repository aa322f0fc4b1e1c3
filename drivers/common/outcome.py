"""What became of making a robot safe that answers for itself as a whole."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.contract.axis import Axis
from strands_actors.contract.wire import MotorReport


class Outcome(NamedTuple):
    """``detail``: why it is not known to be safe; empty when it is."""

    written: bool
    acknowledged: bool
    detail: str

    def reports(
        self, axes: Sequence[str], ids: Sequence[int] = (), targets: Sequence[float | None] = ()
    ) -> tuple[MotorReport, ...]:
        """Return one report an axis, all alike. ``ids``: 1, 2, 3 ... unless given. ``targets``: where
        each was told to stay."""
        written, acknowledged, detail = self
        numbers = ids or range(1, len(axes) + 1)
        told = targets or (None,) * len(axes)
        return tuple(
            MotorReport(axis, number, written, acknowledged, not detail, detail, target)
            for axis, number, target in zip(axes, numbers, told, strict=True)
        )


NOT_CONNECTED = Outcome(False, False, "not connected")


def names_of(axes: Sequence[Axis]) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return keys and ids, as ``Outcome.reports`` takes them."""
    return tuple(axis.key for axis in axes), tuple(axis.id for axis in axes)
