"""The process between the mesh and a ROS 2 graph. A robot that comes or goes appears or disappears on the graph."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable
from typing import NamedTuple

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.kernel.channels.pubsub import Received
from strands_actors.kernel.channels.ros2.graph import Graph, connect
from strands_actors.kernel.channels.ros2.names import Dialect, ros_name
from strands_actors.supervisors.mesh.schemas import key
from strands_actors.surfaces.mesh.client import MeshClient

from .joints import layout_of
from .robot_node import RobotNode, Surroundings
from .samples import TOPICS, Presence, read_sample

ROUTER = "tcp/localhost:7447"
"""Where rmw_zenohd listens by default."""
LOOK_S = 0.2
LOG_S = 5.0
"""A message that cannot be read is reported once per topic and this many seconds."""


class Options(NamedTuple):
    """The options of the command.

    Attributes:
        robots: The names of the robots to show; empty for all.
        namespace: The namespace of their nodes: empty, or with a slash in front.
        dialect: The domain, and if types have hashes.
        router: The endpoint of the router.
        allow_motion: True if the graph may resume and move robots.
    """

    robots: tuple[str, ...] = ()
    namespace: str = ""
    dialect: Dialect = Dialect()
    router: str = ROUTER
    allow_motion: bool = False


class Bridge:
    """The robots of a mesh as nodes of a graph. ``open_bridge`` makes it.

    Args:
        mesh: The mesh.
        graph: The graph.
        nursery: The nursery in which calls of services run.
        options: The options of the command.
        log: Called with each line for the user.
    """

    def __init__(
        self, mesh: MeshClient, graph: Graph, nursery: trio.Nursery, options: Options, log: Callable[[str], None]
    ) -> None:
        self.nodes: dict[str, RobotNode] = {}
        """The nodes by the name of their robot."""
        self._mesh = mesh
        self._graph = graph
        self._around = Surroundings(mesh, graph, nursery, options.namespace, options.allow_motion, log)
        self._options = options
        self._log = log
        self._refused: set[str] = set()
        for robot in options.robots or ("*",):
            for topic in TOPICS:
                mesh.subscribe(key(robot, topic), self._on_sample)

    async def run(self) -> None:
        """Take robots that have gone off the graph, and report the state of the connection, until cancelled."""
        was_connected = True
        while True:
            await trio.sleep(LOOK_S)
            for robot in [robot for robot in self.nodes if not self._mesh.is_there(robot)]:
                await self.nodes.pop(robot).close()
                self._log(f"{robot} has left")
            for node in self.nodes.values():
                node.look()
            if self._graph.is_connected != was_connected:
                was_connected = not was_connected
                again = "is connected again" if was_connected else "does not answer. Still trying"
                self._log(f"the router at {self._options.router} {again}")

    def _on_sample(self, received: Received) -> None:
        read = read_sample(received)
        if read is None:
            return
        robot, sample = read
        node = self.nodes.get(robot)
        if node is None and isinstance(sample, Presence):
            node = self._add(robot, sample)
        if node is not None:
            node.on_sample(sample)

    def _add(self, robot: str, presence: Presence) -> RobotNode | None:
        if robot in self._refused or not self._mesh.is_there(robot):
            return None
        other = next((other for other in self.nodes if ros_name(other) == ros_name(robot)), None)
        if other is not None:
            self._refused.add(robot)
            self._log(f"{robot} is not shown: its name on the graph, {ros_name(robot)}, is that of {other}")
            return None
        layout = layout_of(presence.hw, presence.action_keys)
        if layout is None:
            self._log(f"{robot}: the units of a {presence.hw} are not known here, so its joints are not shown")
        node = self.nodes[robot] = RobotNode(robot, layout, self._around)
        self._log(f"{robot} is on the graph as {self._options.namespace}/{node.name}")
        return node


class _Malformed:
    """Reports messages that cannot be read, at a limited rate."""

    def __init__(self, log: Callable[[str], None]) -> None:
        self._log = log
        self._last: dict[str, float] = {}

    def __call__(self, topic: str, reason: str) -> None:
        now = trio.current_time()
        if now - self._last.get(topic, -LOG_S) >= LOG_S:
            self._last[topic] = now
            self._log(f"{topic}: a message was dropped: {reason}")


@contextlib.asynccontextmanager
async def open_bridge(mesh: MeshClient, options: Options, log: Callable[[str], None]) -> AsyncIterator[Bridge]:
    """Show robots on a graph while the block runs. It begins when the router has been reached.

    Args:
        mesh: The mesh.
        options: The options of the command.
        log: Called with each line for the user.
    """
    waiting: list[str] = []

    def on_waiting(reason: str) -> None:
        if not waiting:
            log(f"waiting for a zenoh router at {options.router} ({reason}). ROS 2 starts one with rmw_zenohd")
        waiting.append(reason)

    graph = await connect(options.router, options.dialect, _Malformed(log), on_waiting)
    try:
        async with open_background() as nursery:
            await nursery.start(graph.run)
            bridge = Bridge(mesh, graph, nursery, options, log)
            nursery.start_soon(bridge.run)
            yield bridge
    finally:
        with trio.CancelScope(shield=True):
            await trio.to_thread.run_sync(graph.close)
