"""Convert rotations, for all robots that report or accept them."""

from __future__ import annotations

import math
from collections.abc import Sequence


def roll_pitch_yaw(quaternion_wxyz: Sequence[float]) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a unit quaternion, in radians.

    They are rotations about x, then y, then z, with fixed axes.

    Args:
        quaternion_wxyz: The quaternion, with its real part ``w`` first.
    """
    w, x, y, z = quaternion_wxyz
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return roll, pitch, yaw


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Return the unit quaternion w, x, y, z of roll, pitch and yaw (see ``roll_pitch_yaw``).

    Args:
        roll: Rotation about the fixed axis x, in radians.
        pitch: Rotation about the fixed axis y.
        yaw: Rotation about the fixed axis z.
    """
    cr, sr, cp, sp, cy, sy = (part(angle / 2) for angle in (roll, pitch, yaw) for part in (math.cos, math.sin))
    return (
        cr * cp * cy + sr * sp * sy,
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
    )
