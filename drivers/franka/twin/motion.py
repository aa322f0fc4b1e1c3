"""A running motion, and the limits of the joints in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import JOINTS, Arm

from .path import TICK_S, CartesianPath

SLACK = 1.001
"""Tolerance on the limits, since commands are sums of floats."""

CARTESIAN = (p.Generator.CARTESIAN_POSITION, p.Generator.CARTESIAN_VELOCITY)
JOINT = (p.Generator.JOINT_POSITION, p.Generator.JOINT_VELOCITY)


class Motion(msgspec.Struct):
    """A running motion, begun by a ``move`` request with the number ``id``."""

    id: int
    controller: int
    generator: int
    path: CartesianPath | None = None  # The path of the end effector, in a motion by its poses or velocities.
    command: p.Command | None = None  # The command that was received since the last tick.
    begun: bool = False  # True once the first command of the motion was received.
    missed: int = 0  # Number of consecutive ticks without a command.
    speed: tuple[float, ...] = (0.0,) * JOINTS
    acceleration: tuple[float, ...] = (0.0,) * JOINTS
    leads: bool = True  # False while only torques are commanded, so that there is no path to follow.


class Names(NamedTuple):
    """Names of the errors of one family: position, speed, acceleration and jerk of a joint."""

    position: str
    speed: str
    acceleration: str
    jerk: str
    rounding: tuple[float, float, float]
    """Tolerance on speed, acceleration, and change of the acceleration in a millisecond."""


COMMANDED = Names(
    "joint_motion_generator_position_limits_violation",
    "joint_motion_generator_velocity_limits_violation",
    "joint_motion_generator_velocity_discontinuity",
    "joint_motion_generator_acceleration_discontinuity",
    (1e-4, 0.01, 0.01),
)
AFTER_IK = Names(
    "cartesian_motion_generator_joint_position_limits_violation",
    "cartesian_motion_generator_joint_velocity_limits_violation",
    "cartesian_motion_generator_joint_velocity_discontinuity",
    "cartesian_motion_generator_joint_acceleration_discontinuity",
    (1e-3, 0.5, 1.0),  # The poses of FCI 10 have single precision.
)


def move_joints(motion: Motion, arm: Arm, last: Sequence[float], goal: Sequence[float], names: Names) -> str:
    """Let the joints go from their last positions to the next ones (rad), if no limit is violated.

    Returns:
        The name of the violated limit; empty if ``motion`` has the new speeds and accelerations.
    """
    speed = tuple((goal_rad - last_rad) / TICK_S for goal_rad, last_rad in zip(goal, last, strict=True))
    acceleration = tuple((now - then) / TICK_S for now, then in zip(speed, motion.speed, strict=True))
    before = motion.acceleration
    more_speed, more_acceleration, more_change = names.rounding
    for joint in range(JOINTS):
        slowest, fastest = arm.speed_at(joint, goal[joint])
        if not arm.low[joint] - 1e-6 <= goal[joint] <= arm.high[joint] + 1e-6:
            return names.position
        if not slowest * SLACK - more_speed <= speed[joint] <= fastest * SLACK + more_speed:
            return names.speed
        if abs(acceleration[joint]) > arm.acceleration[joint] * SLACK + more_acceleration:
            return names.acceleration
        if abs(acceleration[joint] - before[joint]) > arm.jerk[joint] * TICK_S * SLACK + more_change:
            return names.jerk
    motion.speed, motion.acceleration = speed, acceleration
    return ""
