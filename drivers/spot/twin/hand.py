"""How the hand of the simulated Spot moves: along poses, looking at places, or with a velocity. Pure: no clock.

A motion has a reference frame. A frame of the world stays where it is when the robot walks, a frame of the body
moves with it. In each step the motion moves its setpoint of the tool, and returns the joints that put the tool
there. The tool is a frame that is fixed to the wrist. A setpoint out of reach leads to the nearest place that the
stretched arm reaches; the arm goes on when the robot has walked closer ("this does not cancel the trajectory",
arm_command.proto).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

from strands_actors.drivers.spot.protocol import Vector, rotated

from .geometry import Pose, between, distance, looking_at, nearer, rotated_by, turned
from .limbs import SHOULDER, wrist_at
from .reach import Joints, Ranges, joints_for, within_reach

LINEAR_M_S, ANGULAR_RAD_S = 1.0, 3.0
"""Fastest motion of the tool for a command without a limit [assumed]."""
AT_GOAL_M, AT_GOAL_RAD = 0.01, 0.03
"""Distance from the goal below which a motion is complete [assumed]."""
UP: Vector = (0.0, 0.0, 1.0)

BodyPose = Callable[[], Pose]
"""Returns the pose of a frame, relative to the place on the floor where the robot started."""


class Limits(NamedTuple):
    """Limits of a motion of the hand."""

    linear_m_s: float = LINEAR_M_S
    angular_rad_s: float = ANGULAR_RAD_S
    error_m: float = float("inf")
    """Largest distance of the tool from its setpoint, before the motion is cancelled."""
    error_rad: float = float("inf")


class Track:
    """Poses in time. A point with a time is reached on a straight way, a point without a time is the goal at once.

    Args:
        begins_s: The time of the command.
        start: The pose at that time.
        points: The times and the poses, in the order of time. At least one.
    """

    def __init__(self, begins_s: float, start: Pose, points: Sequence[tuple[float, Pose]]) -> None:
        self._points = [(begins_s, start), *points]
        self.ends_s, self.last = points[-1]

    def pose_at(self, time_s: float) -> Pose:
        if time_s >= self.ends_s:
            return self.last
        for (before_s, before), (after_s, after) in pairwise(self._points):
            if before_s <= time_s < after_s:
                return between(before, after, (time_s - before_s) / (after_s - before_s))
        return self._points[0][1]


class HandMotion(Protocol):
    """A motion of the hand."""

    def step(self, time_s: float, step_s: float, body: Pose, joints: Sequence[float]) -> Joints | None:
        """Move the setpoint. Return the joints for it; None if the arm stays where it is.

        Args:
            time_s: The present time.
            step_s: Duration of the step.
            body: The pose of the body.
            joints: The present joints.
        """
        ...

    def goal_in_world(self) -> Pose | None:
        """Return the pose at which the tool shall arrive; None if that moves with the body."""
        ...


class _Motion:
    """A motion with a setpoint.

    Args:
        frame: The reference frame.
        is_fixed: True if the reference frame does not move with the body.
        tool: The tool, relative to the wrist.
        ranges: The ranges of the joints.
        limits: The limits of the motion.
    """

    def __init__(self, frame: BodyPose, is_fixed: bool, tool: Pose, ranges: Ranges, limits: Limits) -> None:
        self._frame = frame
        self._is_fixed = is_fixed
        self._tool = tool
        self._ranges = ranges
        self._limits = limits

    def tool_now(self, body: Pose, joints: Sequence[float]) -> Pose:
        """Return the pose of the tool in the reference frame."""
        return self._frame().inverse().compose(body).compose(wrist_at(joints)).compose(self._tool)

    def _joints(self, setpoint: Pose, body: Pose, joints: Sequence[float], exact: bool = False) -> Joints | None:
        wrist = body.inverse().compose(self._frame()).compose(setpoint).compose(self._tool.inverse())
        return joints_for(wrist if exact else within_reach(wrist), joints, self._ranges)


class Follow(_Motion):
    """Move the tool along poses, or let it look at a target.

    Args:
        start: The present pose of the tool in the reference frame.
        track: The poses of the tool in the reference frame.
        targets: The places at which the x axis of the tool points. None: the poses of the track have the rotation.
        targets_in: The frame of these places.
    """

    def __init__(
        self,
        start: Pose,
        track: Track,
        targets: Track | None = None,
        *,
        targets_in: BodyPose | None = None,
        frame: BodyPose,
        is_fixed: bool,
        tool: Pose,
        ranges: Ranges,
        limits: Limits,
    ) -> None:
        super().__init__(frame, is_fixed, tool, ranges, limits)
        self._track = track
        self._targets = targets
        self._targets_in = targets_in or frame
        self._setpoint = start
        self.ends_s = track.ends_s if targets is None else max(track.ends_s, targets.ends_s)
        self.is_cancelled = False
        self.is_stalled = False
        """True if the setpoint has arrived, and the arm cannot follow."""

    def desired(self, time_s: float) -> Pose:
        """Return the pose of the tool that the command wants at a time."""
        pose = self._track.pose_at(time_s)
        if self._targets is None:
            return pose
        target = self._frame().inverse().compose(self._targets_in()).compose(self._targets.pose_at(time_s)).xyz
        rotation = looking_at(pose.xyz, target, rotated(pose.rotation, UP))
        return pose if rotation is None else Pose(pose.xyz, rotation)

    def step(self, time_s: float, step_s: float, body: Pose, joints: Sequence[float]) -> Joints | None:
        if self.is_cancelled:
            return None
        desired, limits = self.desired(time_s), self._limits
        self._setpoint = nearer(self._setpoint, desired, limits.linear_m_s * step_s, limits.angular_rad_s * step_s)
        far, angle = distance(self.tool_now(body, joints), desired)
        if far > limits.error_m or angle > limits.error_rad:
            self.is_cancelled = True
            return None
        goal = self._joints(self._setpoint, body, joints)
        is_at_end = time_s >= self.ends_s and self._setpoint == desired
        rests = goal is None or all(abs(a - b) < _REST_RAD for a, b in zip(goal, joints, strict=False))
        self.is_stalled = is_at_end and rests and not _is_near(far, angle)
        return goal

    def has_arrived(self, time_s: float, body: Pose, joints: Sequence[float]) -> bool:
        return time_s >= self.ends_s and _is_near(*distance(self.tool_now(body, joints), self.desired(time_s)))

    def goal_in_world(self) -> Pose | None:
        return self._frame().compose(self.desired(self.ends_s)) if self._is_fixed else None


class Velocity(_Motion):
    """Move the tool with a velocity until a time. At the edge of its reach the arm stays.

    Args:
        start: The present pose of the tool in the reference frame, which is level and moves with the body.
        velocity: Returns the tool's velocity in the reference frame, from its place there, m/s.
        spin: The tool's angular velocity in its own frame, rad/s.
        ends_s: The time when the motion ends.
    """

    def __init__(
        self,
        start: Pose,
        velocity: Callable[[Vector], Vector],
        spin: Vector,
        ends_s: float,
        *,
        frame: BodyPose,
        tool: Pose,
        ranges: Ranges,
    ) -> None:
        super().__init__(frame, False, tool, ranges, Limits())
        self._setpoint = start
        self._velocity = velocity
        self._spin = spin
        self.ends_s = ends_s

    def step(self, time_s: float, step_s: float, body: Pose, joints: Sequence[float]) -> Joints | None:
        if time_s >= self.ends_s:
            return None
        x, y, z = (
            place + speed * step_s
            for place, speed in zip(self._setpoint.xyz, self._velocity(self._setpoint.xyz), strict=True)
        )
        rotation = self._setpoint.rotation
        for axis, speed in zip(_AXES, self._spin, strict=True):
            rotation = rotated_by(rotation, axis, speed * step_s)
        moved = Pose((x, y, z), rotation)
        goal = self._joints(moved, body, joints, exact=True)
        if goal is not None:
            self._setpoint = moved
        return goal or self._joints(self._setpoint, body, joints)

    def goal_in_world(self) -> Pose | None:
        return None


def around_the_shoulder(radial: float, around: float, up: float) -> Callable[[Vector], Vector]:
    """Return the velocity for cylindrical coordinates, as ``Velocity`` takes it: away from the shoulder, around it,
    and upwards, m/s."""

    def velocity(place: Vector) -> Vector:
        ahead, aside = place[0] - SHOULDER[0], place[1] - SHOULDER[1]
        angle = math.atan2(aside, ahead)
        x, y = turned(angle, radial, around)
        return x, y, up

    return velocity


def _is_near(far_m: float, angle_rad: float) -> bool:
    return far_m <= AT_GOAL_M and angle_rad <= AT_GOAL_RAD


_REST_RAD = 1e-4
_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
