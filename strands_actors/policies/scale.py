"""Convert between a driver's units and the scale of LeRobot's arms. Pure.

LeRobot's datasets and checkpoints do not state their units. Its arms record degrees, or by default a
share of each joint's calibrated range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

NORMALIZED = "normalized"
"""The name of LeRobot's scale, as ``units``."""
GRIPPER = "gripper"
"""lerobot's name for the one motor that it counts from 0 to 100, whatever the others are in."""


class Scale:
    """Between the driver's units and -100..100 (the gripper: 0..100) of lerobot, which bounds both.
    ``travel``: each axis' calibrated range in the driver's units. Raise ``ValueError`` for an axis
    without one."""

    def __init__(self, axes: Sequence[str], travel: Mapping[str, Sequence[float]]) -> None:
        if missing := [axis for axis in axes if axis not in travel]:
            raise ValueError(
                f"units={NORMALIZED!r} is a share of each joint's calibrated range, and there is none of "
                f"{', '.join(missing)}. give the robot calibration=, the file of the arm that recorded"
            )
        self._ranges = [(0.0 if axis == GRIPPER else -100.0, *travel[axis]) for axis in axes]

    def to_lerobot(self, values: Sequence[float]) -> list[float]:
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, low, high, least, 100.0) for value, (least, low, high) in rows]

    def from_lerobot(self, values: Sequence[float]) -> list[float]:
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, least, 100.0, low, high) for value, (least, low, high) in rows]


def _onto(value: float, low: float, high: float, new_low: float, new_high: float) -> float:
    """From one range onto another; what is outside, and no NaN, goes to the nearer end."""
    moved = new_low + (value - low) / (high - low) * (new_high - new_low)
    return new_low if moved < new_low else new_high if moved > new_high else moved


def unit_word(unit: str) -> str:
    """Return a driver's unit in one word, as ``units`` names it."""
    return unit.partition(" ")[0].strip(",")


__all__ = ["NORMALIZED", "Scale", "unit_word"]
