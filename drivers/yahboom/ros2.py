"""Reach the robot's topics as a node of its ROS 2 graph, by the router of rmw_zenoh.

Neither ROS nor rclpy is needed, also on the robot. This was never run on a robot. ROS acknowledges no message of a
topic, so only the odometry of the base shows the effect of a command.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.kit.reporting_base import Report
from strands_actors.drivers.common.ports.ros2_graph import ROUTER, GraphPort
from strands_actors.kernel.channels.ros2.graph import Arrival, Node, Publisher
from strands_actors.kernel.channels.ros2.names import Dialect, Entity, Qos
from strands_actors.kernel.clock import Clock

from . import messages as m
from .config import YahboomConfig, domain_of_environment
from .links import News, report_of

CONNECT_S = 0.4
"""Longest time to connect for a stop, before the next attempt."""


class Ros2Link:
    """The link by the graph. It commands, and it stops.

    Args:
        config: The settings of the robot.
        clock: The clock of this process.
    """

    def __init__(self, config: YahboomConfig, clock: Clock) -> None:
        self.news = News()
        self._config = config
        self._clock = clock
        self._publishers: dict[str, Publisher] = {}
        dialect = Dialect(domain_of_environment(), not config.humble)
        self._port = GraphPort(config.port or ROUTER, dialect, "strands_actors", self._declare)

    @property
    def is_open(self) -> bool:
        return self._port.is_open

    async def open(self) -> dict[str, Any]:
        await self._port.open(self._config.timeout_s)
        async with self._port.receiving():
            with trio.move_on_after(self._config.timeout_s):
                await self._port.until(lambda: not self._missing())
                return {"ros2": f"domain {domain_of_environment()}", "topics": sorted(self._topics())}
        missing = self._missing()
        self.close()
        raise WireDown(f"ros2: {missing} within {self._config.timeout_s:g} s. Start the robot's own nodes")

    async def listen(self) -> None:
        """Connect and subscribe to odometry, before a stop is needed. Raise ``WireDown``."""
        await self.open()

    async def connect(self) -> None:
        await self._port.open(CONNECT_S)

    async def receive_messages(self) -> None:
        await self._port.receive()

    def zero(self) -> None:
        self.drive(m.REST)

    @property
    def is_behind(self) -> bool:
        # It is not known which commands have reached the robot. ``YahboomWire`` sends none without odometry.
        return False

    @property
    def has_unacknowledged(self) -> bool:
        # As above, it is unknown.
        return False

    def drive(self, twist: m.Twist) -> None:
        self._publish(m.CMD_VEL, m.twist_message(twist))

    def move_arm(self, goal: m.ArmGoal) -> None:
        self._publish(m.ARM, m.arm_message(goal))

    async def acknowledged(self, within_s: float) -> None:
        """Wait for the next odometry, since ROS has no acknowledgement. Raise ``WireDown`` if it does not come."""
        await self.next_report(within_s)

    async def next_report(self, within_s: float) -> Report:
        before = self.news.odometry
        async with self._port.receiving():
            with trio.move_on_after(within_s):
                await self._port.until(lambda: self.news.odometry is not before)
        newest = self.news.odometry
        if newest is not None and newest is not before:
            return report_of(newest)
        raise WireDown(f"ros2: no odometry within {within_s * 1e3:.0f} ms. Check the base and the router")

    def close(self) -> None:
        self._publishers = {}
        self._port.close()

    def _declare(self, node: Node) -> None:
        for topic, type_name in m.COMMANDED.items():
            self._publishers[topic] = node.publisher(topic, m.full_type(type_name))
        for topic, type_name in {**m.REPORTED, **m.OPTIONAL}.items():
            node.subscribe(topic, m.full_type(type_name), self._receiver_of(topic), Qos.SENSOR)

    def _receiver_of(self, topic: str) -> Callable[[Arrival], None]:
        def take(arrival: Arrival) -> None:
            try:
                message = m.read_fields(topic, arrival.message)
            except MalformedFrame:
                self.news.malformed += 1
            else:
                self.news.take(topic, message, self._clock.now_ns())

        return take

    def _topics(self) -> set[str]:
        """Return the present topics of the robot that this driver knows."""
        graph = self._port.graph
        reported = {*m.REPORTED, *m.OPTIONAL}
        return {*m.COMMANDED, *(topic for topic in reported if graph.nodes_with(Entity.PUBLISHER, topic))}

    def _missing(self) -> str:
        """Return which part of the robot is missing first; empty if all topics are there."""
        for topic in m.COMMANDED:
            if not self._port.graph.nodes_with(Entity.SUBSCRIPTION, topic):
                return f"no node subscribes to {topic}"
        if self.news.odometry is None:
            return "no odometry"
        return "" if self.news.odometry_stamps.goes_on else "odometry never changes its stamp"

    def _publish(self, topic: str, message: dict[str, Any]) -> None:
        if not self._port.is_open:
            raise WireDown("ros2: the router does not answer. Check it")
        self._publishers[topic].publish(message)
