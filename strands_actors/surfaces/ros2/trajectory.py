"""Read a goal of control_msgs/action/FollowJointTrajectory, and compute its positions. Pure."""

from __future__ import annotations

import enum
import math
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.shown import shown
from strands_actors.kernel.clock import NS

from .joints import Joint, Layout

LONGEST_S = 3600.0
TOLERANCE = 0.05
"""How far a joint may be from its goal at the end, in radians or metres, if the goal does not state it."""
SETTLE_S = 2.0
"""How long after the end the joints may take to reach the goal, if the goal does not state it."""


class Error(enum.IntEnum):
    """The error codes of the action's result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    GOAL_TOLERANCE_VIOLATED = -5


class Problem(NamedTuple):
    """Why a goal is rejected or aborted."""

    error: Error
    text: str


class Trajectory(NamedTuple):
    """Positions of some joints over time.

    Attributes:
        joints: The joints.
        times_s: The time of each row from the start, in seconds, strictly increasing. The first one is 0.
        rows: The positions of the joints at these times, in radians or metres.
        tolerances: How far each joint may be from the last row at the end; infinite for any distance.
        settle_s: How long the joints may take after the last row, in seconds.
    """

    joints: tuple[Joint, ...]
    times_s: tuple[float, ...]
    rows: tuple[tuple[float, ...], ...]
    tolerances: tuple[float, ...]
    settle_s: float

    @property
    def duration_s(self) -> float:
        """The time of the last row, in seconds."""
        return self.times_s[-1]

    def positions(self, at_s: float) -> tuple[float, ...]:
        """Return the positions at a time, on straight lines between the rows. After the end: the last row."""
        after = bisect_right(self.times_s, at_s)
        if after == len(self.times_s):
            return self.rows[-1]
        begin_s, end_s = self.times_s[after - 1], self.times_s[after]
        part = (at_s - begin_s) / (end_s - begin_s)
        pairs = zip(self.rows[after - 1], self.rows[after], strict=True)
        return tuple(before + part * (later - before) for before, later in pairs)

    def farthest(self, measured: Mapping[str, float]) -> str:
        """Return the joint that is outside its tolerance, as text; empty if all have reached the last row."""
        for joint, goal, tolerance in zip(self.joints, self.rows[-1], self.tolerances, strict=True):
            distance = abs(measured.get(joint.key, math.inf) - goal)
            if distance > tolerance:
                return f"{joint.key} is {distance:.3f} from its goal, and {tolerance:.3f} is allowed"
        return ""


def read_trajectory(goal: Mapping[str, Any], layout: Layout, measured: Mapping[str, float]) -> Trajectory | Problem:
    """Return the trajectory of a goal, which begins at the measured positions, or why the goal is rejected.

    Args:
        goal: The goal.
        layout: The joints of the robot.
        measured: The measured position of each joint, in radians or metres.
    """
    trajectory = goal["trajectory"]
    names, points = trajectory["joint_names"], trajectory["points"]
    joints = {joint.key: joint for joint in layout.joints if joint.key in layout.commanded}
    if not names or not points:
        return Problem(Error.INVALID_GOAL, "the goal has no joint names or no points")
    if goal["multi_dof_trajectory"]["points"]:
        return Problem(Error.INVALID_GOAL, "the robot has no joints with several degrees of freedom")
    if any(trajectory["header"]["stamp"].values()):
        return Problem(Error.INVALID_GOAL, "a start time is not supported. Leave the stamp of the header at zero")
    for name in names:
        if name not in joints or names.count(name) > 1:
            why = "is named twice" if name in joints else f"is not one of {', '.join(joints)}"
            return Problem(Error.INVALID_JOINTS, f"the joint {shown(name)} {why}")
        if name not in measured:
            return Problem(Error.INVALID_GOAL, f"the position of {name} is not known")
    times_s, rows = [0.0], [tuple(measured[name] for name in names)]
    for number, point in enumerate(points):
        time_s = seconds(point["time_from_start"])
        row = tuple(point["positions"])
        if len(row) != len(names) or not all(map(math.isfinite, row)):
            return Problem(Error.INVALID_GOAL, f"point {number} needs one finite position for each joint")
        if number == 0 and time_s == 0.0:
            rows[0] = row  # Planners repeat the start as the first point.
        elif not times_s[-1] < time_s <= LONGEST_S:
            return Problem(Error.INVALID_GOAL, f"the time of point {number} is not later than that before it")
        else:
            times_s.append(time_s)
            rows.append(row)
    tolerances = _tolerances(names, goal["goal_tolerance"])
    settle_s = seconds(goal["goal_time_tolerance"]) or SETTLE_S
    return Trajectory(tuple(joints[name] for name in names), tuple(times_s), tuple(rows), tolerances, settle_s)


def seconds(duration: Mapping[str, int]) -> float:
    return duration["sec"] + duration["nanosec"] / NS


def _tolerances(names: Sequence[str], given: Sequence[Mapping[str, Any]]) -> tuple[float, ...]:
    """Return the tolerance of each joint: 0 stands for the default, and a negative one for any distance."""
    positions = {tolerance["name"]: float(tolerance["position"]) for tolerance in given}
    return tuple(
        math.inf if positions.get(name, 0.0) < 0.0 else positions.get(name, 0.0) or TOLERANCE for name in names
    )
