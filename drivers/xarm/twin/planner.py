"""Decode the requests that move the arm. Each becomes a queued motion, a target of servo mode, or a velocity."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.poses import Pose
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import Mode, Register

from .kinematics import Kinematics
from .limits import Limits
from .motions import ErrorCode, JointMotion, Joints, Motion, MotionFault, PathMotion, Pause, circle, line
from .poses import numbers_of, pose_of

_LARGEST = 1e6
"""No number of a valid request is larger: the largest is an acceleration of 50,000 mm/s^2."""

_JOINT_MODES = (Mode.POSITION, Mode.JOINT_ONLINE)
_POSE_MODES = (Mode.POSITION, Mode.POSE_ONLINE)


class Planned(NamedTuple):
    """A motion that the controller plans."""

    modes: tuple[Mode, ...]  # modes in which the controller accepts it
    motion: Motion
    goal_of: Callable[[Joints], Joints]  # for a check without a motion; raises ``MotionFault``
    only_check: bool = False


class Target(NamedTuple):
    """A target of servo mode, which replaces the last one."""

    goal_of: Callable[[Joints], Joints]  # raises ``MotionFault``
    modes: tuple[Mode, ...] = (Mode.SERVO,)


class Velocity(NamedTuple):
    """A velocity, which replaces the last one."""

    modes: tuple[Mode, ...]
    rates_of: Callable[[Joints], Joints]  # joint speeds at these joint positions
    duration_s: float  # infinite for a velocity without end


Order = Planned | Target | Velocity


class Planner:
    """Decode requests for one arm."""

    def __init__(self, kinematics: Kinematics, limits: Limits) -> None:
        self._kinematics = kinematics
        self._limits = limits

    def decode(self, register: int, data: bytes) -> Order:
        """Return what a request asks for. Raise ``MalformedFrame`` if it is invalid."""
        match register:
            case Register.MOVE_JOINT | Register.MOVE_JOINT_ROUNDED:
                return self._joint_goal(data)
            case Register.MOVE_HOME:
                speed, *_ = _finite(data, 3)
                return self._joints(lambda start: (0.0,) * p.JOINTS, speed, _checks(data, 3))
            case Register.PAUSE:
                (seconds,) = _finite(data, 1)
                return Planned((Mode.POSITION,), Pause(seconds), lambda start: start)
            case Register.MOVE_LINE | Register.MOVE_LINE_ROUNDED:
                return self._line(register, data)
            case Register.MOVE_LINE_TOOL:
                numbers = _finite(data, 9)
                return self._path(_in_tool(pose_of(numbers[:6])), numbers[6], _checks(data, 9))
            case Register.MOVE_LINE_AXIS_ANGLE:
                return self._line_axis_angle(data)
            case Register.MOVE_RELATIVE:
                return self._relative(data)
            case Register.MOVE_CIRCLE:
                return self._circle(data)
            case Register.SERVO_JOINT:
                goal = _finite(data, p.JOINTS + 3)[: p.JOINTS]
                return Target(lambda start: self._checked(goal))
            case Register.SERVO_POSE:
                numbers = _finite(data, 9)
                pose = pose_of(numbers[:6])
                return self._pose_target(_in_tool(pose) if numbers[8] == 1.0 else lambda start: pose)
            case Register.SERVO_POSE_AXIS_ANGLE:
                pose = pose_of(_finite(data, 8)[:6], axis_angle=True)
                tool, relative = struct.unpack_from("<iB", _from(data, 32, 5))
                return self._pose_target(_moved(pose, tool == 1, bool(relative)))
            case Register.JOINT_VELOCITY:
                return self._joint_velocity(data)
            case Register.POSE_VELOCITY:
                return self._pose_velocity(data)
        raise MalformedFrame(f"register {register} moves nothing")

    # -- motions of the joints

    def _joints(
        self,
        goal_of: Callable[[Joints], Joints],
        rad_s: float,
        only_check: bool,
        modes: tuple[Mode, ...] = (Mode.POSITION,),
    ) -> Planned:
        motion = JointMotion(self._limits, goal_of, rad_s)
        return Planned(modes, motion, lambda start: self._checked(goal_of(start)), only_check)

    def _joint_goal(self, data: bytes) -> Planned:
        numbers = _numbers(data, p.JOINTS + 3)
        goal = numbers[: p.JOINTS]
        speed = _all_finite(numbers[p.JOINTS :])[0]
        return self._joints(lambda start: _kept(goal, start), speed, _checks(data, p.JOINTS + 3), _JOINT_MODES)

    def _checked(self, goal: Joints) -> Joints:
        if not self._limits.accepts(goal):
            raise MotionFault(ErrorCode.PAST_LIMIT)
        return goal

    # -- motions of the tool

    def _path(
        self,
        goal_of: Callable[[Pose], Pose],
        mm_s: float,
        only_check: bool,
    ) -> Planned:
        motion = PathMotion(self._kinematics, line(goal_of), mm_s, self._limits)
        return Planned(_POSE_MODES, motion, lambda start: self._solved(goal_of, start), only_check)

    def _line(self, register: int, data: bytes) -> Planned:
        """Decode a line. Newer firmware has one request for all kinds of lines, with a radius, and then the frame,
        the kind of rotation and the check."""
        common = register == Register.MOVE_LINE and len(data) >= 43
        floats = 10 if common or register == Register.MOVE_LINE_ROUNDED else 9
        numbers = _numbers(data, floats)
        mm_s = _all_finite(numbers[6:])[0]
        if not common:
            return self._path(_towards(numbers[:6]), mm_s, _checks(data, floats))
        tool, axis_angle, only_check = data[40:43]
        if tool:
            return self._path(
                _in_tool(pose_of(_all_finite(numbers[:6]), axis_angle=bool(axis_angle))), mm_s, only_check > 0
            )
        return self._path(_towards(numbers[:6], bool(axis_angle)), mm_s, only_check > 0)

    def _line_axis_angle(self, data: bytes) -> Planned:
        numbers = _finite(data, 9)
        tool, relative = _from(data, 36, 2)
        only_check = len(data) > 38 and data[38] > 0
        pose = pose_of(numbers[:6], axis_angle=True)
        return self._path(_moved(pose, bool(tool), bool(relative)), numbers[6], only_check)

    def _relative(self, data: bytes) -> Planned:
        numbers = _finite(data, 11)
        joints, axis_angle = _from(data, 44, 2)
        only_check = len(data) > 46 and data[46] > 0
        if joints:
            way = numbers[: p.JOINTS]

            def goal_of(start: Joints) -> Joints:
                return [here + rad for here, rad in zip(start, way, strict=True)]

            return self._joints(goal_of, numbers[7], only_check, _JOINT_MODES)
        if axis_angle:
            return self._path(_moved(pose_of(numbers[:6], axis_angle=True), False, True), numbers[7], only_check)

        def added(start: Pose) -> Pose:
            # Without a rotation vector the six numbers are added one by one.
            return pose_of([here + more for here, more in zip(numbers_of(start), numbers[:6], strict=True)])

        return self._path(added, numbers[7], only_check)

    def _circle(self, data: bytes) -> Planned:
        numbers = _finite(data, 16)
        tool, axis_angle, only_check = data[64:67] if len(data) >= 67 else (0, 0, len(data) > 64 and data[64])
        first, second = (
            pose_of(numbers[first_number : first_number + 6], axis_angle=bool(axis_angle))
            for first_number in (0, 6)
        )

        def poses_of(start: Pose) -> tuple[Pose, Pose]:
            return (start @ first, start @ second) if tool else (first, second)

        motion = PathMotion(self._kinematics, circle(poses_of, numbers[15] / 100.0), numbers[12], self._limits)
        return Planned(
            (Mode.POSITION,),
            motion,
            lambda start: self._solved(lambda pose: poses_of(pose)[1], start),
            bool(only_check),
        )

    def _pose_target(self, goal_of: Callable[[Pose], Pose]) -> Target:
        return Target(lambda start: self._solved(goal_of, start))

    def _solved(self, goal_of: Callable[[Pose], Pose], start: Joints) -> Joints:
        solution = self._kinematics.near(goal_of(self._kinematics.pose(start)), start, steps=60)
        if solution is None:
            raise MotionFault(ErrorCode.NO_SOLUTION)
        return self._checked(solution.tolist())

    # -- velocities

    def _joint_velocity(self, data: bytes) -> Velocity:
        numbers = _finite(data, p.JOINTS)

        def rates_of(here: Joints) -> Joints:
            top = self._limits.top_rad_s
            return [max(-top, min(top, rad_s)) for rad_s in numbers]

        return Velocity((Mode.VELOCITY,), rates_of, _duration_s(data, 4 * p.JOINTS))

    def _pose_velocity(self, data: bytes) -> Velocity:
        numbers = np.array(_finite(data, 6))
        (tool,) = _from(data, 24, 1)

        def rates_of(here: Joints) -> Joints:
            twist = numbers
            if tool:
                turn = self._kinematics.pose(here).rotation
                twist = np.concatenate((turn @ numbers[:3], turn @ numbers[3:]))
            rates: Any = self._kinematics.rates(here, twist)
            fastest = float(np.abs(rates).max())
            slower: Joints = (rates * min(1.0, self._limits.top_rad_s / max(fastest, 1e-9))).tolist()
            return slower

        return Velocity((Mode.POSE_VELOCITY,), rates_of, _duration_s(data, 24))


# -- goals in several frames


def _towards(numbers: Sequence[float], axis_angle: bool = False) -> Callable[[Pose], Pose]:
    """Return the goal of a line in the frame of the base. An infinite number keeps the value at the beginning."""
    return lambda start: pose_of(_kept(numbers, numbers_of(start, axis_angle=axis_angle)), axis_angle=axis_angle)


def _in_tool(pose: Pose) -> Callable[[Pose], Pose]:
    return lambda start: start @ pose


def _moved(pose: Pose, tool: bool, relative: bool) -> Callable[[Pose], Pose]:
    """Return the goal for a pose with a rotation vector, in the frame of the tool, or relative to the beginning."""
    if tool:
        return _in_tool(pose)
    if relative:
        # The rotation is about the axes of the base.
        return lambda start: Pose(start.place + pose.place, pose.rotation @ start.rotation)
    return lambda start: pose


def _kept(goal: Sequence[float], start: Sequence[float]) -> list[float]:
    return [here if math.isinf(each) else each for each, here in zip(goal, start, strict=True)]


# -- numbers of a request


def _numbers(data: bytes, count: int) -> tuple[float, ...]:
    """Return numbers, of which some may be infinite: "keep the present value"."""
    numbers = p.unpack_floats(data, count)
    _all_finite(tuple(number for number in numbers if number != math.inf))
    return numbers


def _all_finite(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if not all(abs(number) <= _LARGEST for number in numbers):
        raise MalformedFrame(f"not finite, or too large: {numbers}")
    return numbers


def _finite(data: bytes, count: int) -> tuple[float, ...]:
    return _all_finite(p.unpack_floats(data, count))


def _from(data: bytes, offset: int, size: int) -> bytes:
    if len(data) < offset + size:
        raise MalformedFrame(f"{len(data)} bytes, {offset + size} expected")
    return data[offset : offset + size]


def _checks(data: bytes, floats: int) -> bool:
    """Return True if the request only asks whether the motion is possible."""
    return len(data) > 4 * floats and data[4 * floats] > 0


def _duration_s(data: bytes, size: int) -> float:
    """Return the duration of a velocity, which follows ``size`` bytes and one more. Without a duration, and with 0
    or less, the velocity does not end."""
    if len(data) < size + 5:
        return math.inf
    (duration_s,) = _all_finite(p.unpack_floats(data, 1, size + 1))
    return duration_s if duration_s > 0.0 else math.inf
