"""Poses as the controller's clients write them. Pure: no I/O, no clock.

A pose on the wire has six numbers: x, y, z in millimetres, then a rotation. The rotation is roll, pitch and yaw
about the fixed axes x, y, z in this order, or a rotation vector ("axis angle"), both in rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

Matrix = Any
"""A numpy array."""


class Pose(NamedTuple):
    """A position and a rotation in the frame of the base."""

    mm: Matrix
    rotation: Matrix  # 3 x 3

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose whose frame is ``other``, seen from the frame of ``self``."""
        return Pose(self.mm + self.rotation @ other.mm, self.rotation @ other.rotation)

    @property
    def inverse(self) -> Pose:
        turned = self.rotation.T
        return Pose(-turned @ self.mm, turned)


ORIGIN = Pose(np.zeros(3), np.eye(3))


def pose_of(numbers: Sequence[float], *, axis_angle: bool = False) -> Pose:
    """Return the pose of six numbers of the wire."""
    x, y, z, a, b, c = numbers
    return Pose(np.array((x, y, z)), rotation_of((a, b, c)) if axis_angle else rotation_of_rpy(a, b, c))


def numbers_of(pose: Pose, *, axis_angle: bool = False) -> tuple[float, ...]:
    """Return the six numbers of a pose for the wire."""
    turn = vector_of(pose.rotation) if axis_angle else rpy_of(pose.rotation)
    return (*pose.mm.tolist(), *turn)


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


def rotation_of(vector: Sequence[float]) -> Matrix:
    """Return the rotation about a vector by its length in rad."""
    angle = math.hypot(*vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = (each / angle for each in vector)
    cross = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    return np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross


def vector_of(rotation: Matrix) -> tuple[float, float, float]:
    """Return the rotation vector of a rotation. Its length is at most pi."""
    cosine = max(-1.0, min(1.0, (float(np.trace(rotation)) - 1.0) / 2.0))
    twice = (
        rotation[2, 1] - rotation[1, 2],
        rotation[0, 2] - rotation[2, 0],
        rotation[1, 0] - rotation[0, 1],
    )
    sine = math.hypot(*twice) / 2.0
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        x, y, z = (float(each) / (2.0 * sine) * angle for each in twice)
        return x, y, z
    if cosine > 0.0:
        x, y, z = (float(each) / 2.0 for each in twice)
        return x, y, z
    # A half turn: the axis is the longest column of the symmetric part.
    symmetric = (rotation + np.eye(3)) / 2.0
    column = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    x, y, z = (float(each) * math.pi for each in column / np.linalg.norm(column))
    return x, y, z


def between(start: Pose, end: Pose, share: float) -> Pose:
    """Return the pose at a share (0..1) of the way from ``start`` to ``end``: a line and a turn about one axis."""
    turn = np.array(vector_of(start.rotation.T @ end.rotation)) * share
    return Pose(start.mm + (end.mm - start.mm) * share, start.rotation @ rotation_of(turn.tolist()))


def angle_between(start: Pose, end: Pose) -> float:
    """Return the angle between two rotations in rad."""
    return math.hypot(*vector_of(start.rotation.T @ end.rotation))
