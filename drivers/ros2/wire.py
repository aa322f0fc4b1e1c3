"""Drive a robot that is a node of a ROS 2 graph. This module runs in the wire process, the only process of this
package that commands the robot."""

from __future__ import annotations

import math
from typing import Any, ClassVar

import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, WireDown
from strands_actors.drivers.common.kit.session_wire import PromptSessionWire
from strands_actors.kernel.clock import Clock

from .config import Ros2Config
from .link import MOST_GOALS, RosLink
from .stop import reports_of, stop_by
from .table import BASE

SILENT_S = 0.8
"""The robot counts as lost after so long without a new report."""
QUIET_S = 0.3
"""No command is written after so long without a new report, since the node would carry it out late."""
GOAL_S = 0.1
"""The shortest duration of a goal. A stream replaces each goal before its end."""


class Ros2Wire(PromptSessionWire[RosLink]):
    interruptible: ClassVar[bool] = True

    def __init__(self, config: Ros2Config, clock: Clock) -> None:
        self._config = config
        self._clock = clock
        self._goal: dict[str, float] = {}  # the last goal; empty if none was sent since arming

    async def open(self) -> dict[str, Any]:
        link = RosLink(self._config, self._clock, "wire")
        try:
            await link.open()
        except BaseException:
            link.close()
            raise
        self.session_or_none = link
        return {"router": self._config.router, "domain": self._config.domain, **link.nodes()}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await self.session.port.receive()

    async def arm(self, permit: Permit) -> Observation:
        """Prepare for commands. The node keeps its motors energised, so only zeros are sent to a base."""
        permit.check()
        if self._config.table.base:
            self.session.zero()
        self._goal = {}
        return await self.read()

    async def read(self) -> Observation:
        link = self.session
        if link.silent_s() > SILENT_S:
            reason = link.missing() or f"no report for {link.silent_s():.1f} s"
            raise WireDown(
                f"read: {reason} ({link.port.malformed} malformed messages). Check the node and the router"
            )
        reports, table = link.reports, self._config.table
        speeds = reports.base_speeds
        odometry_ns, joints_ns = reports.odometry_stamps.new_ns, reports.joint_stamps.new_ns
        sensors: dict[str, tuple[float, ...]] = {}
        if table.base:
            pose = reports.odometry["pose"]["pose"]
            position, turn = pose["position"], pose["orientation"]
            yaw = math.atan2(
                2 * (turn["w"] * turn["z"] + turn["x"] * turn["y"]),
                1 - 2 * (turn["y"] * turn["y"] + turn["z"] * turn["z"]),
            )
            sensors = {
                "odometry_xy_m": (position["x"], position["y"]),
                "odometry_yaw_rad": (yaw,),
                "odometry_linear_m_s": (speeds["linear.x"], speeds["linear.y"]),
                "odometry_angular_rad_s": (speeds["angular.z"],),
            }
        axes = self._config.axes
        return Observation(
            t_ns=max(odometry_ns, joints_ns),
            position=tuple(speeds[key] if key in BASE else reports.positions[key] for key in axes),
            stamp_ns=tuple(odometry_ns if key in BASE else joints_ns for key in axes),
            velocity=() if table.base else tuple(reports.speeds[key] for key in axes),
            sensors=sensors,
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        link, axes = self.session, self._config.axes
        if link.silent_s() > QUIET_S or link.goals_waiting >= MOST_GOALS:
            raise PermitDenied(
                f"the robot receives no commands now (last report {link.silent_s() * 1e3:.0f} ms ago)"
            )
        targets = dict(zip(axes, values, strict=True))
        base = {key: targets[key] for key in axes if key in BASE}
        goal = {key: targets[key] for key in axes if key not in BASE}
        permit.check()
        if base:
            link.drive(base)
        if goal and goal != self._goal:
            # The first target after arming is the measured position, which needs no goal.
            self._goal = goal
            link.follow(goal, self._seconds(goal))

    def _seconds(self, goal: dict[str, float]) -> float:
        """Return how long a goal takes, so that no joint moves faster than its table allows."""
        joints, positions = self._config.table.joints, self.session.reports.positions
        times = (abs(target - positions[key]) / joints[key].speed for key, target in goal.items())
        return max(GOAL_S, *times)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        link = self.session
        self._goal = {}
        return reports_of(await stop_by(link, safe_state), link, self._config)

    def close(self) -> None:
        link, self.session_or_none = self.session_or_none, None
        if link is not None:
            link.close()
