"""Send the orders of a robot to its parts, over the sockets of the parts in the run directory."""

from __future__ import annotations

import os
import secrets
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import TypeVar

import trio

from strands_actors.caller.processes.leftovers import PAGE
from strands_actors.caller.processes.nodes import open_node
from strands_actors.contract.driver import HOLDING_REASONS, Reason
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.zenoh_session import unix_endpoint
from strands_actors.kernel.health.heartbeat import words_of
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.supervisors import addresses
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import Stop, StopReport
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import Fence

from .config import PartConfig, PartsConfig

T = TypeVar("T")


class Links:
    """The connections of one process to all parts. ``run`` keeps them open."""

    def __init__(self, config: PartsConfig) -> None:
        self.parts = config.parts
        self._config = config
        self._node: Node | None = None

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Keep the connections open until cancelled. A part that does not run yet is connected when it runs."""
        sockets = (self._config.socket(part, role) for part in self.parts for role in ("root", "wire"))
        name = f"parts.{os.getpid()}.{secrets.token_hex(4)}"
        async with open_node(name, connect=[unix_endpoint(path) for path in sockets]) as (node, _):
            self._node = node
            task_status.started()
            try:
                await trio.sleep_forever()
            finally:
                self._node = None

    @property
    def are_open(self) -> bool:
        return self._node is not None

    def _ref(self, part: PartConfig, actor: type[Actor]) -> Ref:
        if self._node is None:
            raise Unreachable(f"{part.name} is not connected")
        address = addresses.of(part.robot).address(actor.__name__.lower())
        return self._node.ref(address, actor, sender=f"{self._node.address}/{part.robot}")

    async def ask(
        self, part: PartConfig, message: Message, within_s: float, actor: type[Actor] = Gate
    ) -> Message | None:
        """Ask an actor of a part, and return its answer.

        Raises:
            AskTimeout: No answer came in time.
            Unreachable: The part's process does not run.
        """
        return await self._ref(part, actor).ask(message, within_s)

    def tell(self, part: PartConfig, message: Message) -> None:
        """Send a message to the gate of a part, without an answer."""
        self._ref(part, Gate).tell(message)

    async def each(self, run: Callable[[PartConfig], Awaitable[T]]) -> list[T]:
        """Run a function for all parts at the same time, and return the results in the order of the parts."""
        results: dict[str, T] = {}

        async def keep(part: PartConfig) -> None:
            results[part.name] = await run(part)

        async with trio.open_nursery() as nursery:
            for part in self.parts:
                nursery.start_soon(keep, part)
        return [results[part.name] for part in self.parts]

    async def stop(self, part: PartConfig, reason: Reason, by: str, lock: bool = False) -> tuple[MotorReport, ...]:
        """Bring one part to its safe state for a reason, and return a report on each of its motors. Never raises.

        The gate of the part is asked first. If it does not answer and a motor may be energised, the part's root
        process kills the wire process, and stops the part by its own stop channel.
        """
        deadlines = StopDeadlines.of(part.timing.safe_s, part.late_s)
        answer: Message | None = None
        try:
            answer = await self.ask(part, Stop(reason, by, lock), deadlines.gate_s)
        except (AskTimeout, Unreachable) as failure:
            problem = str(failure)
        if not isinstance(answer, StopReport) and not lock and self._is_at_rest(part):
            # A wire process that starts again answers late. A fence would end it before it answers.
            return part.reports(written=True, safe=True)
        if not isinstance(answer, StopReport):
            fence = Fence(Reason.STOP if reason in HOLDING_REASONS else reason, by, lock)
            try:
                answer = await self.ask(part, fence, deadlines.root_s, Guardian)
            except (AskTimeout, Unreachable) as failure:
                problem = str(failure)
        if not isinstance(answer, StopReport):
            safe = self._is_at_rest(part)
            return part.reports(written=safe, safe=safe, detail="" if safe else f"{part.name}: {problem}")
        if not answer.motors:
            return part.reports(written=True, safe=answer.confirmed)
        rows = {motor.axis: motor for motor in answer.motors}
        return tuple(
            MotorReport(axis, motor.id, motor.written, motor.acknowledged, motor.safe, motor.detail, motor.target)
            for axis, motor in zip(part.axes, (rows[key] for key in part.keys), strict=True)
        )

    def _is_at_rest(self, part: PartConfig) -> bool:
        """Return True if no motor of a part may be energised, also after the processes of the part have ended.

        The processes of the part note this on its page of shared memory. They note it before a motor is energised,
        and clear the note when every motor has confirmed a stop.
        """
        try:
            file = os.open(Path(self._config.directory) / f"{part.robot}{PAGE}", os.O_RDWR | os.O_CLOEXEC)
        except OSError:
            return False
        try:
            return not SafetyPage(words_of(file)).may_be_energised
        finally:
            os.close(file)
