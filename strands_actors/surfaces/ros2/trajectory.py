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

Row = tuple[float, ...]


class Error(enum.IntEnum):
    """The error codes of the action's result."""

    SUCCESSFUL = 0
    INVALID_GOAL = -1
    INVALID_JOINTS = -2
    OLD_HEADER_TIMESTAMP = -3
    PATH_TOLERANCE_VIOLATED = -4
    GOAL_TOLERANCE_VIOLATED = -5


class Problem(NamedTuple):
    """Why a goal is not carried out, or not to its end."""

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
        path_tolerances: How far each joint may be from its path on the way; infinite for any distance.
        speeds: The speed of each joint at each row, for curves between them. Empty for straight lines.
    """

    joints: tuple[Joint, ...]
    times_s: tuple[float, ...]
    rows: tuple[Row, ...]
    tolerances: tuple[float, ...]
    settle_s: float
    path_tolerances: tuple[float, ...] = ()
    speeds: tuple[Row, ...] = ()

    @property
    def duration_s(self) -> float:
        """The time of the last row, in seconds."""
        return self.times_s[-1]

    def positions(self, at_s: float) -> Row:
        """Return the positions at a time. After the end: the last row.

        Between two rows they are on straight lines, or, if the goal gave speeds, on the curves of third degree that
        have these speeds at the rows, as a ros2_control controller computes them.
        """
        after = bisect_right(self.times_s, at_s)
        if after == len(self.times_s):
            return self.rows[-1]
        begin_s, end_s = self.times_s[after - 1], self.times_s[after]
        span_s = end_s - begin_s
        part = (at_s - begin_s) / span_s
        pairs = zip(self.rows[after - 1], self.rows[after], strict=True)
        if not self.speeds:
            return tuple(before + part * (later - before) for before, later in pairs)
        slopes = zip(self.speeds[after - 1], self.speeds[after], strict=True)
        return tuple(
            _curve(part, before, later, span_s * leaving, span_s * arriving)
            for (before, later), (leaving, arriving) in zip(pairs, slopes, strict=True)
        )

    def farthest(self, measured: Mapping[str, float]) -> str:
        """Return the joint that is outside its tolerance, as text; empty if all have reached the last row."""
        return self._outside(measured, self.rows[-1], self.tolerances, "its goal")

    def off_path(self, measured: Mapping[str, float], at_s: float) -> str:
        """Return the joint that was outside its tolerance of the path at a time, as text; empty without one."""
        return self._outside(measured, self.positions(at_s), self.path_tolerances, "its path")

    def _outside(self, measured: Mapping[str, float], row: Row, tolerances: Row, place: str) -> str:
        for joint, position, tolerance in zip(self.joints, row, tolerances, strict=False):
            distance = abs(measured.get(joint.key, math.inf) - position)
            if distance > tolerance:
                return f"{joint.key} is {distance:.3f} from {place}, and {tolerance:.3f} is allowed"
        return ""


def read_trajectory(goal: Mapping[str, Any], layout: Layout, measured: Mapping[str, float]) -> Trajectory | Problem:
    """Return the trajectory of a goal, which begins at the measured positions, or why the goal is refused.

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
        text = "a start time is not supported. Leave the stamp of the header at zero"
        return Problem(Error.OLD_HEADER_TIMESTAMP, text)
    for name in names:
        if name not in joints or names.count(name) > 1:
            why = "is named twice" if name in joints else f"is not one of {', '.join(joints)}"
            return Problem(Error.INVALID_JOINTS, f"the joint {shown(name)} {why}")
        if name not in measured:
            return Problem(Error.INVALID_GOAL, f"the position of {name} is not known")
    for tolerance in (*goal["path_tolerance"], *goal["goal_tolerance"]):
        if problem := _refuse_tolerance(tolerance, names):
            return problem
    times_s, rows, speeds = [0.0], [tuple(measured[name] for name in names)], [(0.0,) * len(names)]
    for number, point in enumerate(points):
        time_s = seconds(point["time_from_start"])
        row, speed = tuple(point["positions"]), tuple(point["velocities"])
        if len(row) != len(names) or not all(map(math.isfinite, row)):
            return Problem(Error.INVALID_GOAL, f"point {number} needs one finite position for each joint")
        if len(speed) not in (0, len(names)) or not all(map(math.isfinite, speed)):
            return Problem(Error.INVALID_GOAL, f"point {number} needs one finite velocity for each joint, or none")
        if number == 0 and time_s == 0.0:
            rows[0], speeds[0] = row, speed  # Planners repeat the start as the first point.
        elif not times_s[-1] < time_s <= LONGEST_S:
            return Problem(Error.INVALID_GOAL, f"the time of point {number} is not later than that before it")
        else:
            times_s.append(time_s)
            rows.append(row)
            speeds.append(speed)
    return Trajectory(
        tuple(joints[name] for name in names),
        tuple(times_s),
        tuple(rows),
        _tolerances(names, goal["goal_tolerance"], TOLERANCE),
        seconds(goal["goal_time_tolerance"]) or SETTLE_S,
        _tolerances(names, goal["path_tolerance"], math.inf),
        tuple(speeds) if all(speeds) else (),
    )


def goal_of_topic(message: Mapping[str, Any]) -> dict[str, Any]:
    """Return a trajectory_msgs/msg/JointTrajectory as a goal without tolerances."""
    return {
        "trajectory": message,
        "multi_dof_trajectory": {"points": []},
        "path_tolerance": [],
        "goal_tolerance": [],
        "goal_time_tolerance": {"sec": 0, "nanosec": 0},
    }


def seconds(duration: Mapping[str, int]) -> float:
    return duration["sec"] + duration["nanosec"] / NS


def _curve(part: float, before: float, later: float, leaving: float, arriving: float) -> float:
    """Return the value at a part (0 to 1) of a curve of third degree with these ends and slopes."""
    square, cube = part * part, part * part * part
    return (
        (2 * cube - 3 * square + 1) * before
        + (cube - 2 * square + part) * leaving
        + (3 * square - 2 * cube) * later
        + (cube - square) * arriving
    )


def _refuse_tolerance(tolerance: Mapping[str, Any], names: Sequence[str]) -> Problem | None:
    """Return why a tolerance cannot be kept. Only positions are compared, since few robots report velocities, and
    none an acceleration."""
    if tolerance["name"] not in names:
        text = f"a tolerance names the joint {shown(tolerance['name'])}, which the goal does not move"
        return Problem(Error.INVALID_JOINTS, text)
    if math.isnan(tolerance["position"]):
        return Problem(Error.INVALID_GOAL, f"the tolerance of {tolerance['name']} is not a number")
    if any(tolerance[field] > 0.0 for field in ("velocity", "acceleration")):
        text = f"tolerances of velocity and acceleration are not supported. Leave those of {tolerance['name']} at 0"
        return Problem(Error.INVALID_GOAL, text)
    return None


def _tolerances(names: Sequence[str], given: Sequence[Mapping[str, Any]], default: float) -> tuple[float, ...]:
    """Return the tolerance of each joint: 0 stands for the default, and a negative one for any distance."""
    positions = {tolerance["name"]: float(tolerance["position"]) for tolerance in given}
    return tuple(
        math.inf if positions.get(name, 0.0) < 0.0 else positions.get(name, 0.0) or default for name in names
    )
