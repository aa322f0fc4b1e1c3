"""Compute poses of the tool, and joint positions for a pose, with the model of the arm.

The model is one of its own without scenery: its base stands at the origin, and it never moves by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.pose_search import PoseSearch

Matrix = Any
"""A numpy array."""

NEAR_M, NEAR_RAD = 1e-4, 5e-4
"""A solution may differ from the requested pose by this much."""

_M_OF_RAD = 0.3
_DAMPING_M = 3e-3


class Pose(NamedTuple):
    """A position and an orientation in the frame of the base."""

    m: Matrix
    quaternion: Matrix  # w, x, y, z

    @property
    def rotation(self) -> Matrix:
        matrix = np.zeros(9)
        mujoco.mju_quat2Mat(matrix, self.quaternion)
        return matrix.reshape(3, 3)


def pose_of(numbers: Sequence[float]) -> Pose:
    """Return the pose of six numbers of the wire: x, y, z in metres, and the angles in degrees about the fixed axes
    x, y and z in this order."""
    half = [math.radians(degrees) / 2.0 for degrees in numbers[3:]]
    (cx, cy, cz), (sx, sy, sz) = map(math.cos, half), map(math.sin, half)
    quaternion = np.array(
        (
            cx * cy * cz + sx * sy * sz,
            sx * cy * cz - cx * sy * sz,
            cx * sy * cz + sx * cy * sz,
            cx * cy * sz - sx * sy * cz,
        )
    )
    return Pose(np.array(numbers[:3], dtype=float), quaternion)


def numbers_of(pose: Pose) -> tuple[float, ...]:
    """Return the six numbers of a pose for the wire."""
    turn = pose.rotation
    angles = (
        math.atan2(turn[2, 1], turn[2, 2]),
        math.asin(max(-1.0, min(1.0, -turn[2, 0]))),
        math.atan2(turn[1, 0], turn[0, 0]),
    )
    return (*pose.m.tolist(), *map(math.degrees, angles))


def turn_between(start: Pose, end: Pose) -> Matrix:
    """Return the rotation vector from one orientation to another, along the axes of ``start``, in rad."""
    turn = np.zeros(3)
    mujoco.mju_subQuat(turn, end.quaternion, start.quaternion)
    return turn


def between(start: Pose, end: Pose, share: float) -> Pose:
    """Return the pose at a share (0..1) of the way from ``start`` to ``end``: a line and a turn about one axis."""
    quaternion = start.quaternion.copy()
    mujoco.mju_quatIntegrate(quaternion, turn_between(start, end), share)
    return Pose(start.m + (end.m - start.m) * share, quaternion)


class Kinematics:
    """The kinematics of one arm."""

    def __init__(self, table: Mapping[str, Any], link: str, tool: Pose) -> None:
        """Args:
        table: The robot's table in ``robots.toml``.
        link: The last link.
        tool: The pose of the tool in the frame of the last link.
        """
        self._model = _model_of(table["model_rows"])
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(joint["key"]) for joint in table["joints"]]
        self._joints = np.array([joint.id for joint in joints])
        self._qpos = np.array([int(self._model.jnt_qposadr[joint.id]) for joint in joints])
        self._link = self._model.body(link).id
        self._tool = tool
        ranges = [joint.get("range_rad", (-math.inf, math.inf)) for joint in table["joints"]]
        low, high = (np.array(ends) for ends in zip(*ranges, strict=True))
        self.search = PoseSearch(low, high, NEAR_M, NEAR_RAD, _M_OF_RAD, _DAMPING_M)

    def pose(self, rad: Sequence[float]) -> Pose:
        """Return the pose of the tool at these joint positions."""
        self._data.qpos[self._qpos] = rad
        mujoco.mj_kinematics(self._model, self._data)
        m, quaternion = np.zeros(3), np.zeros(4)
        mujoco.mju_mulPose(
            m,
            quaternion,
            self._data.xpos[self._link],
            self._data.xquat[self._link],
            self._tool.m,
            self._tool.quaternion,
        )
        return Pose(m, quaternion)

    def jacobian(self, rad: Sequence[float]) -> tuple[Pose, Matrix]:
        """Return the pose of the tool, and its derivative by the joint positions: three rows for x, y, z in m per
        rad, and three rows for the rotation about these axes."""
        pose = self.pose(rad)
        axes = self._data.xaxis[self._joints].T
        anchors = self._data.xanchor[self._joints].T
        return pose, np.vstack((np.cross(axes, pose.m[:, None] - anchors, axis=0), axes))

    def near(self, pose: Pose, rad: Sequence[float], steps: int = 80) -> Matrix | None:
        """Return joint positions for a pose, in the joint ranges.

        Args:
            pose: The pose of the tool.
            rad: The joint positions where the search starts. If there are several solutions, the nearest counts.
            steps: Steps of the search at most.

        Returns:
            The joint positions in rad; None without a solution.
        """

        def look(joints: Matrix) -> tuple[Matrix, Matrix]:
            here, jacobian = self.jacobian(joints)
            return np.concatenate((pose.m - here.m, here.rotation @ turn_between(here, pose))), jacobian

        return self.search.solve(look, rad, steps)


@cache
def _model_of(rows: str) -> Any:
    """Return the model of an arm. Nothing changes it, so all bases of a process share it."""
    return build({"model_rows": rows}).compile()
