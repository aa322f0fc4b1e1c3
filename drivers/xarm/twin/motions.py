"""Motions that the simulated controller plans by itself. A motion moves the setpoint of the joints.

No clock and no sockets: the controller gives the elapsed time. Motions have a constant speed. Real controllers also
limit acceleration and jerk, and they round the corners between two lines [assumed: that changes no final pose].
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from strands_actors.drivers.common.physics.poses import Matrix, Pose, angle_between, between, rotation_of

from .kinematics import Kinematics
from .limits import Limits

Joints = Sequence[float]

SLOWEST_RAD_S, SLOWEST_MM_S = 0.01, 0.1
TURN_RAD_OF_MM = 1 / 300.0
"""A line without a way turns as far as a line with so many millimetres per rad takes time [assumed]."""

ARRIVED_RAD = 5e-4

_HALVINGS = 6
_LONG_SEARCH = 40
"""Steps of the search for joint positions, if the usual number finds none."""


class ErrorCode(enum.IntEnum):
    """Errors of the controller that this twin causes by itself."""

    NO_SOLUTION = 21
    PAST_LIMIT = 23
    TOO_FAST = 24
    COLLISION = 31
    BOUNDARY = 35


class MotionFault(Exception):
    """A motion that the controller cannot carry out. It stops the arm with an error."""

    def __init__(self, code: ErrorCode) -> None:
        super().__init__(code.name)
        self.code = code


class Motion(Protocol):
    """One motion. ``advance`` raises ``MotionFault``."""

    def advance(self, setpoint: Joints, elapsed_s: float) -> Joints:
        """Return the next setpoint of the joints in rad."""

    def is_done(self, position: Joints) -> bool:
        """Return True if the motion has ended, for an arm at this position."""


class JointMotion:
    """Turn all joints to a goal. All joints arrive at the same time, and the fastest joint has the given speed."""

    def __init__(self, limits: Limits, goal_of: Callable[[Joints], Joints], rad_s: float) -> None:
        """Args:
        limits: The limits of the arm.
        goal_of: Returns the goal, for a motion that begins at these joint positions.
        rad_s: The speed in rad/s.
        """
        self._limits = limits
        self._goal_of = goal_of
        self._rad_s = max(SLOWEST_RAD_S, rad_s)
        self._goal: Joints | None = None

    def advance(self, setpoint: Joints, elapsed_s: float) -> Joints:
        if self._goal is None:
            self._goal = self._goal_of(setpoint)
            if not self._limits.accepts(self._goal):
                raise MotionFault(ErrorCode.PAST_LIMIT)
        ways = [rad - here for rad, here in zip(self._goal, setpoint, strict=True)]
        longest = max(map(abs, ways))
        speed = min(self._rad_s, self._limits.top_rad_s)
        share = min(1.0, speed * elapsed_s / longest) if longest > 0.0 else 1.0
        return [here + way * share for here, way in zip(setpoint, ways, strict=True)]

    def is_done(self, position: Joints) -> bool:
        return self._goal is not None and _are_near(position, self._goal)


Path = Callable[[float], Pose]
"""Returns the pose at a share (0..1) of the way."""


class PathMotion:
    """Move the tool along a path."""

    def __init__(
        self,
        kinematics: Kinematics,
        plan: Callable[[Pose], tuple[Path, float]],
        mm_s: float,
        limits: Limits,
    ) -> None:
        """Args:
        kinematics: The kinematics of the arm.
        plan: Returns the path and its length in mm, for a motion that begins at this pose.
        mm_s: The speed of the tool in mm/s.
        limits: The limits of the arm. Near singular positions the tool becomes slower, as no joint may be too
            fast [assumed: the real controller reports error 24 there, unless it may approximate].
        """
        self._kinematics = kinematics
        self._plan = plan
        self._mm_s = max(SLOWEST_MM_S, mm_s)
        self._limits = limits
        self._path: Path | None = None
        self._length_mm = 0.0
        self._share = 0.0
        self._goal: Joints | None = None

    def advance(self, setpoint: Joints, elapsed_s: float) -> Joints:
        if self._path is None:
            self._path, self._length_mm = self._plan(self._kinematics.pose(setpoint))
        left = 1.0 - self._share
        way_mm = min(self._mm_s, self._limits.top_mm_s) * elapsed_s
        step = min(left, way_mm / self._length_mm) if self._length_mm > 0.0 else left
        most_rad = self._limits.top_rad_s * elapsed_s
        solution, step = self._search(setpoint, step, most_rad)
        if not self._limits.accepts(solution):
            raise MotionFault(ErrorCode.PAST_LIMIT)
        way = solution - setpoint
        longest = float(np.abs(way).max())
        if longest > most_rad:
            # Near a singular position the joints turn first, before the tool goes on.
            slower: Joints = (np.array(setpoint) + way * most_rad / longest).tolist()
            return slower
        self._share += step
        reached: Joints = solution.tolist()
        if self._share >= 1.0 - 1e-9:
            self._goal = reached
        return reached

    def _search(self, setpoint: Joints, step: float, most_rad: float) -> tuple[Matrix, float]:
        """Return joint positions for the next part of the path, and the part's share of it.

        Args:
            setpoint: The present setpoint of the joints.
            step: The largest share.
            most_rad: The way of a joint that is possible now. If no share needs less, the smallest one is returned.
        """
        best: tuple[Matrix, float] | None = None
        for _ in range(_HALVINGS):
            assert self._path is not None
            pose = self._path(self._share + step)
            # Near a singular position a small way of the tool may need a long search.
            solution = self._kinematics.near(pose, setpoint)
            if solution is None:
                solution = self._kinematics.near(pose, setpoint, _LONG_SEARCH)
            if solution is not None:
                best = solution, step
                if np.abs(solution - setpoint).max() <= most_rad:
                    break
            step /= 2
        if best is None:
            raise MotionFault(ErrorCode.NO_SOLUTION)
        return best

    def is_done(self, position: Joints) -> bool:
        return self._goal is not None and _are_near(position, self._goal)


class Pause:
    """Wait in the queue."""

    def __init__(self, seconds: float) -> None:
        self._left_s = max(0.0, seconds)

    def advance(self, setpoint: Joints, elapsed_s: float) -> Joints:
        self._left_s -= elapsed_s
        return setpoint

    def is_done(self, position: Joints) -> bool:
        return self._left_s <= 0.0


class Act:
    """Do something when the motions before it in the queue have ended, such as to switch an output."""

    def __init__(self, act: Callable[[], None]) -> None:
        self._act = act
        self._done = False

    def advance(self, setpoint: Joints, elapsed_s: float) -> Joints:
        self._act()
        self._done = True
        return setpoint

    def is_done(self, position: Joints) -> bool:
        return self._done


# -- the paths


def line(goal_of: Callable[[Pose], Pose]) -> Callable[[Pose], tuple[Path, float]]:
    """Return the plan of a straight line to the pose that ``goal_of`` returns for the line's beginning."""

    def plan(start: Pose) -> tuple[Path, float]:
        goal = goal_of(start)
        length_mm = float(np.linalg.norm(goal.place - start.place))
        return lambda share: between(start, goal, share), max(
            length_mm, angle_between(start, goal) / TURN_RAD_OF_MM
        )

    return plan


def circle(poses_of: Callable[[Pose], tuple[Pose, Pose]], share: float) -> Callable[[Pose], tuple[Path, float]]:
    """Return the plan of a circle through the beginning and the two poses that ``poses_of`` returns for it.

    Args:
        poses_of: Returns the two poses.
        share: How much of the circle, 1 for all of it. The tool keeps its rotation [assumed].
    """

    def plan(start: Pose) -> tuple[Path, float]:
        first, second = poses_of(start)
        a, b = first.place - start.place, second.place - start.place
        normal = np.cross(a, b)
        size = float(normal @ normal)
        if size < 1e-6:
            raise MotionFault(ErrorCode.NO_SOLUTION)
        centre = start.place + (np.cross(normal, a) * (b @ b) + np.cross(b, normal) * (a @ a)) / (2.0 * size)
        axis = normal / math.sqrt(size)
        spoke = start.place - centre
        angle = 2.0 * math.pi * share

        def path(part: float) -> Pose:
            return Pose(centre + rotation_of((axis * angle * part).tolist()) @ spoke, start.rotation)

        return path, angle * float(np.linalg.norm(spoke))

    return plan


def _are_near(position: Joints, goal: Joints) -> bool:
    return max(abs(here - rad) for here, rad in zip(position, goal, strict=True)) < ARRIVED_RAD
