"""The topics and the action of one robot on a ROS 2 graph. Commands are sent at once; reports are kept."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.kit.stamps import Stamps
from strands_actors.drivers.common.ports.ros2_graph import GraphPort
from strands_actors.kernel.channels.ros2.definitions import (
    CANCEL,
    FOLLOW,
    JOINT_STATE,
    ODOMETRY,
    TWIST,
    TWIST_STAMPED,
)
from strands_actors.kernel.channels.ros2.graph import Arrival, Client, Node, Publisher
from strands_actors.kernel.channels.ros2.names import Entity, Qos, ros_name
from strands_actors.kernel.clock import NS, Clock

from .config import Ros2Config
from .table import BASE

MOST_GOALS = 4
"""So many goals may wait for the node's answer. Another one would be carried out late."""

ANSWER_S = 1.0
"""A goal without an answer counts as lost after so long."""

STILL = {"linear.x": 0.01, "linear.y": 0.01, "angular.z": 0.02, "rad": 0.02, "m": 0.005}
"""The largest speed that counts as zero: of a base's axis in m/s or rad/s, and of a joint by its unit [assumed]."""


class Reports:
    """The newest odometry and joint state, and when each last had a new stamp."""

    def __init__(self) -> None:
        self.odometry: Mapping[str, Any] = {}
        self.odometry_stamps = Stamps()
        self.odometry_s = 0.0
        """The stamp of the newest odometry, on the node's clock in seconds."""
        self.positions: dict[str, float] = {}
        self.speeds: dict[str, float] = {}
        self.joint_stamps = Stamps()
        self.joints_s = 0.0

    def take_odometry(self, message: Mapping[str, Any], now_ns: int) -> None:
        values = list(_speeds(message["twist"]["twist"]).values())
        if all(map(math.isfinite, values)):
            self.odometry = message
            self.odometry_s = seconds(message["header"]["stamp"])
            self.odometry_stamps.take(self.odometry_s, now_ns)

    def take_joints(self, message: Mapping[str, Any], joints: Sequence[str], now_ns: int) -> None:
        """Take a joint state that names all joints. Others, such as those of a gripper, are ignored."""
        names, positions, speeds = message["name"], message["position"], message["velocity"]
        read = {name: value for name, value in zip(names, positions, strict=False) if math.isfinite(value)}
        if not all(joint in read for joint in joints):
            return
        stamp_s = seconds(message["header"]["stamp"])
        is_new = self.joint_stamps.take(stamp_s, now_ns)
        if not is_new:
            return
        span_s = stamp_s - self.joints_s
        reported = dict(zip(names, speeds, strict=False)) if len(speeds) == len(names) else {}
        for joint in joints:
            moved = read[joint] - self.positions.get(joint, math.inf)
            speed = reported.get(joint, math.nan)
            # Without a reported speed, it is computed from two positions.
            self.speeds[joint] = speed if math.isfinite(speed) else moved / span_s if span_s > 0 else math.inf
            self.positions[joint] = read[joint]
        self.joints_s = stamp_s

    @property
    def base_speeds(self) -> dict[str, float]:
        """Return the reported speed of each axis of a base; empty before the first odometry."""
        return _speeds(self.odometry["twist"]["twist"]) if self.odometry else {}


class RosLink:
    """The connection of one process to the robot. All methods but ``close`` raise ``WireDown``.

    Args:
        config: The settings of the robot.
        clock: The clock of this process.
        role: The use of this connection, as a part of its node's name.
    """

    def __init__(self, config: Ros2Config, clock: Clock, role: str) -> None:
        self.reports = Reports()
        self.table = config.table
        self.joints = tuple(config.table.joints)
        self._unanswered: dict[int, int] = {}
        """For each goal that the node has not answered, the time at which it counts as lost (ns)."""
        self._config = config
        self._clock = clock
        self._twists: Publisher | None = None
        self._goals: Client | None = None
        self._cancels: Client | None = None
        self._numbers = itertools.count(1)
        self.port = GraphPort(config.router, config.dialect, node_name(config, role), self._declare)

    def _declare(self, node: Node) -> None:
        table = self.table
        if table.base:
            node.subscribe(table.odom, ODOMETRY, self._on_odometry, Qos.SENSOR)
            self._twists = node.publisher(table.cmd_vel, TWIST_STAMPED if table.stamped else TWIST)
        if table.joints:
            node.subscribe(table.joint_states, JOINT_STATE, self._on_joints, Qos.SENSOR)
            action = f"{table.follow_joint_trajectory}/_action"
            self._goals = node.client(f"{action}/send_goal", f"{FOLLOW}_SendGoal")
            self._cancels = node.client(f"{action}/cancel_goal", CANCEL)

    async def open(self) -> None:
        """Connect, and wait until the node is there and reports with changing stamps."""
        within_s = self._config.timeout_s
        began_s = trio.current_time()
        await self.port.open(within_s)
        async with self.port.receiving():
            with trio.move_on_at(began_s + within_s):
                await self.port.until(lambda: not self.missing())
                return
        reason = self.missing()
        self.close()
        raise WireDown(f"ros2: {reason} within {within_s:g} s. Start the robot's nodes, or correct its table")

    def missing(self) -> str:
        """Return what of the robot is not there; empty if all is there."""
        graph, table, reports = self.port.graph, self.table, self.reports
        if table.base:
            if not graph.nodes_with(Entity.SUBSCRIPTION, table.cmd_vel):
                return f"no node subscribes to {table.cmd_vel}"
            if not reports.odometry:
                return f"no odometry came on {table.odom}"
            if not reports.odometry_stamps.goes_on:
                return f"the stamps of {table.odom} never change"
        if table.joints:
            if not graph.nodes_with(Entity.SERVICE, f"{table.follow_joint_trajectory}/_action/send_goal"):
                return f"no node serves the action {table.follow_joint_trajectory}"
            if not reports.positions:
                return f"no positions of {', '.join(self.joints)} came on {table.joint_states}"
            if not reports.joint_stamps.goes_on:
                return f"the stamps of {table.joint_states} never change"
        return ""

    def nodes(self) -> dict[str, list[str]]:
        """Return the nodes that drive the robot, and other nodes that may command it, by their names."""
        graph, table = self.port.graph, self.table
        goals = f"{table.follow_joint_trajectory}/_action/send_goal"
        drivers, writers = set[str](), set[str]()
        if table.base:
            drivers |= set(graph.nodes_with(Entity.SUBSCRIPTION, table.cmd_vel))
            writers |= set(graph.nodes_with(Entity.PUBLISHER, table.cmd_vel))
        if table.joints:
            drivers |= set(graph.nodes_with(Entity.SERVICE, goals))
            writers |= set(graph.nodes_with(Entity.CLIENT, goals))
        own = f"/{node_name(self._config, '')}"
        others = {name for name in writers if not name.startswith(own)}
        return {"driven_by": sorted(drivers), "also_commanded_by": sorted(others)}

    def silent_s(self) -> float:
        """Return for how long one of the reports had no new stamp, in seconds."""
        stamps = [self.reports.odometry_stamps] * bool(self.table.base)
        stamps += [self.reports.joint_stamps] * bool(self.table.joints)
        return max((self._clock.now_ns() - each.new_ns) / NS for each in stamps)

    @property
    def goals_waiting(self) -> int:
        """Return how many goals the node has not answered yet. It may still carry them out."""
        now_ns = self._clock.now_ns()
        self._unanswered = {number: lost_ns for number, lost_ns in self._unanswered.items() if lost_ns > now_ns}
        return len(self._unanswered)

    # -- commands

    def drive(self, speeds: Mapping[str, float]) -> None:
        """Publish a twist now. Axes that are not named get zero."""
        if self._twists is None:
            raise WireDown("ros2: not connected. Reconnect")
        if not self.port.is_open:
            raise WireDown("ros2: the router does not answer. Check it")
        twist: dict[str, dict[str, float]] = {"linear": {}, "angular": {}}
        for key, speed in speeds.items():
            part, _, component = key.partition(".")
            twist[part][component] = speed
        if self.table.stamped:
            # Nodes drop a twist with an old stamp, and accept one with none.
            self._twists.publish({"twist": twist})
        else:
            self._twists.publish(twist)

    def follow(self, positions: Mapping[str, float], seconds: float) -> None:
        """Send a goal with one point, which replaces the goal before."""
        if self._goals is None or not self.port.is_open:
            raise WireDown("ros2: the router does not answer. Check it")
        whole = int(seconds)
        point = {
            "positions": list(positions.values()),
            "time_from_start": {"sec": whole, "nanosec": int((seconds - whole) * NS)},
        }
        goal = {"trajectory": {"joint_names": list(positions), "points": [point]}}
        number = next(self._numbers)
        request = {"goal_id": {"uuid": os.urandom(16)}, "goal": goal}

        def on_response(_: dict[str, Any]) -> None:
            self._unanswered.pop(number, None)

        self._goals.send(request, on_response, ANSWER_S)
        self._unanswered[number] = self._clock.now_ns() + round(ANSWER_S * NS)

    def zero(self) -> None:
        """Publish a twist of zeros now."""
        self.drive({})

    def cancel(self, on_response: Callable[[dict[str, Any]], None]) -> None:
        """Cancel all goals of the robot's action now, also those of other programs."""
        if self._cancels is None or not self.port.is_open:
            raise WireDown("ros2: the router does not answer. Check it")
        self._cancels.send({}, on_response, ANSWER_S)

    def close(self) -> None:
        """Close the connection at once. A second call does nothing."""
        self._twists = self._goals = self._cancels = None
        self.port.close()

    def _on_odometry(self, arrival: Arrival) -> None:
        self.reports.take_odometry(arrival.message, arrival.arrived_ns)

    def _on_joints(self, arrival: Arrival) -> None:
        self.reports.take_joints(arrival.message, self.joints, arrival.arrived_ns)


def node_name(config: Ros2Config, role: str) -> str:
    """Return the name of the node of one process of the robot."""
    return f"strands_{ros_name(config.robot)}_{role}"


def seconds(stamp: Mapping[str, int]) -> float:
    return float(stamp["sec"]) + stamp["nanosec"] / NS


def _speeds(twist: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    return {key: twist[key.partition(".")[0]][key.partition(".")[2]] for key in BASE}
