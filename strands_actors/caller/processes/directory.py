"""List the robots of this user that run now. Ask, stop or resume them from another program.

    async with join() as directory:
        for note in directory.notes:
            print(await directory.tree(note))

A note is a file on how to reach a robot. This module acquires no right to command a robot, and keeps no process
alive.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import AsyncIterator, Sequence

import trio

from strands_actors.contract.driver import Reason
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.answers import read_answer
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Unreachable
from strands_actors.supervisors import addresses, stop_result
from strands_actors.supervisors.deadlines import StopDeadlines
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import GetStatus, Resume, Resumed, Status, Stop, StopReport
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import UNREACHABLE, Describe, Fence, ProcessInfo, TreeReport
from strands_actors.supervisors.root.process import Root
from strands_actors.supervisors.stop_result import StopResult

from . import refusals
from .descendants import complete
from .nodes import open_node
from .run_directory import Note, notes

JOIN_S = 0.5
"""After so many seconds from ``join`` a process that does not appear counts as unreachable."""
ANSWER_S = 0.5
RESUME_ROOM_S = 2.0
"""Margin of a resume, in addition to the longest time for arming."""


class Directory:
    """The robots that ran when ``join`` was called."""

    def __init__(self, node: Node, running: Sequence[Note]) -> None:
        self.notes = running
        self._node = node
        self._joined_at = trio.current_time()

    def is_current(self) -> bool:
        """Return True while the same robots run. Otherwise join again, to reach the new ones."""
        return [(note.robot, note.pid) for note in self.notes] == [(note.robot, note.pid) for note in notes()]

    async def tree(self, note: Note) -> TreeReport:
        """Return the processes and actors of a robot.

        The state is ``unreachable`` if the root process, which supervises the others, does not answer.
        """
        try:
            answer = await self._ask(addresses.of(note.robot).root, Root, Describe(), ANSWER_S)
        except (AskTimeout, Unreachable):
            answer = None
        if isinstance(answer, TreeReport):
            return complete(answer)
        return TreeReport(note.robot, UNREACHABLE, 0, (ProcessInfo("root", note.pid, 0),), ())

    async def status(self, note: Note) -> Status | None:
        """Return the status from the robot's gate (it checks every command); None if the gate does not answer."""
        try:
            answer = await self._ask(addresses.of(note.robot).gate, Gate, GetStatus(), ANSWER_S)
        except (AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, Status) else None

    async def stop(self, note: Note, reason: Reason, by: str, lock: bool = False) -> StopResult:
        """Make a robot safe. The request goes to the wire process, which talks to the robot. If it does not
        answer or refuses, the root process kills it and stops the robot over a separate path.

        Args:
            note: The robot.
            reason: The reason of the stop.
            by: The name of the sender, for the audit.
            lock: Lock the robot as an e-stop does.
        """
        actor_addresses, deadlines = addresses.of(note.robot), StopDeadlines.of(note.safe_s, note.late_s)
        try:
            answer = await self._ask(actor_addresses.gate, Gate, Stop(reason, by, lock), deadlines.gate_s)
        except (AskTimeout, Unreachable):
            answer = None
        # If the answer is a refusal, the robot is not stopped, as without an answer.
        if not isinstance(answer, StopReport):
            try:
                answer = await self._ask(
                    actor_addresses.guardian, Guardian, Fence(reason, by, lock), deadlines.root_s
                )
            except (AskTimeout, Unreachable) as failure:
                answer = busy.with_load(refusals.unconfirmed_stop(failure))
        return stop_result.of_answer(str(reason), answer, note.motors)

    async def resume(self, note: Note, by: str) -> Resumed | Refused:
        """Lift the lock of an e-stop, and energise the robot at the measured position."""
        try:
            answer = await self._ask(addresses.of(note.robot).gate, Gate, Resume(by), note.arm_s + RESUME_ROOM_S)
        except (AskTimeout, Unreachable) as failure:
            return refusals.resume_unanswered(failure)
        return read_answer(answer, Resumed)

    async def _ask(
        self, address: str, protocol: type[Actor], message: Message, deadline_s: float
    ) -> Message | None:
        """Send a request. Repeat it while the address is unknown, since connections come up shortly after
        ``join``.
        """
        ref = self._node.ref(address, protocol)
        while True:
            try:
                return await ref.ask(message, deadline_s)
            except Unreachable:
                if trio.current_time() > self._joined_at + JOIN_S:
                    raise
                await trio.sleep(0.005)


@contextlib.asynccontextmanager
async def join() -> AsyncIterator[Directory]:
    """Connect to every running robot of this user for the length of the block."""
    running = list(notes())
    # If no robot runs, there is nothing to connect to.
    if not running:
        yield Directory(Node("nobody", MonotonicClock()), running)
        return
    endpoints = [endpoint for note in running for endpoint in note.endpoints]
    async with open_node(f"visitor.{os.getpid()}", connect=endpoints) as (node, _):
        yield Directory(node, running)
