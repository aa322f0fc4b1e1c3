"""One robot as a node of the graph: its topics and services."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import trio

from strands_actors.contract.loading import load
from strands_actors.drivers import URDF
from strands_actors.kernel.channels.ros2.definitions import (
    BATTERY,
    DIAGNOSTICS,
    IMU,
    JOINT_STATE,
    ODOMETRY,
    POSE,
    STRING,
    TF,
    TRIGGER,
    WRENCH,
)
from strands_actors.kernel.channels.ros2.graph import Arrival, Call, Graph, Publisher
from strands_actors.kernel.channels.ros2.names import Qos, ros_name
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import STOP_S, MeshClient
from strands_actors.surfaces.mesh.outcome import UNREACHABLE, Outcome

from . import answers, readings
from .cameras import Cameras
from .command_topics import CommandTopics
from .diagnostics import Summary, diagnostics
from .joints import Layout
from .motion import Mover
from .samples import Battery, Health, Imu, Odom, Presence, Sample, State, Wrench
from .writer import Writer

NOTHING: frozenset[str] = frozenset()
SENSOR_TYPES = (IMU, WRENCH)
"""Published with the quality of service of sensor data: best effort, so that no old reading is sent again."""
REPORT_S = 1.0
"""A refusal with the same code is printed once in this many seconds."""
MOST_CALLS = 16
"""So many calls of one service are carried out at the same time."""


class Surroundings(NamedTuple):
    """What all nodes of a bridge share.

    Attributes:
        mesh: The mesh, on which the robots are.
        graph: The graph.
        nursery: The nursery in which calls of services and writers run.
        namespace: The namespace of the nodes: empty, or with a slash in front.
        allow_motion: True if the graph may resume and move the robots.
        log: Called with each line for the user.
    """

    mesh: MeshClient
    graph: Graph
    nursery: trio.Nursery
    namespace: str
    allow_motion: bool
    log: Callable[[str], None]


class RobotNode:
    """The node of one robot.

    Args:
        robot: The name of the robot.
        layout: The joints of the robot. None if they are not known.
        around: What all nodes share.
    """

    def __init__(self, robot: str, layout: Layout | None, around: Surroundings) -> None:
        self.robot = robot
        self.name = ros_name(robot)
        self._around = around
        self._layout = layout
        self._fields = {} if layout is None else layout.fields
        self._prefix = f"{around.namespace}/{self.name}"
        self._last_stamp: dict[str, int] | None = None
        self._summary = Summary()
        self._reported: dict[str, float] = {}
        self._running: list[tuple[trio.CancelScope, trio.Event]] = []
        self._writer: Writer | None = None
        self._mover: Mover | None = None
        self.node = around.graph.node(around.namespace, self.name)
        self._cameras = Cameras(self.node, self._prefix, around.mesh, robot)
        self._diagnostics = self.node.publisher("/diagnostics", DIAGNOSTICS)
        self._topics = {name: self._publish(name, type_name) for name, type_name in self._published()}
        if "odom" in self._topics:
            self._topics["tf"] = self.node.publisher("/tf", TF)
        if layout is not None and layout.link_rows:
            description = self.node.publisher(f"{self._prefix}/robot_description", STRING, Qos.LATCHED)
            description.publish({"data": load(URDF)(self.name, layout.link_rows)})
        self._serve("stop", self._stop)
        self._serve("estop", self._estop)
        if around.allow_motion:
            self._serve("resume", self._resume)
            if layout is not None:
                self._take_commands(layout)

    def on_sample(self, sample: Sample) -> None:
        """Publish a sample of one of the robot's topics."""
        match sample:
            case State():
                self._summary = self._summary._replace(age_s=sample.age_s)
                self._on_state(sample)
            case Presence():
                self._summary = self._summary._replace(presence=sample)
                self._tell_state()
                self._cameras.add(sample.cameras)
            case Health():
                self._summary = self._summary._replace(health=sample)
            case Imu():
                fields = self._fields.get("imu", NOTHING)
                self._send("imu", lambda: readings.imu(sample, fields, f"{self.name}/imu"))
            case Battery():
                fields = self._fields.get("battery", NOTHING)
                self._send("battery_state", lambda: readings.battery(sample, fields))
            case Odom():
                self._on_odometry(sample)
            case Wrench():
                fields = self._fields.get("wrench", NOTHING)
                self._send("wrench", lambda: readings.wrench(sample, fields, f"{self.name}/{sample.frame}"))

    def look(self) -> None:
        """Begin and end to read cameras. Call it regularly."""
        self._cameras.look()

    async def close(self) -> None:
        """End the commands of the graph, and then take the robot off it."""
        self._cameras.close()
        for scope, ended in self._running:
            scope.cancel()
            await ended.wait()
        await trio.to_thread.run_sync(self.node.close)

    # -- topics out

    def _published(self) -> list[tuple[str, str]]:
        topics = [("joint_states", JOINT_STATE)] if self._layout is not None and self._layout.joints else []
        topics += [("tool_pose", POSE)] if self._layout is not None and self._layout.tool is not None else []
        types = {
            "imu": ("imu", IMU),
            "battery": ("battery_state", BATTERY),
            "odom": ("odom", ODOMETRY),
            "wrench": ("wrench", WRENCH),
        }
        return topics + [types[topic] for topic, fields in self._fields.items() if fields and topic in types]

    def _publish(self, name: str, type_name: str) -> Publisher:
        qos = Qos.SENSOR if type_name in SENSOR_TYPES else Qos.DEFAULT
        return self.node.publisher(f"{self._prefix}/{name}", type_name, qos)

    def _send(self, topic: str, make: Callable[[], dict[str, Any] | None]) -> None:
        """Publish a message, if there is a subscriber and something was measured."""
        publisher = self._topics.get(topic)
        if publisher is not None and publisher.has_subscribers and (message := make()) is not None:
            try:
                publisher.publish(message)
            except ValueError as error:  # A number of the robot is too large for the message.
                self._print_rarely(topic, f"{topic} is not published: {error}")

    def _on_state(self, state: State) -> None:
        layout = self._layout
        if layout is None:
            return
        message = readings.joint_state(state, layout)
        if message is not None and message["header"]["stamp"] != self._last_stamp:
            self._last_stamp = message["header"]["stamp"]
            if self._mover is not None:
                self._mover.on_positions(message, state.age_s or 0.0)
            self._send("joint_states", lambda: message)
            if (pose_of := layout.tool) is not None:
                self._send("tool_pose", lambda: readings.tool_pose(message, pose_of, f"{self.name}/base"))

    def _on_odometry(self, sample: Odom) -> None:
        fields = self._fields.get("odom", NOTHING)
        message = readings.odometry(sample, fields, f"{self.name}/odom", f"{self.name}/base")
        if message is not None:
            self._send("odom", lambda: message)
            self._send("tf", lambda: readings.transform(message))

    def _tell_state(self) -> None:
        if self._diagnostics.has_subscribers:
            writer = "" if self._writer is None else self._writer.holder
            self._diagnostics.publish(diagnostics(self.robot, self._summary._replace(writer=writer), time.time()))

    # -- topics in

    def _take_commands(self, layout: Layout) -> None:
        around = self._around
        writer = self._writer = Writer(around.mesh, self.robot, layout.lifetime_s, self._report)
        mover = self._mover = Mover(around.mesh, self.robot, layout, writer, self._report)
        commands = CommandTopics(
            self.node, self._prefix, layout, writer, mover, self._publisher_of, self._report, around.log
        )
        for task in commands.tasks:
            around.nursery.start_soon(self._run, task)

    async def _run(self, task: Callable[[], Awaitable[None]]) -> None:
        ended = trio.Event()
        try:
            with trio.CancelScope() as scope:
                self._running.append((scope, ended))
                await task()
        finally:
            ended.set()

    def _publisher_of(self, topic: str, arrival: Arrival) -> str:
        """Return the name of a message's publisher. Its identifier is in no token, so several are all named."""
        nodes = " or ".join(self._around.graph.publishers(topic)) or "an unknown node"
        return f"{nodes} (publisher {arrival.attachment.gid.hex()[:8]})"

    def _report(self, refused: Refused) -> None:
        summary = self._summary
        self._summary = summary._replace(refused=summary.refused + 1, last_refusal=refused.text)
        self._print_rarely(refused.code, f"refused: {refused.text}")

    def _print_rarely(self, kind: str, text: str) -> None:
        """Print a line, unless one of the same kind was printed less than ``REPORT_S`` ago."""
        now = trio.current_time()
        if now - self._reported.get(kind, -REPORT_S) >= REPORT_S:
            self._reported[kind] = now
            self._around.log(f"{self.robot}: {text}")

    # -- services

    def _serve(self, service: str, carry_out: Callable[[str], Awaitable[dict[str, Any]]]) -> None:
        under_way = 0

        async def answer(call: Call) -> None:
            nonlocal under_way
            under_way += 1
            try:
                call.reply(await carry_out(self._sender(call)))
            finally:
                under_way -= 1

        def on_call(call: Call) -> None:
            if under_way < MOST_CALLS:
                self._around.nursery.start_soon(answer, call)
            else:
                call.reply(answers.of_flood(self.robot, service, under_way))

        self.node.serve(f"{self._prefix}/{service}", TRIGGER, on_call)

    def _sender(self, call: Call) -> str:
        """Return the name that the robot reports as the sender of a stop."""
        return f"ROS 2 client {call.arrival.attachment.gid.hex()[:8]} of domain {self._around.graph.dialect.domain}"

    async def _stop(self, sender: str) -> dict[str, Any]:
        return answers.of_stop(await self._around.mesh.stop(self.robot, sender))

    async def _estop(self, sender: str) -> dict[str, Any]:
        outcomes = await self._around.mesh.estop(sender, STOP_S, self.robot)
        own = next((outcome for outcome in outcomes if outcome.robot == self.robot), None)
        return answers.of_stop(own or Outcome(self.robot, UNREACHABLE, "the robot is not on the mesh"))

    async def _resume(self, sender: str) -> dict[str, Any]:
        return answers.of_resume(self.robot, await self._around.mesh.resume(self.robot, sender))
