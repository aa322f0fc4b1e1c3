"""Drive an M3 Pro. This module runs in the wire process, the only process that commands the robot.

Commands, odometry and stops share one connection, which keeps their order. The zero twist of
a stop therefore follows every command that still waits in a frozen bridge. Only a few commands can
wait there.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from typing import Any, ClassVar

import trio

from strands_actors.contract.loading import load
from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, Permit, PermitDenied, Wire, WireDown
from strands_actors.drivers.common.kit.outcome import Outcome
from strands_actors.drivers.common.kit.reporting_base import stop_by_each, stop_until_it_stands
from strands_actors.kernel.clock import NS, Clock

from .config import LINKS, YahboomConfig
from .gates import ARM_AT, ARM_MS, DRIVES
from .links import RosLink
from .messages import SCANS, ArmGoal, Twist
from .robots import BASE
from .stop import STOP_S, StopLink, reports_of, stop_link

SILENT_S = 0.6
"""The link counts as lost after so long without odometry."""

QUIET_S = 0.2
"""No command is written after so long without odometry, since the robot would carry it out late."""

NAN = math.nan


class YahboomWire(Wire):
    interruptible: ClassVar[bool] = True

    def __init__(
        self,
        config: YahboomConfig,
        clock: Clock,
        link: RosLink | None = None,
        anew: StopLink | None = None,
    ) -> None:
        self._config = config
        self._clock = clock
        self._link = link or link_of(config, clock)
        # The second connection, for a stop when the first is lost.
        self._anew: StopLink | None = anew
        self._arm_rad: tuple[float, ...] = ()  # last commanded goal of the arm; empty if unknown
        # Time of the action with the arm's last goal. It identifies the action, so that its goal is sent only
        # once.
        self._arm_at_s = 0.0
        # When the arm's last commanded motion ends.
        self._arm_until_ns = 0

    async def open(self) -> dict[str, Any]:
        facts = await self._link.open()
        joints = (
            "reported"
            if self._link.news.joints_ns
            else "not reported: the first action of the arm must name all joints"
        )
        return {**facts, "transport": self._config.transport, "joints": joints}

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await self._link.receive_messages()

    async def arm(self, permit: Permit) -> Observation:
        """Prepare the robot for commands. Send a zero twist, and forget the arm's last goal, because a person may
        have moved the arm since the last stop."""
        permit.check()
        self._link.zero()
        self._arm_rad, self._arm_at_s = (), 0.0
        return await self.read()

    @property
    def prompt(self) -> bool:
        return True

    async def read(self) -> Observation:
        news, now_ns = self._link.news, self._clock.now_ns()
        odometry = news.odometry
        silent_s = (now_ns - news.odometry_stamps.new_ns) / NS
        if odometry is None or silent_s > SILENT_S:
            raise WireDown(
                f"read: {news.describe_silence(now_ns)} ({news.malformed} malformed messages). "
                "Check the base and rosbridge"
            )
        joints = news.joints if now_ns - news.joints_ns <= SILENT_S * NS else {}
        # Apply the sign that commands use (``joint_signs``). Otherwise a joint that an action does not name would
        # jump to its mirror image.
        arm = tuple(servo.turned(joints.get(servo.key, NAN)) for servo in self._config.servos)
        stamps = tuple(0 if math.isnan(value) else news.joints_ns for value in arm)
        return Observation(
            t_ns=news.odometry_stamps.new_ns,
            position=(*odometry.speed, *arm),
            stamp_ns=((news.odometry_stamps.new_ns,) * len(BASE)) + stamps,
            sensors=self._sensors(),
        )

    async def write(self, values: tuple[float, ...], permit: Permit) -> None:
        axes = len(self._config.axes)
        arm_rad, arm_at_s = values[len(BASE) : axes], values[ARM_AT]
        silent_s = (self._clock.now_ns() - self._link.news.odometry_stamps.new_ns) / NS
        if silent_s > QUIET_S or self._link.is_behind:
            raise PermitDenied(f"the robot receives no commands now (last odometry {silent_s * 1e3:.0f} ms ago)")
        permit.check()
        if values[DRIVES]:
            self._link.drive(Twist(*values[: len(BASE)]))
        # Send a goal only once. A repetition would start the motion again.
        if values[ARM_MS] and arm_at_s != self._arm_at_s:
            self._link.move_arm(self._goal(arm_rad, values[ARM_MS]))
            self._arm_rad, self._arm_at_s = arm_rad, arm_at_s
            self._arm_until_ns = self._clock.now_ns() + round(values[ARM_MS] * 1e6)

    async def make_safe(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        return self._reports(await stop_until_it_stands(self._link, STOP_S))

    async def reach(self, safe_state: SafeState) -> tuple[MotorReport, ...]:
        """Stop the robot after its link was lost, on the old connection and a new one at the same
        time. The old one may be dead or unreadable, but a zero twist is written on it all the same.

        If only the new connection confirms the stop, commands may still wait on the old one. So the
        old one is reset, which drops them. Some of them may already be on their way, so the robot
        is then stopped once more.
        """
        # Ignore a connection that is closed.
        with contextlib.suppress(WireDown):
            self._link.zero()
        self._anew = self._anew or stop_link(self._config, self._clock)
        links = [self._link, self._anew] if self._link.is_open else [self._anew]
        outcome = await stop_by_each(links, STOP_S)
        if not outcome.detail and self._link.has_unacknowledged:
            self._link.close()
            outcome = await stop_until_it_stands(self._anew, STOP_S)
        return self._reports(outcome)

    def close(self) -> None:
        for link in (self._link, self._anew):
            if link is not None:
                link.close()

    def _goal(self, arm_rad: Sequence[float], time_ms: float) -> ArmGoal:
        degrees = tuple(servo.whole_degrees(rad) for servo, rad in zip(self._config.servos, arm_rad, strict=True))
        return ArmGoal(degrees, round(time_ms))

    def _reports(self, outcome: Outcome) -> tuple[MotorReport, ...]:
        left_s = (self._arm_until_ns - self._clock.now_ns()) / NS
        detail = f"the joint moves on to its last goal for {left_s:.1f} s, because these servos cannot be stopped"
        return reports_of(outcome, self._config, self._arm_rad, detail if left_s > 0 else "")

    def _sensors(self) -> dict[str, tuple[float, ...]]:
        news = self._link.news
        sensors: dict[str, tuple[float, ...]] = {}
        if news.odometry is not None:
            _, x_m, y_m, yaw_rad, speed = news.odometry
            sensors |= {
                "odometry_xy_m": (x_m, y_m),
                "odometry_yaw_rad": (yaw_rad,),
                "odometry_linear_m_s": speed[:2],
                "odometry_angular_rad_s": speed[2:],
            }
        if news.imu is not None:
            sensors |= {
                "orientation_wxyz": news.imu.orientation_wxyz,
                "rpy_rad": roll_pitch_yaw(news.imu.orientation_wxyz),
                "gyro_rad_s": news.imu.gyro_rad_s,
                "acceleration_m_s2": news.imu.acceleration_m_s2,
            }
        for scan in SCANS:
            if scan in news.nearest_m:
                sensors[f"{scan.removeprefix('/')}_nearest_m"] = (news.nearest_m[scan],)
        return sensors


def link_of(config: YahboomConfig, clock: Clock) -> RosLink:
    """Return the link to the robot for commands. It is not open yet."""
    link: RosLink = load(LINKS[config.transport])(config, clock)
    return link
