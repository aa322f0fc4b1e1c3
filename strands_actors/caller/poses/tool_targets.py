"""Turn poses of a tool into joint targets, step by step, for policies and for teleoperation. Pure.

A step is a short motion, such as one action of a policy. The search for its joint positions starts at those before
it, so the arm keeps its posture. The gates check the speed of the joints, as of any setpoint.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Driver
from strands_actors.contract.plain_numbers import as_python
from strands_actors.contract.pose_keys import GRIPPER_KEY, POSE_KEYS, POSITION_KEYS, PREFIX, TURN_KEYS
from strands_actors.kernel.messages import Refused

from . import refusals
from .arm import Arm, Array, Pose, rotated, turn_between
from .plans import FULL_JOINTS, TOLERANCE_M, TOLERANCE_RAD
from .search import NEXT_STEPS, follow, solve
from .timing import limits_of, units_of

GRIPPER_UNIT = "percent"
UNTURNED = np.array([1.0, 0.0, 0.0, 0.0])
"""The orientation of the base, as w, x, y, z."""


class ToolTargets:
    """The tool of one robot's arm.

    Args:
        driver: The driver of the robot. Its ``arm_model`` must not be None.
    """

    def __init__(self, driver: Driver) -> None:
        model = driver.arm_model({})
        assert model is not None, driver.robot
        self._arm = Arm(model, *limits_of(driver, model))
        self._units = units_of(driver, model.joints)
        self._joints = model.joints
        self._axes = driver.axes
        self._gripper = next((axis.key for axis in driver.table if axis.unit == GRIPPER_UNIT), None)
        self._overlaps: frozenset[tuple[int, int]] | None = None

    @property
    def joints(self) -> tuple[str, ...]:
        """The keys of the joints that move the tool."""
        return self._joints

    def pose(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the pose of the tool by key, and the position of the gripper, at positions by axis."""
        pose = self._arm.pose(self._rad(positions))
        values = [*pose.xyz.tolist(), *turn_between(UNTURNED, pose.quat).tolist()]
        result: dict[str, float] = dict(zip(POSE_KEYS, values, strict=True))
        if self._gripper is not None:
            result[GRIPPER_KEY] = positions[self._gripper]
        return result

    def place(self, positions: Mapping[str, float]) -> tuple[float, float, float] | None:
        """Return the position of the tool in m; None if a joint has no position."""
        if not all(math.isfinite(positions.get(joint, math.nan)) for joint in self._joints):
            return None
        x, y, z = self._arm.pose(
            self._rad({axis: positions.get(axis, math.nan) for axis in self._axes})
        ).xyz.tolist()
        return x, y, z

    def targets(self, action: Mapping[str, Any], before: Mapping[str, float]) -> dict[str, Any] | Refused:
        """Return the action with joint targets in place of the keys of a pose.

        Args:
            action: ``ee.x``, ``ee.y`` and ``ee.z``; perhaps ``ee.wx``, ``ee.wy`` and ``ee.wz`` (without them the
                orientation is kept), ``ee.gripper_pos``, and axes that do not move the tool.
            before: The position of each axis before the step.
        """
        wrong = self._refuse_keys(action)
        if wrong is not None:
            return wrong
        rest = {key: value for key, value in action.items() if not key.startswith(PREFIX)}
        if GRIPPER_KEY in action and self._gripper is not None:
            rest[self._gripper] = action[GRIPPER_KEY]
        if POSITION_KEYS[0] not in action:
            return rest
        numbers = {key: finite(as_python(action[key])) for key in POSE_KEYS if key in action}
        if bad := [key for key, number in numbers.items() if number is None]:
            return refusals.bad_pose_number(bad[0], action[bad[0]])
        rad, values = self._rad(before), [number or 0.0 for number in numbers.values()]
        quat = self._arm.pose(rad).quat
        if TURN_KEYS[0] in action:
            quat = rotated(UNTURNED, np.array(values[3:]))
        reached = self._reach(Pose(np.array(values[:3]), quat), rad)
        return reached if isinstance(reached, Refused) else {**rest, **self._named(reached)}

    def moved(
        self, before: Mapping[str, float], velocity: Mapping[str, float], passed_s: float
    ) -> dict[str, float] | Refused:
        """Return the joint targets after a motion of the tool at a constant velocity.

        Args:
            before: The position of each axis before.
            velocity: Velocity by key, in m/s and rad/s, along and about the axes of the base.
            passed_s: Duration of the motion.
        """
        rad = self._rad(before)
        here = self._arm.pose(rad)
        step = np.array([velocity.get(key, 0.0) for key in POSE_KEYS]) * passed_s
        reached = self._reach(Pose(here.xyz + step[:3], rotated(here.quat, step[3:])), rad)
        return reached if isinstance(reached, Refused) else self._named(reached)

    def _reach(self, goal: Pose, rad: Array) -> Array | Refused:
        arm = self._arm
        if self._overlaps is None:
            self._overlaps = arm.overlaps(rad)
        then = solve(arm, goal, rad, NEXT_STEPS) if len(self._joints) >= FULL_JOINTS else None
        if then is None:
            then = follow(arm, goal, rad)
            pose = arm.pose(then)
            turn = float(np.linalg.norm(turn_between(pose.quat, goal.quat)))
            is_off = len(self._joints) >= FULL_JOINTS and turn > TOLERANCE_RAD
            if is_off or float(np.linalg.norm(pose.xyz - goal.xyz)) > TOLERANCE_M:
                return refusals.cannot_follow(goal.xyz.tolist())
        touch = arm.touch(then, self._overlaps)
        return then if touch is None else refusals.would_touch(touch.link, touch.other)

    def _refuse_keys(self, action: Mapping[str, Any]) -> Refused | None:
        given = [key for key in action if key.startswith(PREFIX)]
        accepted = (*POSE_KEYS, GRIPPER_KEY) if self._gripper is not None else POSE_KEYS
        if unknown := [key for key in given if key not in accepted]:
            return refusals.unknown_pose_key(unknown[0], accepted)
        if both := [key for key in action if key.removesuffix(".pos") in self._joints]:
            return refusals.joint_and_pose(both[0])
        for group in (POSITION_KEYS, TURN_KEYS):
            if 0 < sum(key in action for key in group) < len(group):
                return refusals.part_of_a_pose(group)
        if TURN_KEYS[0] in action and POSITION_KEYS[0] not in action:
            return refusals.part_of_a_pose(POSE_KEYS)
        return None

    def _rad(self, positions: Mapping[str, float]) -> Array:
        return self._units.rad([positions[axis] for axis in self._axes])

    def _named(self, rad: Array) -> dict[str, float]:
        return dict(zip(self._joints, self._units.values(rad), strict=True))


__all__ = ["ToolTargets"]
