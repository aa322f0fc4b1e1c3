"""Convert between a driver's units and the scale of LeRobot's arms. Pure.

LeRobot's datasets and checkpoints do not state their units. LeRobot's arms record degrees, or by default
a share of each joint's calibrated range.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

NORMALIZED = "normalized"
"""The name of LeRobot's scale, as ``units``."""
GRIPPER = "gripper"
"""LeRobot's name for the gripper's motor. It is the only motor that LeRobot always counts from 0 to 100."""


class Scale:
    """Convert between the driver's units and LeRobot's scale, -100..100 (the gripper 0..100).

    A value outside the range is replaced by the nearer end of the range.

    Args:
        axes: Names of the axes.
        travel: Calibrated range of each axis, in the driver's units.

    Raises:
        ValueError: An axis has no calibrated range.
    """

    def __init__(self, axes: Sequence[str], travel: Mapping[str, Sequence[float]]) -> None:
        if missing := [axis for axis in axes if axis not in travel]:
            raise ValueError(
                f"units={NORMALIZED!r} is a share of each joint's calibrated range, which is unknown for "
                f"{', '.join(missing)}. Give the robot calibration=, the file of the arm that recorded the data"
            )
        self._ranges = [(0.0 if axis == GRIPPER else -100.0, *travel[axis]) for axis in axes]

    def to_lerobot(self, values: Sequence[float]) -> list[float]:
        """Return values on LeRobot's scale from values in the driver's units, in the order of the axes."""
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, low, high, least, 100.0) for value, (least, low, high) in rows]

    def from_lerobot(self, values: Sequence[float]) -> list[float]:
        """Return values in the driver's units from values on LeRobot's scale, in the order of the axes."""
        rows = zip(values, self._ranges, strict=True)
        return [_onto(value, least, 100.0, low, high) for value, (least, low, high) in rows]


def _onto(value: float, low: float, high: float, new_low: float, new_high: float) -> float:
    """Map a value from one range to another. A value outside becomes the nearer end of the range; NaN stays NaN."""
    moved = new_low + (value - low) / (high - low) * (new_high - new_low)
    return new_low if moved < new_low else new_high if moved > new_high else moved


def unit_word(unit: str) -> str:
    """Return the word for a driver's unit that the option ``units`` accepts."""
    return unit.partition(" ")[0].strip(",")


__all__ = ["NORMALIZED", "Scale", "unit_word"]
