"""One robot as a node of the graph: its topics and services."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import trio

from strands_actors.surfaces.mesh.client import STOP_S, MeshClient
from strands_actors.surfaces.mesh.outcome import UNREACHABLE, Outcome

from . import answers, readings
from .definitions import JOINT_STATE, TRIGGER
from .graph import Call, Graph, Publisher
from .joints import Layout
from .names import ros_name
from .samples import Presence, Sample, State


class RobotNode:
    """The node of one robot.

    Args:
        mesh: The mesh, on which the robot is.
        graph: The graph.
        nursery: The nursery in which calls of services run.
        robot: The name of the robot.
        namespace: The namespace of the node: empty, or with a slash in front.
        layout: The joints of the robot. None if they are not known.
        allow_motion: True if the graph may resume and move the robot.
    """

    def __init__(
        self,
        mesh: MeshClient,
        graph: Graph,
        nursery: trio.Nursery,
        robot: str,
        namespace: str,
        layout: Layout | None,
        allow_motion: bool,
    ) -> None:
        self.robot = robot
        self.name = ros_name(robot)
        self._mesh = mesh
        self._nursery = nursery
        self._layout = layout
        self._prefix = f"{namespace}/{self.name}"
        self._dialect = graph.dialect
        self._last_stamp: dict[str, int] | None = None
        self.node = graph.node(namespace, self.name)
        self._joint_states: Publisher | None = None
        if layout is not None and layout.joints:
            self._joint_states = self.node.publisher(f"{self._prefix}/joint_states", JOINT_STATE)
        self._serve("stop", self._stop)
        self._serve("estop", self._estop)
        if allow_motion:
            self._serve("resume", self._resume)

    def on_sample(self, sample: Sample) -> None:
        """Publish a sample of one of the robot's topics."""
        match sample:
            case State():
                self._on_state(sample)
            case Presence():
                pass

    def close(self) -> None:
        """Take the robot off the graph. Blocks for a few milliseconds."""
        self.node.close()

    # -- topics

    def _on_state(self, state: State) -> None:
        publisher, layout = self._joint_states, self._layout
        if publisher is None or layout is None or not publisher.has_subscribers:
            return
        message = readings.joint_state(state, layout)
        if message is not None and message["header"]["stamp"] != self._last_stamp:
            self._last_stamp = message["header"]["stamp"]
            publisher.publish(message)

    # -- services

    def _serve(self, service: str, carry_out: Callable[[str], Awaitable[dict[str, Any]]]) -> None:
        async def answer(call: Call) -> None:
            call.reply(await carry_out(self._sender(call)))

        self.node.serve(f"{self._prefix}/{service}", TRIGGER, lambda call: self._nursery.start_soon(answer, call))

    def _sender(self, call: Call) -> str:
        """Return the name that the robot reports as the sender of a stop."""
        return f"ROS 2 client {call.arrival.attachment.gid.hex()[:8]} of domain {self._dialect.domain}"

    async def _stop(self, sender: str) -> dict[str, Any]:
        return answers.of_stop(await self._mesh.stop(self.robot, sender))

    async def _estop(self, sender: str) -> dict[str, Any]:
        outcomes = await self._mesh.estop(sender, STOP_S, self.robot)
        own = next((outcome for outcome in outcomes if outcome.robot == self.robot), None)
        return answers.of_stop(own or Outcome(self.robot, UNREACHABLE, "the robot is not on the mesh"))

    async def _resume(self, sender: str) -> dict[str, Any]:
        return answers.of_resume(self.robot, await self._mesh.resume(self.robot, sender))
