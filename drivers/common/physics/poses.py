"""Poses of simulated tools and links, as numpy arrays. Pure: no I/O, no clock."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .lean_mujoco import mujoco

Vector = Any
"""A numpy array of three numbers."""
Matrix = Any
"""A numpy array."""


class Pose(NamedTuple):
    """A position and a rotation in another frame.

    Attributes:
        place: The position, in the unit of length of the robot's protocol.
        rotation: A matrix of 3 x 3.
    """

    place: Vector
    rotation: Matrix

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose whose frame is ``other``, seen from the frame of ``self``."""
        return Pose(self.place + self.rotation @ other.place, self.rotation @ other.rotation)

    @property
    def inverse(self) -> Pose:
        turned = self.rotation.T
        return Pose(-turned @ self.place, turned)


ORIGIN = Pose(np.zeros(3), np.eye(3))


def vector_of(rotation: Matrix) -> Vector:
    """Return a rotation as a vector: its axis, as long as its angle in rad, which is at most pi."""
    quaternion, vector = np.zeros(4), np.zeros(3)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(rotation).ravel())
    mujoco.mju_quat2Vel(vector, quaternion, 1.0)
    return vector


def rotation_of(vector: Sequence[float]) -> Matrix:
    """Return the rotation about a vector by its length in rad."""
    turn = np.asarray(vector, dtype=float)
    angle = float(np.linalg.norm(turn))
    if angle < 1e-12:
        return np.eye(3)
    quaternion, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_axisAngle2Quat(quaternion, turn / angle, angle)
    mujoco.mju_quat2Mat(matrix, quaternion)
    return matrix.reshape(3, 3)


def between(start: Pose, end: Pose, share: float) -> Pose:
    """Return the pose at a share (0..1) of the way from ``start`` to ``end``: a line and a turn about one axis."""
    turn = rotation_of(share * vector_of(end.rotation @ start.rotation.T))
    return Pose(start.place + share * (end.place - start.place), turn @ start.rotation)


def angle_between(start: Pose, end: Pose) -> float:
    """Return the angle between two rotations in rad."""
    return float(np.linalg.norm(vector_of(start.rotation.T @ end.rotation)))


__all__ = ["ORIGIN", "Matrix", "Pose", "Vector", "angle_between", "between", "rotation_of", "vector_of"]
