"""Poses as the controller's clients write them. Pure: no I/O, no clock.

A pose on the wire has six numbers: x, y, z in millimetres, then a rotation. The rotation is roll, pitch and yaw
about the fixed axes x, y, z in this order, or a rotation vector ("axis angle"), both in rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from strands_actors.drivers.common.physics.poses import Matrix, Pose, rotation_of, vector_of


def pose_of(numbers: Sequence[float], *, axis_angle: bool = False) -> Pose:
    """Return the pose of six numbers of the wire."""
    x, y, z, a, b, c = numbers
    return Pose(np.array((x, y, z)), rotation_of((a, b, c)) if axis_angle else rotation_of_rpy(a, b, c))


def numbers_of(pose: Pose, *, axis_angle: bool = False) -> tuple[float, ...]:
    """Return the six numbers of a pose for the wire."""
    turn = vector_of(pose.rotation).tolist() if axis_angle else rpy_of(pose.rotation)
    return (*pose.place.tolist(), *turn)


def rotation_of_rpy(roll: float, pitch: float, yaw: float) -> Matrix:
    cr, sr = math.cos(roll), math.sin(roll)
    cp, sp = math.cos(pitch), math.sin(pitch)
    cy, sy = math.cos(yaw), math.sin(yaw)
    return np.array(
        (
            (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
            (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
            (-sp, cp * sr, cp * cr),
        )
    )


def rpy_of(rotation: Matrix) -> tuple[float, float, float]:
    pitch = math.asin(max(-1.0, min(1.0, -rotation[2, 0])))
    return math.atan2(rotation[2, 1], rotation[2, 2]), pitch, math.atan2(rotation[1, 0], rotation[0, 0])
