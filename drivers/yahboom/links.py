"""The interface of a link to the robot's ROS topics: publish at once, and keep the newest of each topic.

``rosbridge.RosbridgeLink`` implements it over a WebSocket, ``ros2.Ros2Link`` with rclpy on the robot.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import aclosing
from typing import Any, Protocol

from strands_actors.drivers.common.kit.reporting_base import Report, ReportingBase
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.kernel.clock import Clock

from .messages import IMU, JOINT_STATES, ODOMETRY, ArmGoal, Imu, Message, Odometry, Twist, stands


class News:
    """The newest message of each topic and the time of its arrival (0 for never). For odometry it is the
    time at which its stamp changed."""

    def __init__(self) -> None:
        self.odometry: Odometry | None = None
        self.odometry_stamps = Stamps()
        self.imu: Imu | None = None
        self.joints: dict[str, float] = {}
        self.joints_ns = 0
        self.nearest_m: dict[str, float] = {}  # by scan
        self.malformed = 0
        self.taken = 0  # count of messages

    def take(self, topic: str, message: Message, now_ns: int) -> None:
        self.taken += 1
        match topic, message:
            case (_, Odometry()) if topic == ODOMETRY:
                self.odometry_stamps.take(message.stamp_ns, now_ns)
                self.odometry = message
            case (_, Imu()) if topic == IMU:
                self.imu = message
            case (_, dict()) if topic == JOINT_STATES:
                self.joints, self.joints_ns = message, now_ns
            case _, float():
                self.nearest_m[topic] = message

    def missing(self, now_ns: int) -> str:
        """Return the verb that is missing: odometry that is not new does not come, or repeats its stamp."""
        return "changed its stamp" if self.odometry_stamps.repeats(now_ns) else "come"


class RosLink(ReportingBase, Protocol):
    """A link to the robot's topics. All methods but ``close`` raise ``WireDown``."""

    news: News

    async def open(self) -> dict[str, Any]:
        """Connect, check topics and types, subscribe, and wait for the first odometry. Return facts for
        ``status``."""
        ...

    async def hear(self) -> None:
        """Keep ``news`` up to date until cancelled."""
        ...

    @property
    def is_behind(self) -> bool:
        """True if so many commands are unacknowledged that another one would be carried out late."""
        ...

    def drive(self, twist: Twist) -> None:
        """Publish a twist now."""
        ...

    def move_arm(self, goal: ArmGoal) -> None:
        """Publish a goal of the arm now."""
        ...

    def close(self) -> None:
        """Close the connection at once. It may be called again."""
        ...


def report_of(told: Odometry) -> Report:
    """Return the report of the base as a whole."""
    return Report(told.stamp_ns, stands(told.speed), ", ".join(f"{value:.3g}" for value in told.speed))


async def look_until(clock: Clock, every_s: float, is_so: Callable[[], bool]) -> None:
    """Wait until the condition is true. The caller sets the deadline."""
    async with aclosing(clock.ticks(every_s)) as ticks:
        async for _ in ticks:
            if is_so():
                return
