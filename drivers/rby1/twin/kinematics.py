"""Poses of links, their derivatives by the joints, and joint motions towards poses.

It has a model of its own, without scenery: its base stands at the origin, and it never moves by itself.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.kinematics.link_rows import parse_rows
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.poses import Matrix, Pose, Vector, vector_of

from .links import places_of

DAMPING = 1e-4
"""Damping of a step near singular positions, in square metres or radians."""


class Task(NamedTuple):
    """Something that the joints should bring to zero: an error, its derivative by the joints, and weights."""

    error: Vector
    jacobian: Matrix
    weight: Vector


class Kinematics:
    """The kinematics at one position of the joints, which ``place`` sets."""

    def __init__(self, table: Mapping[str, Any]) -> None:
        joints = [joint["key"] for joint in table["joints"]]
        self._model = _model_of(table)
        self._data = mujoco.MjData(self._model)
        self._qpos = np.array([int(self._model.joint(joint).qposadr[0]) for joint in joints])
        self._dof = np.array([int(self._model.joint(joint).dofadr[0]) for joint in joints])
        self._base = self._model.body("base").id
        self._places = {
            link: (self._model.body(place.body).id, np.array(place.offset_m), place.turn)
            for link, place in places_of(parse_rows(table["model_rows"])).items()
        }

    def knows(self, link: str) -> bool:
        return link in self._places

    def place(self, rad: Sequence[float]) -> None:
        """Set the joints to this position."""
        self._data.qpos[self._qpos] = rad
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)

    def pose(self, link: str) -> Pose:
        """Return the pose of a link in the frame of the base."""
        body, offset, turn = self._places[link]
        rotation = self._data.xmat[body].reshape(3, 3)
        return Pose(self._data.xpos[body] + rotation @ offset - self._data.xpos[self._base], rotation @ turn)

    def relative(self, reference: str, link: str) -> Pose:
        """Return the pose of a link in the frame of another one."""
        return self.pose(reference).inverse @ self.pose(link)

    def jacobian(self, reference: str, link: str) -> Matrix:
        """Return the derivative of such a pose by the joints: three rows for the position, and three for the
        rotation about the axes of the reference."""
        (here, link_jacobian), (there, reference_jacobian) = self._absolute(link), self._absolute(reference)
        back = self.pose(reference).rotation.T
        turning = reference_jacobian[3:]
        carried = np.cross(turning, here - there, axisa=0, axisb=0, axisc=0)
        linear = link_jacobian[:3] - reference_jacobian[:3] - carried
        return np.vstack((back @ linear, back @ (link_jacobian[3:] - turning)))

    def points(self, links: Sequence[str], offsets_m: Matrix) -> Matrix:
        """Return points in the frame of the base. Each is fixed to one of the links, at its offset there."""
        bodies = np.array([self._places[link][0] for link in links])
        turns = np.array([self._places[link][2] for link in links])
        rotations = self._data.xmat[bodies].reshape(-1, 3, 3)
        turned = np.einsum("nij,njk,nk->ni", rotations, turns, offsets_m)
        return self._data.xpos[bodies] + turned - self._data.xpos[self._base]

    @property
    def center(self) -> Vector:
        """The centre of mass in the frame of the base."""
        return self._data.subtree_com[self._base] - self._data.xpos[self._base]

    def mass_center(self, reference: str) -> tuple[Vector, Matrix]:
        """Return the centre of mass in the frame of a link, and its derivative by the joints."""
        here, jacobian = self._absolute(reference)
        back = self.pose(reference).rotation.T
        center = self._data.subtree_com[self._base].copy()
        mass = np.zeros((3, self._model.nv))
        mujoco.mj_jacSubtreeCom(self._model, self._data, mass, self._base)
        carried = np.cross(jacobian[3:], center - here, axisa=0, axisb=0, axisc=0)
        return back @ (center - here), back @ (mass[:, self._dof] - jacobian[:3] - carried)

    def inertia(self) -> Matrix:
        """Return the inertia matrix of the joints, in kg m2."""
        mujoco.mj_forward(self._model, self._data)
        whole = np.zeros((self._model.nv, self._model.nv))
        for row, unit in zip(whole, np.eye(self._model.nv), strict=True):
            mujoco.mj_mulM(self._model, self._data, row, unit)
        return whole[np.ix_(self._dof, self._dof)]

    def _absolute(self, link: str) -> tuple[Vector, Matrix]:
        """Return the place of a link in the world, and the derivative of its pose by the joints."""
        body, offset, _ = self._places[link]
        point = self._data.xpos[body] + self._data.xmat[body].reshape(3, 3) @ offset
        linear, angular = np.zeros((3, self._model.nv)), np.zeros((3, self._model.nv))
        mujoco.mj_jac(self._model, self._data, linear, angular, point, body)
        return point, np.vstack((linear[:, self._dof], angular[:, self._dof]))


def error_of(target: Pose, here: Pose) -> Vector:
    """Return what is missing to a pose: metres, and the rotation as a vector in rad, both along the axes of the
    reference."""
    return np.concatenate((target.place - here.place, vector_of(target.rotation @ here.rotation.T)))


def step_towards(tasks: Sequence[Task], rad: Vector, low: Vector, high: Vector, most_rad: Vector) -> Vector:
    """Return the joint motion that brings the errors of all tasks nearest to zero.

    Args:
        tasks: The tasks. Their derivatives have one column for each joint.
        rad: The position of the joints.
        low: The least positions.
        high: The largest positions.
        most_rad: The largest motion of each joint. A longer step is shortened as a whole.
    """
    jacobian = np.vstack([task.jacobian for task in tasks])
    error = np.concatenate([task.error for task in tasks])
    weight = np.concatenate([task.weight for task in tasks])
    step = np.zeros(len(rad))
    free = np.ones(len(rad), dtype=bool)
    for _ in range(len(rad)):
        rows = jacobian[:, free]
        missing = error - jacobian[:, ~free] @ step[~free]
        square = rows.T @ (weight[:, None] * rows) + DAMPING * np.eye(int(free.sum()))
        step[free] = np.linalg.solve(square, rows.T @ (weight * missing))
        # A joint at its end takes no part, and the others make up for it.
        past = free & ((rad + step < low - 1e-9) | (rad + step > high + 1e-9))
        if not past.any():
            break
        step[past] = np.clip(rad + step, low, high)[past] - rad[past]
        free &= ~past
        if not free.any():
            break
    excess = float(np.max(np.abs(step) / np.maximum(most_rad, 1e-9)))
    return np.clip(rad + (step / excess if excess > 1.0 else step), low, high) - rad


def manipulability(jacobian: Matrix) -> float:
    """Return how near to a singular position a link is: the ratio of the largest to the least eigenvalue of the
    squared derivative of its pose. It is infinite in a singular position [assumed: the vendor gives no formula]."""
    values = np.linalg.svd(jacobian, compute_uv=False)
    least = float(values[-1]) if len(values) >= 6 else 0.0
    return math.inf if least < 1e-9 else float(values[0] / least) ** 2


_MODELS: dict[str, Any] = {}
"""Models by the rows of their tables. Nothing changes them, so all controllers of a process share them."""


def _model_of(table: Mapping[str, Any]) -> Any:
    rows = table["model_rows"]
    if rows not in _MODELS:
        _MODELS[rows] = build(table).compile()
    return _MODELS[rows]
