"""Connect a robot handle to a robot of this user that a host keeps (``strands-actors up``).

The handle has the rights of the script that started a robot, except that it cannot end the robot's processes. It
talks to the gate directly, as that script would. If this program ends, the host's robot goes to its safe state for
a lost writer, and its processes run on.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Awaitable, Callable
from typing import Any

import trio
import zenoh

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.channels.zenoh_session import short
from strands_actors.kernel.health import busy
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.process import exists, wait_for_end_of
from strands_actors.supervisors import addresses, stop_result
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.messages import RESUME, Stop
from strands_actors.supervisors.root.guardian import Guardian
from strands_actors.supervisors.root.messages import AttachProgram, Describe, Fence, Hosted, TreeReport
from strands_actors.supervisors.root.process import Root
from strands_actors.supervisors.root.tasks import Tasks
from strands_actors.supervisors.stop_result import StopResult

from . import refusals
from .descendants import complete
from .nodes import open_node
from .plan import Plan
from .robot_processes import NotConnected
from .run_directory import Note, is_running, notes
from .session_processes import SessionProcesses

REACH_S = 5.0
"""How long the root of a running robot may take to answer, on a busy computer."""
LOOK_S = 0.2
"""Period of the check if a robot in another container still runs."""


class AttachedProcesses(SessionProcesses):
    """A connection to the processes of a robot that a host keeps.

    Args:
        nursery: Tasks of the connection run in it.
        plan: The robot (``resolve/attached.py``).
        driver: The driver of the robot.
    """

    def __init__(self, nursery: trio.Nursery, plan: Plan, driver: Driver) -> None:
        super().__init__(f"caller.{os.getpid()}.{secrets.token_hex(4)}", nursery, plan, driver)
        self._note = Note(plan.tool_name, plan.robot, 0, [])

    @property
    def alive(self) -> bool:
        return self.started

    async def start(self, background: Callable[[], Awaitable[None]]) -> None:
        self._note = note = note_of(self.robot)
        try:
            session = await ZenohMesh.open(connect=note.endpoints)
        except zenoh.ZError as error:
            raise NotConnected(f"{self.robot} cannot be reached: {short(error)}") from error
        session.attach(self.node)
        session.serve_threads()
        node, actors = self.node, addresses.of(self.robot)
        self.gate: Ref = node.ref(actors.gate, Gate, sender=f"{node.address}/{self.robot}")
        self._guardian: Ref = node.ref(actors.guardian, Guardian)
        self._root: Ref = node.ref(actors.root, Root)
        self.tasks: Ref = node.ref(actors.tasks, Tasks)
        await self._join(session, background, self._watch)

    async def _reach(self) -> None:
        settings = await _attach(self._root, self.robot, os.getpid())
        description = settings["driver"]
        if description["robot"] != self.driver.robot or description["options"] != self.plan.options:
            raise NotConnected(
                f"{self.robot} was changed since this handle was made. Make a new one: Robot(..., attach=True)"
            )
        self.cameras.join(self.robot)

    async def _watch(self) -> None:
        """Leave when the robot's root process has ended, so that the next connect joins its successor."""
        if exists(self._note.pid):
            await wait_for_end_of(self._note.pid)
        else:
            while is_running(self.robot):  # noqa: ASYNC110  # the process is not visible here
                await trio.sleep(LOOK_S)
        self._leave()

    def _leave(self) -> None:
        super()._leave()
        self.cameras.leave()

    async def _stop_unanswered(self, stop: Stop, failure: Exception) -> StopResult:
        return await self.make_safe(stop.reason, stop.by, stop.lock)

    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        """Ask the root process to kill the wire process, and to stop the robot over its own stop channel."""
        try:
            answer = await self._guardian.ask(Fence(reason, by, lock), self.deadlines.root_s)
        except (AskTimeout, Unreachable) as failure:
            return stop_result.silent("stop", busy.explained(str(failure)), self.driver)
        return stop_result.of_answer("stop", answer, self.driver.axes)

    async def cancel_late_request(self, verb: str, timeout: AskTimeout) -> Refused:
        """Stop the robot so that a late request has no effect, and return the refusal of the verb."""
        reason = busy.explained(str(timeout))
        result = await self.make_safe(Reason.WIRE, f"{verb} timed out", False)
        return stop_result.timed_out(reason, result, "the robot was stopped", "resume()").about(verb)

    async def revive(self, lift: bool, background: Callable[[], Awaitable[None]]) -> Refused | None:
        if self.started:
            return None
        # The host may have locked the robot meanwhile. Only an operator's resume may find out by trying.
        if not lift:
            return refusals.silent_processes(RESUME)
        await self.start(background)
        return None

    async def describe(self) -> TreeReport | None:
        if not self.started:
            return None
        try:
            answer = await self._root.ask(Describe(), self.patience.ask_s)
        except (AskTimeout, Unreachable):
            return None
        return complete(answer) if isinstance(answer, TreeReport) else None


def note_of(robot: str) -> Note:
    """Return the note of a robot that a host keeps. Raise ``NotConnected`` if there is none."""
    running = list(notes())
    for note in running:
        if note.robot == robot and note.host:
            return note
        if note.robot == robot:
            raise NotConnected(
                f"{robot} was started by a script, and only this script has it. To share it, let a host keep it: "
                "strands-actors up"
            )
    kept = ", ".join(note.robot for note in running if note.host) or "none"
    raise NotConnected(
        f"no host of this user keeps a robot {robot} now. Robots of a host: {kept}. "
        "`strands-actors status` has the reason of one that does not run"
    )


async def hosted_settings(robot: str) -> dict[str, Any]:
    """Return the settings that a host gives to handles of a robot. Raise ``NotConnected`` if it does not answer."""
    note = note_of(robot)
    async with open_node(f"visitor.{os.getpid()}.{secrets.token_hex(4)}", connect=note.endpoints) as (node, _):
        return await _attach(node.ref(addresses.of(robot).root, Root), robot, 0)


async def _attach(root: Ref, robot: str, pid: int) -> dict[str, Any]:
    failure = "its root process does not answer"
    with trio.move_on_after(REACH_S):
        while True:
            try:
                answer = await root.ask(AttachProgram(pid), 1.0)
            except (AskTimeout, Unreachable) as error:
                failure = str(error)
                await trio.sleep(0.005)
                continue
            if isinstance(answer, Hosted):
                return answer.settings
            raise NotConnected(answer.text if isinstance(answer, Refused) else failure)
    raise NotConnected(busy.explained(f"{robot} does not answer: {failure}"))
