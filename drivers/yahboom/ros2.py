"""Reach the robot's topics with rclpy, for a program that runs on the robot.

rclpy is loaded only in the wire process, which can be killed if rclpy hangs. This was never run on
a robot. It was tested with a replacement for the rclpy calls below.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import trio

from strands_actors.contract.wire import ProcessSpent, WireDown
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.kit.sdk import SdkCalls, load_sdk
from strands_actors.kernel.clock import Clock

from . import messages as m
from .config import YahboomConfig, domain_of_environment
from .links import News, look_until, report_of

INSTALL = (
    "transport='ros2' is for a program on the robot: source /opt/ros/$ROS_DISTRO/setup.bash and the robot's own "
    "workspace, in the shell that starts it. From elsewhere use transport='rosbridge'"
)
NODE = "strands_actors"
QUEUE = 10
"""Depth of the publishers' queues, as usual with rclpy."""

SPIN_S = 0.01
"""Period of processing received messages."""

AT_ONCE = 32
"""Largest number of messages in one pass."""

ACK_S = 0.3
"""Longest single wait for acknowledgements. It cannot be cancelled."""

ACK_MARGIN_S = 0.1
"""How much longer than requested such a wait may take before this process counts as spent."""

Load = Callable[[str, str], Any]


class Ros2Link:
    """The link with rclpy. ``load`` imports a module, or raises ``WireDown`` with the remedy."""

    def __init__(self, config: YahboomConfig, clock: Clock, load: Load = load_sdk) -> None:
        self.news = News()
        self._config = config
        self._clock = clock
        self._load = load
        self._calls = SdkCalls("rclpy", (Exception,))
        self._rclpy: Any = None
        self._context: Any = None
        self._node: Any = None
        self._executor: Any = None
        self._publishers: dict[str, Any] = {}
        self._spinning = False

    @property
    def is_open(self) -> bool:
        return self._node is not None

    async def open(self) -> dict[str, Any]:
        await self.connect()
        with trio.move_on_after(self._config.timeout_s):
            await look_until(self._clock, SPIN_S, self._is_ready)
            return {"ros2": f"domain {domain_of_environment()}", "topics": sorted(self._topics())}
        missing = self._missing()
        self.close()
        raise WireDown(f"ros2: {missing} within {self._config.timeout_s:g} s. Start the robot's own nodes")

    async def connect(self) -> None:
        if self._node is None:
            self._open()
        await trio.lowlevel.checkpoint()

    async def receive_messages(self) -> None:
        self._spinning = True
        try:
            await look_until(self._clock, SPIN_S, self._spun)
        finally:
            self._spinning = False

    def zero(self) -> None:
        # Without a connection this raises, before any module is imported.
        self._publisher(m.CMD_VEL)
        self.drive(m.REST)

    @property
    def is_behind(self) -> bool:
        # rclpy keeps only the newest few messages that were sent, and does not report which of them have reached
        # the robot.
        return False

    @property
    def has_unacknowledged(self) -> bool:
        # As above, it is unknown.
        return False

    def drive(self, twist: m.Twist) -> None:
        message = self._type(m.CMD_VEL)()
        message.linear.x, message.linear.y, message.angular.z = (float(value) for value in twist)
        self._publish(m.CMD_VEL, message)

    def move_arm(self, goal: m.ArmGoal) -> None:
        message = self._type(m.ARM)()
        for name, value in m.arm_message(goal).items():
            setattr(message, name, value)
        self._publish(m.ARM, message)

    async def acknowledged(self, within_s: float) -> None:
        """Wait until every reliable subscriber has acknowledged all messages. Raise ``WireDown`` if
        that fails."""
        within_s = min(within_s, ACK_S)
        duration = self._load("rclpy.duration", INSTALL).Duration(seconds=within_s)
        wait = self._publisher(m.CMD_VEL).wait_for_all_acked
        try:
            acknowledged = await self._calls.call("wait_for_all_acked", within_s + ACK_MARGIN_S, wait, duration)
        except ProcessSpent as spent:
            # Raise ``WireDown``, because the stop that waits here handles it: it tries again.
            raise WireDown(str(spent)) from None
        if not acknowledged:
            raise WireDown(f"ros2: no acknowledgement within {within_s * 1e3:.0f} ms. Check the base's node")

    async def next_report(self, within_s: float) -> Report:
        before = self.news.odometry
        with trio.move_on_after(within_s):
            await look_until(self._clock, SPIN_S, lambda: self._spun() or self.news.odometry is not before)
        newest = self.news.odometry
        if newest is not None and newest is not before:
            return report_of(newest)
        raise WireDown(f"ros2: no odometry within {within_s * 1e3:.0f} ms. Check the base")

    def close(self) -> None:
        if self._node is None:
            return
        node, context, self._node = self._node, self._context, None
        self._executor.shutdown(timeout_sec=0)
        node.destroy_node()
        self._rclpy.shutdown(context=context)
        self._publishers = {}

    def _open(self) -> None:
        rclpy = self._rclpy = self._load("rclpy", INSTALL)
        no_signals = self._load("rclpy.signals", INSTALL).SignalHandlerOptions.NO
        quality = self._load("rclpy.qos", INSTALL).qos_profile_sensor_data
        executors = self._load("rclpy.executors", INSTALL)
        kinds = {topic: self._type(topic) for topic in (*m.COMMANDED, *m.REPORTED, *m.OPTIONAL)}
        domain = domain_of_environment()
        try:
            context = self._context = rclpy.Context()
            rclpy.init(context=context, domain_id=domain, signal_handler_options=no_signals)
            node = rclpy.create_node(NODE, context=context)
            self._publishers = {topic: node.create_publisher(kinds[topic], topic, QUEUE) for topic in m.COMMANDED}
            for topic in (*m.REPORTED, *m.OPTIONAL):
                node.create_subscription(kinds[topic], topic, self._receiver_of(topic), quality)
            self._executor = executors.SingleThreadedExecutor(context=context)
            self._executor.add_node(node)
        # rclpy raises exceptions of many types.
        except Exception as error:
            raise WireDown(f"ros2: {type(error).__name__}: {error}. Check the ROS 2 of this robot") from None
        self._node = node

    def _receiver_of(self, topic: str) -> Callable[[Any], None]:
        return lambda message: self.news.take(topic, m.read_object(topic, message), self._clock.now_ns())

    def _is_ready(self) -> bool:
        self._spin()
        return not self._missing()

    def _spun(self) -> bool:
        """Process received messages. Always return False, so that a caller's wait for a condition
        continues."""
        self._spin()
        return False

    def _spin(self) -> None:
        before = -1
        for _ in range(AT_ONCE):
            if self._node is None or self.news.received == before:
                return
            before = self.news.received
            self._executor.spin_once(timeout_sec=0)

    def _topics(self) -> dict[str, str]:
        """Return the present topics of the robot that this driver knows, with their types."""
        published = {
            name: [m.plain_type(type_name) for type_name in kinds]
            for name, kinds in self._node.get_topic_names_and_types()
        }
        expected = {**m.COMMANDED, **m.REPORTED, **m.OPTIONAL}
        return {topic: type_name for topic, type_name in expected.items() if type_name in published.get(topic, ())}

    def _missing(self) -> str:
        """Return which part of the robot is missing first; empty if all topics are there."""
        for topic in m.COMMANDED:
            if not self._node.count_subscribers(topic):
                return f"no node subscribes to {topic}"
        if self.news.odometry is None:
            return "no odometry"
        return "" if self.news.odometry_stamps.goes_on else "odometry never changes its stamp"

    def _publisher(self, topic: str) -> Any:
        if self._node is None:
            raise WireDown("ros2: not connected. Reconnect")
        return self._publishers[topic]

    def _publish(self, topic: str, message: Any) -> None:
        publisher = self._publisher(topic)
        try:
            publisher.publish(message)
        # rclpy raises exceptions of many types.
        except Exception as error:
            raise WireDown(f"ros2: {topic}: {error}. Check the ROS 2 of this robot") from None

    def _type(self, topic: str) -> Any:
        """Return the rclpy class for the messages of a topic. Raise ``WireDown``."""
        package, name = {**m.COMMANDED, **m.REPORTED, **m.OPTIONAL}[topic].split("/")
        return getattr(self._load(f"{package}.msg", INSTALL), name)
