"""The interface of a link to the robot's ROS topics. It publishes at once, and keeps the newest
message of each topic.

``rosbridge.RosbridgeLink`` implements it over a WebSocket, ``ros2.Ros2Link`` as a node of the
robot's ROS 2 graph.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import aclosing
from typing import Any, Protocol

from strands_actors.drivers.common.kit.reporting_base import Report, ReportingBase
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.kernel.clock import NS, Clock

from .messages import IMU, JOINT_STATES, ODOMETRY, ArmGoal, Imu, Message, Odometry, Twist, stands


class News:
    """The newest message of each topic, and when it arrived (0 if none arrived). For odometry, it
    is the time at which the message's stamp last changed."""

    def __init__(self) -> None:
        self.odometry: Odometry | None = None
        self.odometry_stamps = Stamps()
        self.imu: Imu | None = None
        self.joints: dict[str, float] = {}
        self.joints_ns = 0
        self.nearest_m: dict[str, float] = {}  # nearest distance of each laser scan
        self.malformed = 0
        self.received = 0  # number of received messages

    def take(self, topic: str, message: Message, now_ns: int) -> None:
        self.received += 1
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

    def describe_silence(self, now_ns: int) -> str:
        """Return a sentence about the missing odometry, for a message."""
        if self.odometry is None:
            return "no odometry has arrived"
        silent_s = (now_ns - self.odometry_stamps.new_ns) / NS
        if self.odometry_stamps.repeats(now_ns):
            return f"odometry has not changed its stamp for {silent_s:.1f} s"
        return f"no odometry has arrived for {silent_s:.1f} s"


class RosLink(ReportingBase, Protocol):
    """A link to the robot's topics. All methods but ``close`` raise ``WireDown``."""

    news: News

    async def open(self) -> dict[str, Any]:
        """Connect, check topics and types, subscribe, and wait for the first odometry. Return facts
        about the robot, which the verb ``status`` shows."""
        ...

    async def receive_messages(self) -> None:
        """Receive messages into ``news`` until cancelled."""
        ...

    @property
    def is_behind(self) -> bool:
        """True if too many commands are unacknowledged. Another command would wait behind them and
        be carried out late."""
        ...

    @property
    def has_unacknowledged(self) -> bool:
        """True if the robot has not acknowledged all commands. It may still carry them out."""
        ...

    def drive(self, twist: Twist) -> None:
        """Publish a twist now."""
        ...

    def move_arm(self, goal: ArmGoal) -> None:
        """Publish a goal of the arm now."""
        ...

    def close(self) -> None:
        """Close the connection at once. A second call does nothing."""
        ...


def report_of(odometry: Odometry) -> Report:
    """Summarise an odometry message as one report for the whole base: its stamp, whether the base
    stands, and its speed."""
    return Report(odometry.stamp_ns, stands(odometry.speed), ", ".join(f"{value:.3g}" for value in odometry.speed))


async def look_until(clock: Clock, every_s: float, is_so: Callable[[], bool]) -> None:
    """Check the condition every ``every_s`` seconds until it is true. The caller sets the deadline."""
    async with aclosing(clock.ticks(every_s)) as ticks:
        async for _ in ticks:
            if is_so():
                return
