"""Read the commands of the API for the simulated Spot: trajectories, frames, limits and postures. Pure: no clock.

Each function returns None for a command that the robot refuses as invalid.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Vector

from .geometry import Pose, pose_of, wrapped
from .paths import Path, Values
from .posture import Offset, saturated
from .stance import FEET
from .walking import SpeedLimits, Twist

ARM_JOINTS = ("sh0", "sh1", "el0", "el1", "wr0", "wr1")
WORLD_FRAMES = ("odom", "vision")
"""Frames that stay where they are. The twin's two are the same."""
TRAJECTORY_FRAMES = (*WORLD_FRAMES, "body")
"""Frames of ``SE2TrajectoryCommand`` (basic_command.proto)."""
VELOCITY_FRAMES = (*WORLD_FRAMES, "flat_body", "body")
"""Frames of ``SE2VelocityCommand``. The file names the first three. The vendor's client sends the last one."""
POSE_FRAMES = VELOCITY_FRAMES
"""Frames of ``BodyControlParams.BodyPose`` [assumed: its comment names the first two as examples]."""


def is_finite(content: object) -> bool:
    """Return True if a message contains no number that is infinite or not a number."""
    match content:
        case float():
            return math.isfinite(content)
        case Mapping():
            return all(is_finite(each) for each in content.values())
        case list():
            return all(is_finite(each) for each in content)
    return True


def times_of(trajectory: Mapping[str, Any], now_ns: int) -> list[float]:
    """Return for each point of a trajectory the time from now, seconds. A point without a time is due now."""
    reference_ns = p.stamp_ns(trajectory["reference_time"]) if "reference_time" in trajectory else now_ns
    return [
        (reference_ns - now_ns + p.stamp_ns(point["time_since_reference"])) / p.NS
        if "time_since_reference" in point
        else 0.0
        for point in trajectory.get("points", ())
    ]


def path_of(start_s: float, start: Values, times: Sequence[float], points: Sequence[Values]) -> Path | None:
    """Return the path through the points of a trajectory; None without a point, or if their times decrease.

    Args:
        start_s: The present time of the mechanism.
        start: The present values.
        times: The time of each point from now, seconds.
        points: The values of each point.
    """
    if not points or not is_sorted(times):
        return None
    return Path(start_s, start, [(start_s + time, point) for time, point in zip(times, points, strict=True)])


def is_sorted(times: Sequence[float]) -> bool:
    return all(before <= after for before, after in pairwise(times))


# -- base


def twist_of(velocity: Mapping[str, Any]) -> Twist:
    """Read a message ``SE2Velocity``."""
    linear = velocity.get("linear", {})
    return float(linear.get("x", 0.0)), float(linear.get("y", 0.0)), float(velocity.get("angular", 0.0))


def slew_of(request: Mapping[str, Any]) -> Twist:
    """Read the limit of acceleration. A part that is zero or negative is no limit [assumed]."""
    x, y, angle = (value if value > 0 else math.inf for value in twist_of(request.get("slew_rate_limit", {})))
    return x, y, angle


def limits_of(params: Mapping[str, Any], table: Mapping[str, Any]) -> SpeedLimits:
    """Return the limits of the speed. A part of ``vel_limit`` that is not set is 0, so it stops that axis ("SE2
    velocity limits require care", release_notes.md)."""
    limits, given = SpeedLimits(table), params.get("vel_limit", {})
    low, high = (twist_of(given[key]) if key in given else None for key in ("min_vel", "max_vel"))
    limits.narrow(low, high)
    return limits


def places_of(trajectory: Mapping[str, Any], frame: Pose, yaw_rad: float) -> list[Values]:
    """Return the points of a message ``SE2Trajectory`` in the frame of odometry.

    Args:
        trajectory: The message.
        frame: The pose of the trajectory's frame in the frame of odometry.
        yaw_rad: The robot's present angle, from which the angles of the points go on without a jump.
    """
    places: list[Values] = []
    for point in trajectory.get("points", ()):
        pose = point.get("pose", {})
        position = pose.get("position", {})
        place = frame.compose(Pose((float(position.get("x", 0.0)), float(position.get("y", 0.0)), 0.0)))
        angle = frame.roll_pitch_yaw[2] + float(pose.get("angle", 0.0))
        yaw_rad += wrapped(angle - yaw_rad)
        places.append((place.xyz[0], place.xyz[1], yaw_rad))
    return places


# -- posture


def offsets_of(trajectory: Mapping[str, Any], frame: Pose) -> list[Offset] | None:
    """Return the points of a message ``SE3Trajectory`` as postures; None if a rotation is invalid.

    Args:
        trajectory: The message.
        frame: The pose of the trajectory's frame relative to the default pose of the body.
    """
    offsets: list[Offset] = []
    for point in trajectory.get("points", ()):
        pose = pose_of(point.get("pose", {}))
        if pose is None:
            return None
        placed = frame.compose(pose)
        offsets.append(saturated((*placed.xyz, *placed.roll_pitch_yaw)))
    return offsets


# -- arm


def arm_points(trajectory: Mapping[str, Any], present: Sequence[float]) -> list[Values]:
    """Return the points of a message ``ArmJointTrajectory``. A joint that a point does not name keeps its angle."""
    points: list[Values] = []
    angles = list(present[: len(ARM_JOINTS)])
    for point in trajectory.get("points", ()):
        named = point.get("position", {})
        angles = [
            float(named[name].get("value", 0.0)) if name in named else angle
            for name, angle in zip(ARM_JOINTS, angles, strict=True)
        ]
        points.append(tuple(angles))
    return points


def together(present: Sequence[float], goal: Sequence[float], fastest: float) -> tuple[float, ...]:
    """Return the speed of each joint with which all arrive at the same time, as the robot moves its arm to a single
    point (``ArmJointTrajectory``, arm_command.proto)."""
    ways = [abs(end - now) for now, end in zip(present, goal, strict=True)]
    longest = max(ways)
    return tuple(fastest * way / longest if longest else fastest for way in ways)


def number(message: Message, key: str) -> float:
    """Return the number in a wrapper message; infinity if it is not set, or not positive."""
    value = float(message[key].get("value", 0.0)) if key in message else 0.0
    return value if value > 0 else math.inf


# -- hand


def vector_of(message: Mapping[str, Any]) -> Vector:
    """Read a message ``Vec3``."""
    x, y, z = (float(message.get(axis, 0.0)) for axis in "xyz")
    return x, y, z


def poses_of(trajectory: Mapping[str, Any]) -> list[Pose] | None:
    """Return the points of a message ``SE3Trajectory`` as poses; None if a rotation is invalid."""
    poses = [pose_of(point.get("pose", {})) for point in trajectory.get("points", ())]
    return None if None in poses else [pose for pose in poses if pose is not None]


# -- feet


def feet_of(stance: Mapping[str, Any]) -> list[tuple[float, float]] | None:
    """Return the places of the four feet of a message ``Stance``, in the order of the legs; None if one is
    missing."""
    named = {entry.get("key", ""): entry.get("value", {}) for entry in stance.get("foot_positions", ())}
    if set(named) != set(FEET):
        return None
    return [(float(named[foot].get("x", 0.0)), float(named[foot].get("y", 0.0))) for foot in FEET]
