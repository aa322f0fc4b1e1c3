"""Compute poses of the tool, and joint positions for a pose, with the model of the arm.

It is a model of its own, without scenery: its base stands at the origin, and it never moves by itself.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.pose_search import PoseSearch
from strands_actors.drivers.common.physics.poses import ORIGIN, Matrix, Pose, vector_of
from strands_actors.drivers.xarm.arms import AXES, ArmType, mirrored, model_table

NEAR_MM, NEAR_RAD = 0.05, 5e-4
"""A solution may differ from the requested pose by this much."""

_MM_OF_RAD = 300.0
_DAMPING_MM = 3.0
_STEPS, _SEEDS = 80, 5

_BENT_RAD = (0.0, -0.3, 0.0, 0.9, 0.0, 1.2, 0.0)
"""A bent pose, from which many poses in front of the arm can be reached."""


class Kinematics:
    """The kinematics of one arm, with the offsets of its tool and of its base."""

    def __init__(self, robot: str, arm_type: ArmType) -> None:
        self._model = _model_of(robot, arm_type)
        self._data = mujoco.MjData(self._model)
        joints = [self._model.joint(axis) for axis in AXES]
        self._joints = np.array([joint.id for joint in joints])
        self._qpos = np.array([int(self._model.jnt_qposadr[joint.id]) for joint in joints])
        self._flange = self._model.body("link7").id
        low, high = (np.array(ends) for ends in zip(*arm_type.range_rad, strict=True))
        self._search = PoseSearch(low, high, NEAR_MM, NEAR_RAD, _MM_OF_RAD, _DAMPING_MM)
        self._bent = mirrored(arm_type, _BENT_RAD)
        # A flange farther from the shoulder than the sum of the links is out of reach.
        links = [self._model.body_pos[self._model.body(f"link{number}").id] for number in range(1, len(AXES) + 1)]
        self._shoulder_mm = links[0] * 1e3
        self._reach_mm = 1e3 * sum(float(np.linalg.norm(link)) for link in links[1:])
        self.set_tool(None)
        self.set_world(None)

    def set_tool(self, offset: Pose | None) -> None:
        """Set the pose of the tool's centre in the frame of the flange. None: the flange itself."""
        self._tool, self._has_tool = offset or ORIGIN, offset is not None

    def set_world(self, offset: Pose | None) -> None:
        """Set the pose of the base in the frame in which clients write poses. None: the base itself [assumed]."""
        self._world, self._has_world = offset or ORIGIN, offset is not None

    def pose(self, rad: Sequence[float]) -> Pose:
        """Return the pose of the tool at these joint positions."""
        self._data.qpos[self._qpos] = rad
        mujoco.mj_kinematics(self._model, self._data)
        rotation = self._data.xmat[self._flange].reshape(3, 3)
        flange = Pose(self._data.xpos[self._flange] * 1e3, rotation.copy())
        if self._has_tool:
            flange @= self._tool
        return self._world @ flange if self._has_world else flange

    def jacobian(self, rad: Sequence[float]) -> tuple[Pose, Matrix]:
        """Return the pose of the tool, and its derivative by the joint positions: three rows for x, y, z in mm per
        rad, and three rows for the rotation about these axes."""
        pose = self.pose(rad)
        turn = self._world.rotation
        axes = turn @ self._data.xaxis[self._joints].T
        anchors = self._world.place[:, None] + turn @ (self._data.xanchor[self._joints].T * 1e3)
        return pose, np.vstack((np.cross(axes, pose.place[:, None] - anchors, axis=0), axes))

    def rates(self, rad: Sequence[float], twist: Matrix) -> Matrix:
        """Return the joint speeds in rad/s for a twist of the tool: mm/s, then rad/s about the axes of the base."""
        _, jacobian = self.jacobian(rad)
        return self._search.least_rates(jacobian, twist)

    def near(self, pose: Pose, rad: Sequence[float], steps: int = 8) -> Matrix | None:
        """Return joint positions for a pose, in the joint ranges.

        Args:
            pose: The pose of the tool.
            rad: The joint positions where the search starts. If there are several solutions, the nearest counts.
            steps: Steps of the search at most.

        Returns:
            The joint positions in rad; None without a solution.
        """

        def look(joints_rad: Matrix) -> tuple[Matrix, Matrix]:
            here, jacobian = self.jacobian(joints_rad)
            return np.concatenate((pose.place - here.place, vector_of(pose.rotation @ here.rotation.T))), jacobian

        return self._search.solve(look, rad, steps)

    def solve(self, pose: Pose, rad: Sequence[float], most_rad: float = math.inf) -> Matrix | None:
        """Return joint positions for a pose, from any start.

        Args:
            pose: The pose of the tool.
            rad: The joint positions where the first search starts.
            most_rad: Largest angle of a joint, in both directions.

        Returns:
            The joint positions in rad; None if no search finds any.
        """
        flange = self._world.inverse @ pose @ self._tool.inverse
        if np.linalg.norm(flange.place - self._shoulder_mm) > self._reach_mm:
            return None
        # The same pose always has the same answer.
        chance = random.Random(0)
        starts: list[Sequence[float]] = [rad, self._bent]
        while len(starts) < _SEEDS:
            starts.append(tuple(chance.uniform(max(low, -2.5), min(high, 2.5)) for low, high in self._ranges))
        for start in starts:
            solution = self.near(pose, start, _STEPS)
            if solution is not None and np.abs(solution).max() <= most_rad:
                return solution
        return None

    @property
    def _ranges(self) -> list[tuple[float, float]]:
        return list(zip(self._search.low.tolist(), self._search.high.tolist(), strict=True))


@cache
def _model_of(robot: str, arm_type: ArmType) -> Any:
    """Return the model of an arm. Nothing changes it, so all controllers of a process share it."""
    return Plant.from_table(model_table(robot, arm_type)).model
