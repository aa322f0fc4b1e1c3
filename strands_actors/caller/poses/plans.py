"""Plan the joint positions along which the tool of an arm moves to a pose, or say why it cannot. Pure.

A straight line becomes waypoints. The search for each starts at the one before, so that the arm does not change its
posture on the way. A plan has no duration yet (``timing``).
"""

from __future__ import annotations

import enum
import math
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from strands_actors.kernel.messages import Refused

from . import refusals
from .arm import Arm, Array, Pose, Touch, between, composed, turn_between
from .curve import along
from .request import PoseRequest, rpy_of
from .search import NEXT_STEPS, find, follow, nearest, solve

WAYPOINT_M = 0.01
WAYPOINT_RAD = math.radians(4)
"""Largest distance and turn between two waypoints of a line."""
JOINT_RAD = math.radians(3)
"""Largest joint motion between two positions that are checked for contacts."""
BENT_M, REFINEMENTS = 5e-4, 4
"""Between two waypoints the tool stays so near to the line. Otherwise their number is doubled, so many times."""
LEAP_RAD = 0.35
"""A joint that turns farther between two waypoints of a line is at a singularity."""
TOLERANCE_M, TOLERANCE_RAD = 5e-4, math.radians(0.25)
"""A planned pose may differ from the requested one by this much."""
FULL_JOINTS = 6
"""An arm with fewer joints cannot keep an orientation while its tool moves."""
M_PER_RAD = 0.2
"""A turn of the tool by one rad takes as long as this distance."""


class PosePlan(NamedTuple):
    """A planned motion of the tool.

    Attributes:
        joints: Keys of the joints.
        waypoints: Joint positions in rad, the first is the present one, evenly spaced along the motion.
        length_m: Length of the tool's path. A turn counts as ``M_PER_RAD`` per rad, if that is longer.
        goal: The planned pose at the end.
    """

    joints: tuple[str, ...]
    waypoints: Array
    length_m: float
    goal: Pose


class _Turn(enum.Enum):
    """How exactly the orientation of a goal can be, and has to be, reached."""

    EXACT = enum.auto()  # the arm has six joints or more
    NEAR = enum.auto()  # it has fewer, and the orientation was given
    FREE = enum.auto()  # it has fewer, and the orientation was left out


class _Start(NamedTuple):
    rad: Array
    pose: Pose
    overlaps: frozenset[tuple[int, int]]


def plan_pose(arm: Arm, request: PoseRequest, rad: Array) -> PosePlan | Refused:
    """Plan the motion of the tool to the requested pose.

    Args:
        arm: The arm.
        request: The requested pose.
        rad: The measured joint positions.

    Returns:
        The plan, or a refusal with the nearest pose that can be reached, or with what to do.
    """
    start = _Start(np.array(rad, dtype=float), arm.pose(rad), arm.overlaps(rad))
    touch = arm.touch(start.rad, start.overlaps)
    if touch is not None and touch.box is not None:
        return refusals.inside_keep_out(touch.link, touch.box)
    goal = goal_of(start.pose, request)
    freedom = _freedom(arm, request)
    return _line(arm, goal, start, freedom) if request.linear else _direct(arm, goal, start, freedom)


def goal_of(here: Pose, request: PoseRequest) -> Pose:
    """Return the requested pose in the frame of the base."""
    if request.frame == "tool":
        xyz = np.array(request.xyz or (0.0, 0.0, 0.0))
        return composed(here, Pose(xyz, np.array(request.quat or (1.0, 0.0, 0.0, 0.0))))
    xyz = here.xyz if request.xyz is None else np.array(request.xyz)
    return Pose(xyz, here.quat if request.quat is None else np.array(request.quat))


def _freedom(arm: Arm, request: PoseRequest) -> _Turn:
    if len(arm.names) >= FULL_JOINTS:
        return _Turn.EXACT
    return _Turn.FREE if request.quat is None else _Turn.NEAR


def _line(arm: Arm, goal: Pose, start: _Start, freedom: _Turn) -> PosePlan | Refused:
    """Plan a straight line. If the curve through its waypoints bends, there are too few of them."""
    distance = float(np.linalg.norm(goal.xyz - start.pose.xyz))
    turn = float(np.linalg.norm(turn_between(start.pose.quat, goal.quat)))
    count = max(1, math.ceil(max(distance / WAYPOINT_M, turn / WAYPOINT_RAD)))
    bends_at = 0.0
    for _ in range(REFINEMENTS):
        waypoints = _waypoints(arm, goal, start, freedom, count, distance)
        if isinstance(waypoints, Refused):
            return waypoints
        bent = _bent(arm, start.pose, goal, waypoints)
        if bent is None:
            return _plan(arm, waypoints, distance)
        bends_at = distance * bent
        count *= 2
    return refusals.at_singularity(bends_at)


def _waypoints(
    arm: Arm, goal: Pose, start: _Start, freedom: _Turn, count: int, distance: float
) -> list[Array] | Refused:
    rad, waypoints = start.rad, [start.rad]
    for number in range(1, count + 1):
        then = _step(arm, between(start.pose, goal, number / count), rad, freedom)
        if then is None or float(np.abs(then - rad).max()) > LEAP_RAD:
            leap = then is not None
            return _refuse_line(arm, goal, start, freedom, distance * (number - 1) / count, leap)
        for position in _between(rad, then)[1:]:
            if touch := arm.touch(position, start.overlaps):
                return _refuse_touch(touch, distance * number / count, linear=True)
        rad = then
        waypoints.append(rad)
    if freedom is _Turn.NEAR and _misses(arm, goal, rad):
        return _refuse_line(arm, goal, start, freedom, distance, leap=False)
    return waypoints


def _bent(arm: Arm, start: Pose, goal: Pose, waypoints: list[Array]) -> float | None:
    """Return the share of the way where the tool leaves the line between two waypoints; None if it does not."""
    rows, last = np.array(waypoints), len(waypoints) - 1
    for number in range(last):
        share = (number + 0.5) / last
        on_line = start.xyz + (goal.xyz - start.xyz) * share
        if float(np.linalg.norm(arm.pose(along(rows, share)).xyz - on_line)) > BENT_M:
            return share
    return None


def _step(arm: Arm, goal: Pose, rad: Array, freedom: _Turn) -> Array | None:
    """Return the joint positions of the next waypoint, or None."""
    if freedom is _Turn.EXACT:
        then = solve(arm, goal, rad, NEXT_STEPS)
        if then is not None:
            return then
    then = follow(arm, goal, rad)
    if freedom is _Turn.EXACT:
        return None if _misses(arm, goal, then) else then
    return then if float(np.linalg.norm(arm.pose(then).xyz - goal.xyz)) < TOLERANCE_M else None


def _misses(arm: Arm, goal: Pose, rad: Array) -> bool:
    """Return True if the pose at these joint positions is not within the tolerance of the goal."""
    pose = arm.pose(rad)
    turn = float(np.linalg.norm(turn_between(pose.quat, goal.quat)))
    return float(np.linalg.norm(pose.xyz - goal.xyz)) > TOLERANCE_M or turn > TOLERANCE_RAD


def _direct(arm: Arm, goal: Pose, start: _Start, freedom: _Turn) -> PosePlan | Refused:
    end = _end_position(arm, goal, start, freedom)
    if isinstance(end, Refused):
        return end
    waypoints = _between(start.rad, end)
    places = [arm.pose(rad).xyz for rad in waypoints]
    return _plan(arm, waypoints, sum(float(np.linalg.norm(then - here)) for here, then in pairwise(places)))


def _between(start: Array, end: Array) -> list[Array]:
    count = max(1, math.ceil(float(np.abs(end - start).max()) / JOINT_RAD))
    return [start + (end - start) * number / count for number in range(count + 1)]


def _refuse_between(arm: Arm, start: _Start, end: Array) -> Refused | None:
    """Return the refusal of a contact at the end, or on the way if each joint moves straight to it."""
    *way, last = _between(start.rad, end)[1:]
    if touch := arm.touch(last, start.overlaps):
        return _refuse_touch(touch, None, linear=False)
    for number, rad in enumerate(way, 1):
        if touch := arm.touch(rad, start.overlaps):
            return _refuse_touch(touch, number / (len(way) + 1), linear=False)
    return None


def _end_position(arm: Arm, goal: Pose, start: _Start, freedom: _Turn) -> Array | Refused:
    """Return joint positions for the goal, or a refusal that has the nearest pose."""
    if freedom is not _Turn.FREE:
        solution = find(arm, goal, start.rad, lambda rad: _refuse_between(arm, start, rad))
        if solution is not None:
            return solution
    rad = nearest(arm, goal, start.rad, any_turn=freedom is _Turn.FREE)
    reached = float(np.linalg.norm(arm.pose(rad).xyz - goal.xyz)) < TOLERANCE_M
    if not reached or (freedom is not _Turn.FREE and _misses(arm, goal, rad)):
        return _refuse_unreachable(arm, goal, rad)
    refusal = _refuse_between(arm, start, rad)
    return rad if refusal is None else refusal


def _plan(arm: Arm, waypoints: list[Array], length_m: float) -> PosePlan:
    first, goal = arm.pose(waypoints[0]), arm.pose(waypoints[-1])
    turn = float(np.linalg.norm(turn_between(first.quat, goal.quat)))
    return PosePlan(arm.names, np.array(waypoints), max(length_m, turn * M_PER_RAD), goal)


def _refuse_line(arm: Arm, goal: Pose, start: _Start, freedom: _Turn, along_m: float, leap: bool) -> Refused:
    """Return why a line cannot be followed: its end cannot be reached, or only the way to it."""
    end = _end_position(arm, goal, start, freedom)
    if isinstance(end, Refused):
        return end
    return refusals.at_singularity(along_m) if leap else refusals.leaves_reach(along_m)


def _refuse_unreachable(arm: Arm, goal: Pose, rad: Array) -> Refused:
    pose = arm.pose(rad)
    away_m = float(np.linalg.norm(pose.xyz - goal.xyz))
    if away_m > TOLERANCE_M:
        return refusals.out_of_reach(pose.xyz.tolist(), rpy_of(pose.quat.tolist()), away_m)
    turned = math.degrees(float(np.linalg.norm(turn_between(pose.quat, goal.quat))))
    return refusals.no_such_orientation(rpy_of(pose.quat.tolist()), turned, len(arm.names))


def _refuse_touch(touch: Touch, share: float | None, linear: bool) -> Refused:
    if touch.box is None:
        return refusals.touches_itself(touch.link, touch.other, share, linear)
    return refusals.enters_keep_out(touch.link, touch.box, share, linear)


__all__ = ["PosePlan", "goal_of", "plan_pose"]
