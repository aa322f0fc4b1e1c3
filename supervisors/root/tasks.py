"""Run named policies in separate processes. ``Tasks`` is the actor in the root process, ``main`` is what a policy
process runs."""

from __future__ import annotations

import os
import socket
from collections.abc import Awaitable, Callable, Mapping
from typing import Any

import msgspec
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.loading import load
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.processes.identity import take_name
from strands_actors.kernel.processes.limits import PolicyLimits
from strands_actors.kernel.processes.process import ChildProcess
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.deadlines import USUAL_SAFE_S, StopDeadlines
from strands_actors.supervisors.gate.gate import Gate
from strands_actors.supervisors.gate.lease import refuse_by_deadline
from strands_actors.supervisors.gate.messages import GetStatus, Stop, StopReport
from strands_actors.supervisors.introspection import Introspector
from strands_actors.supervisors.mesh import policy_access
from strands_actors.supervisors.policy import Policy
from strands_actors.supervisors.root.messages import (
    START_TASK,
    EpisodeKey,
    EpisodeState,
    Fence,
    GetTask,
    Happened,
    Operate,
    Rollout,
    StartTask,
    StopTask,
    TaskStatus,
)

from . import refusals
from .guardian import Guardian

STOP_S = 0.3
"""Longest end of a rollout. A policy process that takes longer is killed; a wire that has not held
the robot by then is fenced. A slow robot gets more time (``longer_s``)."""
LAST_WORDS_S = 0.05
"""Time for the last status to leave before the process exits."""


class Tasks(Actor):
    """Start and stop the policy process of a robot. At most one runs. When it ends, the gate is informed at once.

    Args:
        robot: Name of the robot.
        start: Starts a process with an entry and arguments.
        endpoint: Address on which the wire process accepts policies.
        label: Text for the name of the process in the system's list (see ``take_name``).
        safe_s: ``Timing.safe_s`` of the driver.
        limits: ``PolicyLimits`` as a mapping.
        audit: Writes a line of the audit.
        secret: The secret that a policy needs at ``endpoint``.
    """

    def __init__(
        self,
        robot: str,
        start: Callable[[str, dict[str, Any]], Awaitable[ChildProcess]],
        endpoint: str,
        label: str = "",
        safe_s: float = USUAL_SAFE_S,
        limits: Mapping[str, Any] | None = None,
        audit: Callable[[str, str, str, str], None] = lambda *_: None,
        secret: str = "",
    ) -> None:
        self._limits = dict(limits or {})
        self._audit = audit
        self._label = label
        self._robot = robot
        self._start_process = start
        self._endpoint, self._secret = endpoint, secret
        self._stop_s = STOP_S + StopDeadlines.of(safe_s).longer_s
        self.process: ChildProcess | None = None
        self.starts = 0
        self.status = TaskStatus()
        self._stopping = False
        self._is_actor = False
        self._ended_by = ""
        self._process_ended = trio.Event()

    async def started(self) -> None:
        actors = addresses.of(self._robot)
        self._gate: Ref = self.context.ref(actors.gate, Gate)
        self._guardian: Ref = self.context.ref(actors.guardian, Guardian)
        self._policy: Ref = self.context.ref(actors.policy, Policy)
        # The process was started before this actor failed and was restarted.
        if self.process is not None:
            self.context.start_soon(self._end, self.process)

    async def receive(
        self, message: StartTask | StopTask | GetTask | Operate | EpisodeKey | EpisodeState | TaskStatus
    ) -> TaskStatus | Refused | None:
        match message:
            case TaskStatus():
                self.status = message
            case Operate() | EpisodeState():
                if self.process is not None and self._is_actor:
                    self._policy.tell(message)
            case EpisodeKey():
                if self.process is not None and self._is_actor:
                    self.context.note(message)
            case GetTask():
                return self.status
            case StartTask():
                started = await self._start(message)
                if isinstance(started, Refused):
                    started = started.about(START_TASK)
                how = f"refused: {started.text}" if isinstance(started, Refused) else "started"
                self._audit("the holder of the lease", f"start_task {message.provider}", how, "")
                return started
            case StopTask():
                self._audit("the holder of the lease", "stop_task", "ordered", "")
                return await self._stop()
        return None

    async def _start(self, message: StartTask) -> TaskStatus | Refused:
        if self.process is not None:
            if self.status.running:
                return refusals.running_policy()
            if not await self._dismiss(self.process):
                return refusals.last_policy_not_ended()
        args = {
            "robot": self._robot,
            "label": self._label,
            "gate": self._endpoint,
            "secret": self._secret,
            "provider": message.provider,
            "options": message.options,
            "rollout": msgspec.to_builtins(message.rollout),
            "deadline_ns": message.deadline_ns,
            "is_actor": message.is_actor,
            "teleop": message.teleop,
            "limits": self._limits,
        }
        if (late := self._refuse_late(message)) is not None:
            return late
        try:
            process = await self._start_process("strands_actors.supervisors.root.tasks:main", args)
        except OSError as error:
            return refusals.policy_not_started(str(error))
        self.process = process
        self._is_actor = message.is_actor
        self.starts += 1
        self.context.note(Happened("the policy process was started", message.provider, process.pid))
        self._stopping = False
        self._ended_by = ""
        self._process_ended = trio.Event()
        late = self._refuse_late(message)
        if late is None:
            self.status = TaskStatus(running=True, instruction=message.rollout.instruction, teleop=message.teleop)
        else:
            process.kill()
        self.context.start_soon(self._attend, process)
        return late or self.status

    def end(self, cause: str) -> None:
        """Kill the policy process, for an e-stop."""
        if self.process is not None and not self._ended_by:
            self._ended_by = cause
            self.process.kill()

    def _refuse_late(self, message: StartTask) -> Refused | None:
        """Return a refusal if the deadline of the request has passed, since the sender was then answered that no
        policy was started."""
        if not message.deadline_ns:
            return None
        return refuse_by_deadline(message.deadline_ns, self.context.clock.now_ns())

    async def _dismiss(self, process: ChildProcess) -> bool:
        """End the process of a policy run that is finished. Return True if the process has ended."""
        if not await process.fence():
            return False
        await self._process_ended.wait()
        return True

    async def _attend(self, process: ChildProcess) -> None:
        async with trio.open_nursery() as nursery:
            channel = channels.of_policy(self._robot, f"policy process {process.pid}")
            nursery.start_soon(process.link(self.context.node, channel).run)
            code = await process.wait()
            nursery.cancel_scope.cancel()
        self._ended(process, code)

    async def _end(self, process: ChildProcess) -> None:
        """Wait until a policy process has ended, after its link was closed."""
        process.kill()
        self._ended(process, await process.wait())

    def _ended(self, process: ChildProcess, code: int) -> None:
        self.process = None
        how = f"signal {-code}" if code < 0 else f"code {code}"
        self.context.note(Happened("the policy process has ended", how, process.pid))
        if self.status.running:
            reason, detail = ("stopped", "") if self._stopping else ("policy", f"its process ended with {how}")
            if self._ended_by:
                reason, detail = "stop", self._ended_by
            self.status = msgspec.structs.replace(
                self.status, running=False, exit_reason=reason, exit_detail=detail
            )
            self._gate.tell(Stop(Reason.POLICY, detail or "the task was stopped"))
        self._process_ended.set()

    async def _stop(self) -> TaskStatus:
        process = self.process
        if process is None:
            return self.status
        self._stopping = True
        try:
            status = await self._policy.ask(StopTask(), self._stop_s)
        except (AskTimeout, Unreachable):
            status = None
        if isinstance(status, TaskStatus):
            self.status = status
        else:
            detail = "the policy did not answer" + await self._hold()
            self.status = msgspec.structs.replace(
                self.status, running=False, exit_reason="stopped", exit_detail=detail
            )
        await process.fence()
        return self.status

    async def _hold(self) -> str:
        """Make the robot hold because the policy process did not answer. Return a text to add to the status."""
        try:
            answer = await self._gate.ask(Stop(Reason.POLICY, "the task was stopped"), self._stop_s)
        except Unreachable:
            return "; the wire process has ended, so the root process stops the robot"
        except AskTimeout:
            answer = None
        if isinstance(answer, StopReport):
            return ""
        self._guardian.tell(Fence(Reason.POLICY, "the task was stopped"))
        return "; nor did the wire process, which is now killed"


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the policy process."""
    os.environ.pop("STRANDS_ACTORS_MESH", None)  # A policy must not learn where the mesh keys are.
    take_name(args["robot"], "policy", args["label"])
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    robot: str = args["robot"]
    actors = addresses.of(robot)
    node = Node(policy_access.node_name(robot, os.getpid()), MonotonicClock())
    rollout = msgspec.convert(args["rollout"], Rollout)
    tasks = node.ref(actors.tasks, Tasks)
    ended = trio.Event()

    def report(status: TaskStatus) -> None:
        tasks.tell(status)
        if not status.running:
            ended.set()

    def refuse(detail: str) -> None:
        report(
            TaskStatus(
                False,
                exit_reason="refused",
                exit_detail=detail,
                instruction=rollout.instruction,
                teleop=args["teleop"],
            )
        )

    def make() -> Any:
        return load(args["provider"])(**args["options"])

    def attend() -> Actor:
        if args["is_actor"]:
            actor: Actor = load(args["provider"])(rollout, report, **args["options"])
            return actor
        return Policy(rollout, make, report)

    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        # If the link to the root is closed, this process ends, too.
        link = Link(node, sock, on_closed=lambda: os._exit(0))
        await nursery.start(link.run)
        if 0 < args["deadline_ns"] <= node.clock.now_ns():
            refuse("its process began after the deadline of the request")
            await trio.sleep(LAST_WORDS_S)
            os._exit(0)
        mesh = await ZenohMesh.open(connect=[args["gate"]], secret=args["secret"])
        mesh.attach(node)
        await nursery.start(mesh.run)
        await _until_reachable(node, actors.gate)
        # Apply the limits only now. With another user id, or little memory, the process could not connect.
        try:
            msgspec.convert(args["limits"], PolicyLimits).apply()
        except (OSError, ValueError, KeyError) as error:
            refuse(f"policy_limits cannot be applied: {error}")
            await trio.sleep(LAST_WORDS_S)
            os._exit(0)
        nursery.start_soon(node.cell(actors.introspection("policy"), Introspector, "introspection").run)
        nursery.start_soon(node.cell(actors.path("policy"), attend).run)
        await ended.wait()
        await trio.sleep(LAST_WORDS_S)
        os._exit(0)


async def _until_reachable(node: Node, gate: str) -> None:
    ref = node.ref(gate, Gate)
    with trio.fail_after(5.0):
        while True:
            try:
                await ref.ask(GetStatus(), 0.5)
                return
            except (AskTimeout, Unreachable):
                await trio.sleep(0.01)
