"""Plan motions of the arm from rest to rest: the joint positions over time. Pure.

Each leg accelerates, moves at a constant speed, and brakes. The real base also limits the jerk, and rounds the
corners between waypoints [assumed: that changes no pose at which the arm stops].
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.kinova.protocol import SubError

from .errors import CallFailed
from .kinematics import Kinematics, Matrix, Pose, between, turn_between

Row = Sequence[float]

STEP_M, STEP_RAD = 0.01, 0.05
"""Distance of the poses of a line for which joint positions are searched."""

ROUNDING = 1e-3


class Speeds(NamedTuple):
    """The speeds and accelerations of planned motions. The vendor's ROS packages give them as the base's own limits
    of planned joint motions. Those of the tool are [assumed]."""

    rad_s: Row
    rad_s2: Row
    m_s: float = 0.25
    tool_rad_s: float = math.radians(50.0)


def speeds_of(table: Mapping[str, Any]) -> Speeds:
    """Return the speeds of planned motions of the robot's table in ``robots.toml``."""
    planned = table["planned"]
    return Speeds(
        [float(planned["speed_rad_s"])] * len(table["joints"]), [float(value) for value in planned["rad_s2"]]
    )


class Leg:
    """A motion through joint positions, from rest to rest."""

    def __init__(
        self,
        shares: Row,
        knots: Sequence[Row],
        speeds: Speeds,
        most_per_s: float = math.inf,
        duration_s: float = 0.0,
    ) -> None:
        """Args:
            shares: The share (0..1) of the way at each knot, rising.
            knots: The joint positions at each knot, in rad.
            speeds: The limits of the joints.
            most_per_s: Highest share of the way in one second.
            duration_s: The duration; 0 for the shortest one.

        Raises:
            CallFailed: The duration is too short.
        """
        self._shares, self._knots = np.array(shares), np.array(knots)
        slopes = np.abs(np.diff(self._knots, axis=0)) / np.diff(self._shares)[:, None]
        steepest = np.maximum(slopes.max(axis=0), 1e-9)
        self._speed = min(most_per_s, float((np.array(speeds.rad_s) / steepest).min()))
        self._acceleration = float((np.array(speeds.rad_s2) / steepest).min())
        self._ramp_s = self._speed / self._acceleration
        if self._ramp_s * self._speed > 1.0:
            # The way is too short for the full speed.
            self._ramp_s = 1.0 / math.sqrt(self._acceleration)
            self._speed = self._acceleration * self._ramp_s
        self._shortest_s = 1.0 / self._speed + self._ramp_s
        if 0.0 < duration_s < self._shortest_s * (1.0 - ROUNDING):
            raise CallFailed(
                SubError.INVALID_DURATION,
                f"the motion takes at least {self._shortest_s:.2f} s, not {duration_s:.2f} s",
            )
        self.duration_s = max(duration_s, self._shortest_s)

    @property
    def end(self) -> list[float]:
        last: list[float] = self._knots[-1].tolist()
        return last

    def position(self, time_s: float) -> list[float]:
        """Return the joint positions in rad, at a time after the start."""
        share = self._share(min(time_s / self.duration_s, 1.0) * self._shortest_s)
        index = max(0, min(len(self._shares) - 2, int(np.searchsorted(self._shares, share)) - 1))
        first, last = self._shares[index], self._shares[index + 1]
        start, way = self._knots[index], self._knots[index + 1] - self._knots[index]
        here: Matrix = start + way * (share - first) / (last - first)
        position: list[float] = here.tolist()
        return position

    def _share(self, time_s: float) -> float:
        remaining_s = self._shortest_s - time_s
        if time_s < self._ramp_s:
            return 0.5 * self._acceleration * time_s**2
        if remaining_s < self._ramp_s:
            return 1.0 - 0.5 * self._acceleration * max(0.0, remaining_s) ** 2
        return self._speed * (time_s - 0.5 * self._ramp_s)


class Planner:
    """Plan the legs of one arm."""

    def __init__(self, kinematics: Kinematics, table: Mapping[str, Any]) -> None:
        self._kinematics = kinematics
        self.speeds = speeds_of(table)
        self.hard_rad_s = [float(joint["speed_rad_s"]) for joint in table["joints"]]
        self._ranges = [joint.get("range_rad") for joint in table["joints"]]

    def goal(self, start: Row, degrees: Row) -> list[float]:
        """Return the joint positions for angles of the wire, in rad. A joint without limits turns the short way.

        Raises:
            CallFailed: The number of angles is wrong, or an angle is out of its joint's range.
        """
        if len(degrees) != len(self._ranges):
            raise CallFailed(SubError.ACTUATOR_COUNT_MISMATCH, f"{len(degrees)} angles, not {len(self._ranges)}")
        goal = []
        for joint, (here, angle, ends) in enumerate(zip(start, degrees, self._ranges, strict=True)):
            near = here if ends is None else 0.0
            rad = near + math.remainder(math.radians(angle) - near, math.tau)
            if ends is not None and not ends[0] - ROUNDING <= rad <= ends[1] + ROUNDING:
                raise CallFailed(
                    SubError.JOINT_POSITION_LIMIT, f"joint {joint + 1}: {math.degrees(rad):.1f} degrees"
                )
            goal.append(rad)
        return goal

    def joints(self, start: Row, degrees: Row, duration_s: float = 0.0, rad_s: float = 0.0) -> Leg:
        """Plan a motion of the joints, which all arrive at the same time.

        Args:
            start: The joint positions at its start, in rad.
            degrees: The angles at its end.
            duration_s: Its duration; 0 for the shortest one.
            rad_s: The speed of the fastest joint; 0 for the base's own one.

        Raises:
            CallFailed: The arm cannot do it.
        """
        goal = self.goal(start, degrees)
        speeds = self.speeds
        if rad_s:
            if not 0.0 < rad_s <= max(self.hard_rad_s):
                reason = SubError.INVALID_SPEED if rad_s < 0.0 else SubError.LARGE_SPEED
                raise CallFailed(reason, f"a speed of {math.degrees(rad_s):.1f} degrees/s")
            speeds = speeds._replace(rad_s=[min(rad_s, most) for most in self.hard_rad_s])
        elif duration_s:
            speeds = speeds._replace(rad_s=self.hard_rad_s)
        return Leg((0.0, 1.0), (start, goal), speeds, duration_s=duration_s)

    def line(self, start: Row, pose: Pose, m_s: float = 0.0, tool_rad_s: float = 0.0) -> Leg:
        """Plan a line of the tool to a pose.

        Args:
            start: The joint positions at its start, in rad.
            pose: The pose of the tool at its end.
            m_s: Speed of the tool; 0 for the base's own one.
            tool_rad_s: Speed of the tool's rotation; 0 for the base's own one.

        Raises:
            CallFailed: The arm cannot do it.
        """
        if m_s < 0.0 or tool_rad_s < 0.0:
            raise CallFailed(SubError.INVALID_SPEED, "a speed is negative")
        begin = self._kinematics.pose(start)
        way_m = float(np.linalg.norm(pose.m - begin.m))
        turn_rad = float(np.linalg.norm(turn_between(begin, pose)))
        count = max(1, math.ceil(max(way_m / STEP_M, turn_rad / STEP_RAD)))
        shares, knots = [0.0], [list(start)]
        for step in range(1, count + 1):
            joints = self._kinematics.near(between(begin, pose, step / count), knots[-1], steps=30)
            if joints is None:
                raise CallFailed(SubError.OUTSIDE_WORKSPACE, f"no way to {[round(m, 3) for m in pose.m.tolist()]}")
            shares.append(step / count)
            knots.append(joints.tolist())
        most_per_s = min(
            (m_s or self.speeds.m_s) / max(way_m, 1e-9),
            (tool_rad_s or self.speeds.tool_rad_s) / max(turn_rad, 1e-9),
        )
        return Leg(shares, knots, self.speeds._replace(rad_s=self.hard_rad_s), most_per_s)
