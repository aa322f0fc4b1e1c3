"""Bring a calibration file of an earlier LeRobot into the present form, or say by name why it cannot be. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

LISTS = ("motor_names", "homing_offset", "drive_mode", "start_pos", "end_pos", "calib_mode")
"""Keys of the form up to LeRobot 0.2: one list for each field, in the order of ``motor_names``."""
COUNTS = 4096
LAST = COUNTS - 1


def present_form(content: Any, source: str, offset_moves_end: bool, max_offset: int) -> tuple[Any, list[str]]:
    """Return the content of a calibration file in the present form, and the motors that were mended.

    A range beyond the servo's counts was recorded by a LeRobot that did not notice the end of the encoder. It is
    moved into one turn, with the homing offset, so that it is the same range of the joint.

    Args:
        content: The decoded content.
        source: The name of the file, for messages.
        offset_moves_end: True for a servo on which the homing offset also moves the end of its counts.
        max_offset: The largest value that the homing offset register can hold.

    Raises:
        ValueError: The file has the form of LeRobot 0.2 or older, which has no ranges.
    """
    if not isinstance(content, Mapping):
        return content, []
    if set(LISTS) & set(content):
        raise ValueError(
            f"calibration {source}: has the form of LeRobot 0.2 or older ({', '.join(sorted(content))}), which has "
            "no range_min and range_max, and another zero. Calibrate again"
        )
    if not offset_moves_end:
        return content, []
    mended = {name: _mended(entry, max_offset) for name, entry in content.items()}
    return mended, [name for name, entry in content.items() if mended[name] != entry]


def _mended(entry: Any, max_offset: int) -> Any:
    fields = ("range_min", "range_max", "homing_offset")
    if not isinstance(entry, Mapping) or any(type(entry.get(field)) is not int for field in fields):
        return entry
    low, high, offset = (entry[field] for field in fields)
    if (low >= 0 and high <= LAST) or not 0 < high - low < COUNTS:
        return entry
    shift = LAST // 2 - (low + high) // 2
    # The servo reports its encoder's count without the offset. A turn more or less is the same offset.
    moved = (offset - shift + COUNTS // 2) % COUNTS - COUNTS // 2
    kept = max(-max_offset, min(max_offset, moved))
    shift += moved - kept
    return {**entry, "homing_offset": kept, "range_min": max(0, low + shift), "range_max": min(LAST, high + shift)}
