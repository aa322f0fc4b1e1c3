"""The processes of one robot's tree, as their caller has them: the twin's, where there is one, and the root.

Started, asked what they are, ended. What is written to the robot, and by what right, is not decided here.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from typing import Any

import trio

from .descriptors import FOR_ROBOT, require
from .drill.certificate import TWIN, clause
from .engine import SIM, EngineDown
from .factory import Plan
from .rundir import Name, Note, locks_dir
from .runtime.contract import Reason
from .runtime.messages import Refused
from .runtime.node import AskTimeout, Node, Ref, Unreachable
from .runtime.process import ChildProcess, start
from .runtime.thread_line import ThreadLine
from .runtime.zenoh_mesh import unix_endpoint
from .strays import label_of
from .supervisors import addresses, channels
from .supervisors.failsafe import LINKED, Mode
from .supervisors.lines import keep_line, keep_thread_line
from .supervisors.loading import describe_driver
from .supervisors.messages import (
    Describe,
    GetMesh,
    GetStatus,
    OnMesh,
    Shutdown,
    Status,
    StopReport,
    TreeReport,
)

ASK_S = 0.5
STOP_S = 2.0
FENCE_S = 3.0
CONNECT_S = 12.0
LOOK_S = 0.02
"""Between two looks for a tree that starts. It has half a second to compute, which the looks should leave it."""


class NotConnected(Exception):
    """There is no tree, or it does not answer."""


def unreachable(verb: str, failure: Unreachable) -> Refused:
    return Refused("unreachable", f"{verb}: {failure}", "resume() when the robot is back")


class TreeProcesses:
    """All methods belong to the trio loop of ``nursery``. ``gate``, ``guardian``, ``root`` and ``tasks`` are the
    actors of the tree, once it was started."""

    def __init__(
        self, node: Node, nursery: trio.Nursery, endpoint: str, plan: Plan, by_threads: bool = False
    ) -> None:
        """``endpoint``: where ``node`` listens. ``by_threads``: threads other than the loop's command it, too."""
        self.node = node
        self.nursery = nursery
        self.plan = plan
        self.robot = plan.tool_name
        """The name it was given; from the first start on the one it could get."""
        self.holder = f"{plan.tool_name} in process {os.getpid()}"
        """What others read when they ask who has the robot."""
        self.facts: dict[str, Any] = {}
        """What the wire said of itself when it last answered."""
        self.closed = False
        self.thread_line: ThreadLine | None = None
        """To the gate, for any thread; None where there is none just now."""
        self._by_threads = by_threads
        self._endpoint = endpoint
        self._name: Name | None = None
        self._root_process: ChildProcess | None = None
        self._scope: trio.CancelScope | None = None

    @property
    def started(self) -> bool:
        return self._root_process is not None

    def require(self) -> None:
        """Raise ``NotConnected`` when there is no tree to ask."""
        self.require_open()
        if self._root_process is None:
            raise NotConnected("not connected. call connect_eagerly() first")

    def require_open(self) -> None:
        """Raise ``NotConnected`` when it is closed for good."""
        if self.closed:
            raise NotConnected("this robot was cleaned up. make a new one")

    # -- start and end

    async def start(self, beside: Callable[[], Awaitable[None]]) -> None:
        """``beside`` runs as long as the root does. Raise ``NotConnected`` when the twin does not start,
        ``OSError`` when the system does not let us."""
        require(FOR_ROBOT)
        plan = self.plan
        port = plan.port
        if plan.engine is not None:
            try:
                await plan.engine.start()
            except EngineDown as down:
                raise NotConnected(str(down)) from None
            port = plan.engine.door if plan.transport == SIM else plan.engine.port
        if self._name is None:
            self._name = Name(plan.tool_name)
            self.robot = self._name.name
        name = self._name
        listen, wire_listen, mesh = (unix_endpoint(name.socket(role)) for role in ("root", "wire", "mesh"))
        args = {
            "robot": self.robot,
            "driver": describe_driver(plan.driver_class, plan.robot, port, plan.options) | self._drill(port),
            "caller_pid": os.getpid(),
            "caller": self.node.address,
            "note": str(name.note),
            "twin_pid": 0 if plan.engine is None else plan.engine.pid,
            "locks": str(locks_dir()),
            "lock_port": "" if plan.engine is not None else port,
            "listen": listen,
            "wire_listen": wire_listen,
            "connect": [self._endpoint],
            "mesh": {
                "listen": [mesh, *plan.mesh.listens],
                "connect": plan.mesh.connects,
                "settings": plan.mesh.robot_settings(),
            },
        }
        entry = "strands_actors.supervisors.root:main"
        process = self._root_process = start(entry, args, [name.lock_fd], label_of(self.robot))
        name.publish(Note(self.robot, plan.robot, process.pid, [listen, wire_listen], [mesh]))
        # Whom this one talks to is imported while the root does so, too: a third of what a script would wait for.
        from .supervisors.gate import Gate
        from .supervisors.guardian import Guardian
        from .supervisors.root import Root
        from .supervisors.tasks import Tasks

        node, at = self.node, addresses.of(self.robot)
        self.gate: Ref = node.ref(at.gate, Gate, sender=f"{node.address}/{self.robot}")
        self.guardian: Ref = node.ref(at.guardian, Guardian)
        self.root: Ref = node.ref(at.root, Root)
        self.tasks: Ref = node.ref(at.tasks, Tasks)
        self._scope = trio.CancelScope()
        besides: list[Callable[[], Awaitable[None]]] = [
            beside,
            partial(keep_line, node, self.robot, channels.of_wire(self.robot)),
        ]
        if self._by_threads:
            besides.append(partial(keep_thread_line, node, self.robot, Gate, self._take_line))
        self.nursery.start_soon(self._attend, process, self._scope, besides)

    def _take_line(self, line: ThreadLine | None) -> None:
        self.thread_line = line

    def _drill(self, port: str) -> dict[str, Any]:
        """For the gate: whether a stop drill is required, and was passed."""
        plan = self.plan
        if plan.drill_age_s is None:
            return {}
        at = TWIN if plan.transport == "twin" else port
        return {"drill": clause(plan.driver_class, plan.robot, at, plan.options, plan.drill_age_s)}

    async def _attend(
        self, process: ChildProcess, scope: trio.CancelScope, besides: Iterable[Callable[[], Awaitable[None]]]
    ) -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(process.link(self.node, channels.of_root(self.robot)).run)
                for each in besides:
                    nursery.start_soon(each)
                await process.wait()
                nursery.cancel_scope.cancel()

    async def end(self) -> StopReport | None:
        """Make safe and end. The report, or None when nothing was running."""
        process = self._root_process
        report: StopReport | None = None
        if process is not None:
            # A root that does not answer is fenced at once; the wire then makes itself safe.
            if await self.describe() is not None:
                with contextlib.suppress(AskTimeout, Unreachable):
                    answer = await self.root.ask(Shutdown(Reason.CLEANUP, self.holder), FENCE_S)
                    report = answer if isinstance(answer, StopReport) else None
                if report is not None and not report.confirmed:
                    self._part(process)
                else:
                    with trio.move_on_after(FENCE_S):
                        await process.wait()
            await self.discard()
        if self._name is not None:
            self._name.release()
            self._name = None
        return report

    def _part(self, process: ChildProcess) -> None:
        """A root whose robot is not confirmed safe stays, and tries, without us."""
        process.part()
        self._root_process = None

    async def fence(self) -> None:
        """Kill the root, and wait for it. Without its root the wire makes itself safe."""
        if self._root_process is not None:
            await self._root_process.fence()

    async def discard(self) -> None:
        """Fence the root and forget it: the next one is started anew."""
        await self.fence()
        if self._scope is not None:
            self._scope.cancel()
        self._root_process = None

    # -- what they are

    async def wait_linked(self, patience_s: float = 0.0) -> Status:
        """``patience_s``: how long to wait for a link that was lost. Raise ``NotConnected``."""
        began = trio.current_time()
        deadline = began + CONNECT_S
        status: Status | None = None
        while trio.current_time() < deadline:
            assert self._root_process is not None
            if not self._root_process.alive:
                raise NotConnected("the root process ended")
            try:
                answer = await self.gate.ask(GetStatus(), ASK_S)
            except (AskTimeout, Unreachable):
                await trio.sleep(LOOK_S)
                continue
            assert isinstance(answer, Status)
            status = answer
            if status.mode in LINKED and status.mode != Mode.STOPPING:
                return status
            lost = status.connect_error and status.connect_error != "not connected yet"
            if lost and trio.current_time() >= began + patience_s:
                raise NotConnected(status.connect_error)
            await trio.sleep(0.01)
        raise NotConnected(f"no answer within {CONNECT_S:g} s" if status is None else status.connect_error)

    async def require_mesh(self) -> None:
        """A robot that was to be reached from elsewhere and is not has not been started."""
        try:
            answer = await self.root.ask(GetMesh(), CONNECT_S)
        except (AskTimeout, Unreachable) as failure:
            raise NotConnected(f"the root does not say whether it is on the mesh: {failure}") from failure
        if isinstance(answer, OnMesh) and answer.problem:
            raise NotConnected(answer.problem)

    async def status(self) -> Status | None:
        """None when the wire does not answer."""
        if self._root_process is None:
            return None
        try:
            answer = await self.gate.ask(GetStatus(), 0.1)
        except (AskTimeout, Unreachable):
            return None
        if not isinstance(answer, Status):
            return None
        self.facts |= answer.facts
        return answer

    async def describe(self) -> TreeReport | None:
        """Processes and actors of the tree; None when the root does not answer."""
        if self._root_process is None:
            return None
        try:
            answer = await self.root.ask(Describe(), ASK_S)
        except (AskTimeout, Unreachable):
            return None
        return answer if isinstance(answer, TreeReport) else None

    async def answers(self) -> bool:
        """Whether the root lives and still keeps a wire; once its restart budget is spent only a new tree helps."""
        process = self._root_process
        if process is None or not process.alive:
            return False
        report = await self.describe()
        return report is not None and report.state != Mode.FAILED
