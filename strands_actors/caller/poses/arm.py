"""The body of an arm in MuJoCo: the pose of its tool, the derivative of that pose, and contacts of the arm.

The model is never simulated. Joint positions are set, and the positions of links are read.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from strands_actors.contract.arm_model import ArmModel

from .bodies import KEEP_OUT, WHOLE_TURN_RAD, Array, Pair, body_of, mujoco, with_spaces
from .request import Box, rpy_of

CLEARANCE_M = 0.005
"""The arm keeps this distance from the spaces that it may not enter."""


class Pose(NamedTuple):
    """A pose in the frame of the base: position in m, orientation as w, x, y, z."""

    xyz: Array
    quat: Array

    def as_json(self) -> dict[str, list[float]]:
        """Return the pose with its orientation as ``quat``, and as ``rpy`` in degrees."""
        quat = self.quat if self.quat[0] >= 0 else -self.quat
        return {
            "xyz": [round(float(value), 6) for value in self.xyz],
            "rpy": [round(value, 4) for value in rpy_of(quat.tolist())],
            "quat": [round(float(value), 6) for value in quat],
        }


class Touch(NamedTuple):
    """Two parts that touch. ``box`` is the index of a space to keep out of; None if both are links."""

    link: str
    other: str
    box: int | None


class Arm:
    """An arm with the limits of its joints.

    Args:
        model: The model of the arm.
        low: Least position of each joint of ``model.joints``, in rad.
        high: Greatest position of each joint.
        others: Positions of further joints of the model in rad, such as a gripper.
        keep_out: Spaces that the arm may not enter.
    """

    def __init__(
        self,
        model: ArmModel,
        low: Sequence[float],
        high: Sequence[float],
        others: Mapping[str, float] | None = None,
        keep_out: Sequence[Box] = (),
    ) -> None:
        self._body = body_of(model)
        self._model, self._pairs, self._spaces = with_spaces(self._body, keep_out)
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(name).id for name in model.joints]
        self._qpos, self._dof = self._model.jnt_qposadr[joints], self._model.jnt_dofadr[joints]
        self._along, self._about = np.zeros((2, 3, self._model.nv))
        limited = self._model.jnt_limited[joints].astype(bool)
        least, most = np.where(limited, self._model.jnt_range[joints].T, [[-np.inf], [np.inf]])
        self.names = model.joints
        self.low: Array = np.maximum(low, least)
        self.high: Array = np.minimum(high, most)
        self.home: Array = np.clip(model.home or self.middle(), self.low, self.high)
        for name, value in (others or {}).items():
            joint = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_JOINT, name)
            if joint >= 0:
                self._data.qpos[self._model.jnt_qposadr[joint]] = value

    def middle(self) -> Array:
        """Return the middle of each joint's range; 0 for a joint without limits."""
        low, high = self.searched()
        return (low + high) / 2

    def searched(self) -> tuple[Array, Array]:
        """Return finite ranges of the joints, from which a search may start."""
        return np.maximum(self.low, -WHOLE_TURN_RAD), np.minimum(self.high, WHOLE_TURN_RAD)

    def pose(self, rad: Array) -> Pose:
        """Return the pose of the tool at these joint positions."""
        data = self._data
        data.qpos[self._qpos] = rad
        mujoco.mj_kinematics(self._model, data)
        return Pose(*self._body.tool.pose(data))

    def jacobian(self, rad: Array) -> tuple[Pose, Array]:
        """Return the pose of the tool, and its derivative: three rows of m per rad, then three of rotation."""
        pose = self.pose(rad)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_jac(self._model, self._data, self._along, self._about, pose.xyz, self._body.tool.link)
        return pose, np.concatenate((self._along[:, self._dof], self._about[:, self._dof]))

    def starts(self, goal: Pose, m_of_rad: float, count: int) -> Array:
        """Return the random joint positions with the poses nearest to a goal.

        Args:
            goal: The goal.
            m_of_rad: A turn by one rad weighs as much as this distance.
            count: How many to return.
        """
        far = np.linalg.norm(self._body.places - goal.xyz, axis=1)
        turned = 2 * np.arccos(np.minimum(np.abs(self._body.turns @ goal.quat), 1.0))
        nearest = np.argsort(far + m_of_rad * turned)[:count]
        return np.clip(self._body.samples[nearest], self.low, self.high)

    def overlaps(self, rad: Array) -> frozenset[Pair]:
        """Return the pairs of links that overlap at these joint positions."""
        self.pose(rad)
        return frozenset(pair for pair in self._pairs if self._distance(pair, 0.0) < 0)

    def touch(self, rad: Array, ignored: frozenset[Pair] = frozenset()) -> Touch | None:
        """Return a contact of the arm at these joint positions; None without a contact.

        Args:
            rad: The joint positions.
            ignored: Pairs of links that may overlap.
        """
        self.pose(rad)
        for pair in self._spaces:
            if self._distance(pair, CLEARANCE_M) < CLEARANCE_M:
                name = self._model.geom(pair[1]).name
                return Touch(self._owner(pair[0]), "", int(name.removeprefix(KEEP_OUT)))
        for pair in self._pairs:
            if pair not in ignored and self._distance(pair, 0.0) < 0:
                return Touch(self._owner(pair[0]), self._owner(pair[1]), None)
        return None

    def _distance(self, pair: Pair, most: float) -> float:
        return float(mujoco.mj_geomDistance(self._model, self._data, *pair, most + 1e-3, None))

    def _owner(self, geom: int) -> str:
        return str(self._model.body(self._model.geom_bodyid[geom]).name)


def turn_between(start: Array, end: Array) -> Array:
    """Return the rotation vector from one orientation to another, along the axes of the base, in rad."""
    local, turn = np.zeros(3), np.zeros(3)
    mujoco.mju_subQuat(local, end, start)
    mujoco.mju_rotVecQuat(turn, local, start)
    return turn


def rotated(quat: Array, turn: Array) -> Array:
    """Return an orientation after a turn: a rotation vector in rad, along the axes of the base."""
    about, result = np.zeros(4), np.zeros(4)
    angle = float(np.linalg.norm(turn))
    mujoco.mju_axisAngle2Quat(about, turn / angle if angle else np.array([1.0, 0.0, 0.0]), angle)
    mujoco.mju_mulQuat(result, about, quat)
    return result


def between(start: Pose, end: Pose, share: float) -> Pose:
    """Return the pose at a share (0 to 1) of the way: along a line, and by a turn about one axis."""
    quat, local = start.quat.copy(), np.zeros(3)
    mujoco.mju_subQuat(local, end.quat, start.quat)
    mujoco.mju_quatIntegrate(quat, local, share)
    return Pose(start.xyz + (end.xyz - start.xyz) * share, quat)


def composed(first: Pose, second: Pose) -> Pose:
    """Return ``second``, which is given in the frame of ``first``, in the frame of the base."""
    xyz, quat = np.zeros(3), np.zeros(4)
    mujoco.mju_mulPose(xyz, quat, first.xyz, first.quat, second.xyz, second.quat)
    return Pose(xyz, quat)


__all__ = ["Arm", "Array", "Pair", "Pose", "Touch", "between", "composed", "rotated", "turn_between"]
