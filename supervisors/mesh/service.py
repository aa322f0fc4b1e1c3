"""Connect a robot to the mesh, so that other hosts can read it, command it and stop it.

These actors run in the root process, under separate supervisors. A failed actor is restarted. If it fails too
often, the robot continues without the mesh, and its local script still commands it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import trio
import zenoh

from strands_actors.contract.driver import Driver
from strands_actors.kernel.actor import describe
from strands_actors.kernel.channels.frame_ring import FrameRing
from strands_actors.kernel.channels.pubsub import PubSub
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.supervisor import Budget, BudgetSpent, ChildSpec, Supervisor
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.root.messages import StateIs, TaskStatus

from .answers import Answers
from .command_rules import Shared
from .commands import Commands
from .gateway import Gateway, GatewayStop
from .pictures import Pictures
from .safety import Safety
from .schemas import MAX_MESSAGE_BYTES
from .telemetry import Telemetry

BUDGET = Budget(restarts=3, within_s=5.0, backoff_s=0.05)


class MeshService:
    """Run all actors of one robot that serve the mesh.

    Args:
        node: The node of the root process, which runs its actors.
        robot: Name of the robot.
        driver: Driver of the robot.
        task: Returns the status of the task that the root has started.
        rings: Returns the shared ring buffer of pictures of each camera. None for a robot without cameras.
        audit: Called with the sender, the command, the decision, and the route of the command.
        restarts: Returns how often each process of the robot was started again.
        further_counts: Returns further counters for ``health``.

    Attributes:
        problem: Why the robot is not on the mesh; empty if it is. Valid once ``settled`` is set.
    """

    def __init__(
        self,
        node: Node,
        robot: str,
        driver: Driver,
        task: Callable[[], TaskStatus],
        rings: Callable[[], Mapping[str, FrameRing]] | None = None,
        audit: Callable[[str, str, str, str], None] = lambda *_: None,
        restarts: Callable[[], Mapping[str, int]] = dict,
        further_counts: Callable[[], Mapping[str, int]] = dict,
    ) -> None:
        self._further_counts = further_counts
        self._restarts = restarts
        self._rings = rings
        self._audit = audit
        self._node = node
        self._robot = robot
        self._driver = driver
        self._task = task
        self._actors = addresses.of(robot)
        self.problem = ""
        self.settled = trio.Event()
        self._pubsub: PubSub | None = None

    def tell_state(self, state: StateIs) -> None:
        """Let the safety actor publish a change of the robot's failsafe state as an event on the mesh."""
        if self._actors.safety in self._node.cells:
            self._node.ref(self._actors.safety, Safety).tell(state)

    async def run(self, listen: list[str], connect: list[str], settings: Mapping[str, Any]) -> None:
        """Join the mesh and serve it until cancelled. Return with ``problem`` set if that fails.

        Args:
            listen: Zenoh endpoints to listen on.
            connect: Zenoh endpoints to connect to.
            settings: Further settings of the zenoh session.
        """
        limits = {"transport/link/rx/max_message_size": MAX_MESSAGE_BYTES}
        try:
            pubsub = await PubSub.open(listen, connect, {**limits, **settings})
        except zenoh.ZError as error:
            self.problem = f"mesh: {', '.join((*listen, *connect))}: {short(error)}"
            self.settled.set()
            return
        self._pubsub = pubsub
        try:
            async with trio.open_nursery() as nursery:
                await nursery.start(pubsub.run)
                stops, others = self._supervisors(pubsub)
                await nursery.start(stops.run)
                await nursery.start(self._run_others, others)
                self.settled.set()
        except* BudgetSpent as failure:
            self.problem = f"mesh: {describe(failure)}"
            self.close()

    async def _run_others(
        self, others: Supervisor, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED
    ) -> None:
        """Run the actors for telemetry and commands. If they fail too often, they are not restarted, and the robot
        can still be stopped over the mesh."""
        try:
            await others.run(task_status=task_status)
        except* BudgetSpent as error:
            self.problem = f"mesh: {describe(error)}"
            report_failure("telemetry and commands over the mesh", error)
            self._audit(self._robot, "mesh", f"failed: {describe(error)}", "this robot")

    def close(self) -> None:
        """Leave the mesh. This blocks for a few milliseconds. It is not needed when the process ends anyway."""
        if self._pubsub is not None:
            self._pubsub.close()
            self._pubsub = None

    def _supervisors(self, pubsub: PubSub) -> tuple[Supervisor, Supervisor]:
        """Return two supervisors: one for the actors that stop the robot, and one for all others."""
        robot, driver, actors, node = self._robot, self._driver, self._actors, self._node
        answers, shared = Answers(pubsub, robot), Shared()
        shared.audit = self._audit
        deadlines = StopDeadlines.of(driver.timing.safe_s, driver.late_s)

        def counts() -> dict[str, int]:
            own = {"commands": shared.received, "commands_refused": answers.refused}
            return {**own, **self._further_counts()}

        stops = [
            node.cell(actors.path("safety"), lambda: Safety(robot, driver, pubsub, answers, shared)),
            node.cell(actors.path("gateway/stop"), lambda: GatewayStop(robot, deadlines), "gateway_stop"),
        ]
        others = [
            node.cell(
                actors.path("commands"), lambda: Commands(robot, driver, pubsub, answers, shared, self._task)
            ),
            node.cell(actors.path("gateway"), lambda: Gateway(robot, driver.robot, driver, pubsub, shared)),
            node.cell(
                actors.path("telemetry"),
                lambda: Telemetry(robot, driver, pubsub, self._task, counts, self._restarts, self._rings or dict),
            ),
        ]
        if (rings := self._rings) is not None:
            others.append(node.cell(actors.path("pictures"), lambda: Pictures(robot, pubsub, rings)))
        stopping, serving = (
            Supervisor([ChildSpec(cell.role, cell.run) for cell in cells], budget=BUDGET)
            for cells in (stops, others)
        )
        return stopping, serving
