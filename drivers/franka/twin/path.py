"""The path of the end effector in one motion by Cartesian poses or velocities, and the limits that it keeps.

The controller differentiates what the client sends from one millisecond to the next, as the vendor's pages say. It
compares the speed, the acceleration and the jerk with the limits of translation, rotation and elbow. A violated
limit ends the motion, and has a name for each of the three.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import Arm

from . import kinematics

TICK_S = 1.0 / p.STATE_HZ
START_M, START_RAD = 1e-3, 1e-3
"""Largest difference between the first command of a motion and the commanded pose at its start [assumed]."""
ORTHONORMAL = 1e-5
"""Largest error in the entries of a rotation's product with its inverse, as in libfranka."""
SLACK = 1.01
"""Tolerance on the limits [assumed]."""


class Limits(NamedTuple):
    """Limits of translation (m), rotation (rad) or elbow (rad), per second, second squared and second cubed."""

    speed: float
    acceleration: float
    jerk: float
    rounding: tuple[float, float, float]
    """Error of the single precision of states in FCI 10: a client repeats numbers that are off by 3e-8."""

    def most(self, index: int) -> float:
        """Return the limit of the speed (0), the acceleration (1) or the jerk (2), with its tolerance."""
        return (self.speed, self.acceleration, self.jerk)[index] * SLACK + self.rounding[index]


_M, _RAD = (1e-4, 0.15, 250.0), (2e-4, 0.3, 500.0)

CARTESIAN_LIMITS: Mapping[int, tuple[Limits, Limits, Limits]] = {
    5: (Limits(1.7, 13.0, 6500.0, _M), Limits(2.5, 25.0, 12500.0, _RAD), Limits(2.175, 10.0, 5000.0, _RAD)),
    10: (Limits(3.0, 9.0, 4500.0, _M), Limits(2.5, 17.0, 8500.0, _RAD), Limits(1.5, 10.0, 5000.0, _RAD)),
}
"""By version of FCI: limits of translation, rotation and elbow, from libfranka's rate_limiting.h."""

INVALID_FRAME = "cartesian_position_motion_generator_invalid_frame"
START_POSE = "cartesian_position_motion_generator_start_pose_invalid"
START_ELBOW = "cartesian_motion_generator_start_elbow_invalid"
ELBOW_SIGN = "cartesian_motion_generator_elbow_sign_inconsistent"
ELBOW_LIMIT = "cartesian_motion_generator_elbow_limit_violation"
SPEED = "cartesian_motion_generator_velocity_limits_violation"
ACCELERATION = "cartesian_motion_generator_velocity_discontinuity"
JERK = "cartesian_motion_generator_acceleration_discontinuity"


def is_transformation(numbers: Sequence[float]) -> bool:
    """Return whether 16 numbers are a pose, column by column: a rotation and a place."""
    pose = kinematics.matrix(numbers)
    rotation = pose[:3, :3]
    skewed = float(np.abs(rotation.T @ rotation - np.eye(3)).max()) > ORTHONORMAL
    return not skewed and float(np.linalg.det(rotation)) > 0.0 and pose[3].tolist() == [0.0, 0.0, 0.0, 1.0]


class CartesianPath:
    """The commanded path of the end effector. Its fields are those of the last millisecond."""

    def __init__(self, arm: Arm, tool: Any, joints: Sequence[float], by_velocity: bool) -> None:
        """Begin at rest.

        Args:
            arm: The arm.
            tool: The pose of the end effector in the flange.
            joints: Joint positions (rad) that the controller commands at present.
            by_velocity: True if the client commands velocities, False for poses.
        """
        self._limits = CARTESIAN_LIMITS[arm.fci]
        self._elbow_range = arm.low[kinematics.ELBOW], arm.high[kinematics.ELBOW]
        self._back_to_flange = np.linalg.inv(tool)
        self._by_velocity = by_velocity
        self.pose = kinematics.pose(joints) @ tool
        self.twist: Any = np.zeros(6)  # m/s, then rad/s
        self.acceleration: Any = np.zeros(6)
        self.elbow = float(joints[kinematics.ELBOW])
        self.sign = math.copysign(1.0, joints[kinematics.ELBOW + 1])
        """Sign of joint 4, which belongs to the elbow's configuration."""
        self.elbow_speed = self.elbow_acceleration = 0.0

    def follow(self, command: p.Command, first: bool) -> str:
        """Go on as a command requests.

        Without an elbow in the command the elbow stays where it is [assumed]. Return the name of the violated
        limit; empty if the command is valid.
        """
        if self._by_velocity:
            twist: Any = np.array(command.twist)
            pose = _moved(self.pose, twist)
        else:
            if not is_transformation(command.pose):
                return INVALID_FRAME
            pose = kinematics.matrix(command.pose)
            turn = kinematics.rotation_vector(pose[:3, :3] @ self.pose[:3, :3].T)
            way = np.concatenate((pose[:3, 3] - self.pose[:3, 3], turn))
            if first and (_length(way[:3]) > START_M or _length(way[3:]) > START_RAD):
                return START_POSE
            twist = way / TICK_S
        elbow, sign = command.elbow or (self.elbow, self.sign)
        if sign != self.sign:
            return ELBOW_SIGN
        if first and abs(elbow - self.elbow) > START_RAD:
            return START_ELBOW
        if not self._elbow_range[0] <= elbow <= self._elbow_range[1]:
            return ELBOW_LIMIT
        acceleration = (twist - self.twist) / TICK_S
        elbow_speed = (elbow - self.elbow) / TICK_S
        elbow_acceleration = (elbow_speed - self.elbow_speed) / TICK_S
        jerk = (acceleration - self.acceleration) / TICK_S
        elbow_jerk = (elbow_acceleration - self.elbow_acceleration) / TICK_S
        parts = (
            (_length(twist[:3]), _length(acceleration[:3]), _length(jerk[:3])),
            (_length(twist[3:]), _length(acceleration[3:]), _length(jerk[3:])),
            (abs(elbow_speed), abs(elbow_acceleration), abs(elbow_jerk)),
        )
        for index, name in enumerate((SPEED, ACCELERATION, JERK)):
            for limits, part in zip(self._limits, parts, strict=True):
                if part[index] > limits.most(index):
                    return name
        self.pose, self.twist, self.acceleration = pose, twist, acceleration
        self.elbow, self.elbow_speed, self.elbow_acceleration = elbow, elbow_speed, elbow_acceleration
        return ""

    def go_on(self) -> None:
        """Go on without a command, at constant acceleration."""
        self.twist = self.twist + self.acceleration * TICK_S
        self.pose = _moved(self.pose, self.twist)
        self.elbow_speed += self.elbow_acceleration * TICK_S
        self.elbow += self.elbow_speed * TICK_S

    def joints(self, near: Sequence[float]) -> tuple[float, ...] | None:
        """Return the joint positions (rad) of the present pose. None if the arm does not reach it from ``near``."""
        return kinematics.solve(self.pose @ self._back_to_flange, self.elbow, near)


def _moved(pose: Any, twist: Any) -> Any:
    """Return a pose a millisecond later."""
    moved = pose.copy()
    moved[:3, 3] += twist[:3] * TICK_S
    moved[:3, :3] = kinematics.rotation_of(twist[3:] * TICK_S) @ pose[:3, :3]
    return moved


def _length(vector: Any) -> float:
    return math.sqrt(float(vector @ vector))
