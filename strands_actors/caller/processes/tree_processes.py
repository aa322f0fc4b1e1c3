"""Start, ask and end the processes of one robot's tree on this host: the twin, if there is one, and the
root."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import unix_endpoint
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.heartbeat import new_page, words_of
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Ref, Unreachable
from strands_actors.kernel.processes.process import ChildProcess, start, wait_for_end_of
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses, stop_result
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import RESUME, Lease, StopReport
from strands_actors.supervisors.loading import describe_driver
from strands_actors.supervisors.page import Owed
from strands_actors.supervisors.root.messages import Describe, Fence, GetMesh, OnMesh, Shutdown, TreeReport
from strands_actors.supervisors.standby.report import LOCK, REPORT
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.drill.certificate import TWIN, clause

from . import process_one
from .descendants import complete
from .descriptors import FOR_ROBOT, require
from .last_standby import until_over
from .nodes import Entrance
from .plan import Plan
from .port_claim import claim_port, place
from .robot_processes import CONNECT_S, NotConnected, Processes
from .run_directory import Name, Note, audit_file, locks_dir
from .strays import label_of
from .twin_process import SIM, TwinProcessDown

NOTE_S = 0.01
"""Period of the check of the shared page, on which wire and standby note that motors may be energised."""


class TreeProcesses(Processes):
    """The processes of one robot on this host. After ``start`` it has references to the actors
    ``guardian``, ``root`` and ``tasks`` of the tree.

    Args:
        node: The caller's node.
        nursery: Tasks run in it.
        entrance: The address at which ``node`` listens.
        plan: The processes to start.
        driver: The driver of the robot.
    """

    def __init__(self, node: Node, nursery: trio.Nursery, entrance: Entrance, plan: Plan, driver: Driver) -> None:
        super().__init__(node, nursery, plan, driver)
        self._entrance = entrance
        self._name: Name | None = None
        self._root_process: ChildProcess | None = None
        self._scope: trio.CancelScope | None = None
        self._owed = Owed()
        """The shared page on which the processes of the tree note that motors may be energised."""

    @property
    def started(self) -> bool:
        return self._root_process is not None

    @property
    def alive(self) -> bool:
        return self._root_process is not None and self._root_process.alive

    # -- start and end

    async def start(self, beside: Callable[[], Awaitable[None]]) -> None:
        """Start the twin, then the root.

        Args:
            beside: A task that runs as long as the root.

        Raises:
            NotConnected: The twin does not start, or another tree has the port.
            OSError: The system allows too few open files, or no process.
        """
        require(FOR_ROBOT)
        self.require_open()
        plan = self.plan
        port = plan.port
        if plan.twin_process is not None:
            try:
                await plan.twin_process.start()
            except TwinProcessDown as down:
                raise NotConnected(str(down)) from None
            self.require_open()
            port = plan.twin_process.control if plan.transport == SIM else plan.twin_process.port
        if self._name is None:
            self._name = Name(plan.tool_name)
            self.robot = self._name.name
        if plan.mesh.listens or plan.mesh.connects:
            try:
                plan.mesh.check_robot(self.robot)
            except (ValueError, OSError) as error:
                raise NotConnected(str(error)) from None
        where = "" if plan.twin_process is not None else place(plan)
        claim = None if plan.twin_process is not None else await claim_port(plan, self.robot)
        try:
            self.require_open()
            report = await until_over(self.robot, where)
            if report is not None:
                self.standby_report = report
            self.require_open()
            self._begin(port, where, () if claim is None else (claim.fd,), beside)
        finally:
            if claim is not None:
                claim.close()  # The root has inherited the lock, and keeps it as long as it lives.

    def _begin(self, port: str, where: str, hold: tuple[int, ...], beside: Callable[[], Awaitable[None]]) -> None:
        """Start the root. Nothing in here waits, so a cleanup comes either before it, or after it and then
        finds the root.

        Args:
            port: The port of the robot or of its twin.
            where: The place of the robot (``port_claim.place``); empty for a twin.
            hold: Descriptors that the root inherits in addition to the lock of its name.
            beside: As in ``start``.
        """
        plan, name = self.plan, self._name
        assert name is not None
        own = "" if plan.twin_process is not None else port
        if plan.twin_process is None:
            process_one.warn_once()
        roles = ("root", "wire", "policy", "mesh")
        listen, wire_listen, policy_listen, mesh = (unix_endpoint(name.socket(role)) for role in roles)
        args = {
            "robot": self.robot,
            "driver": describe_driver(plan.driver_class, plan.robot, port, plan.options) | self._drill(port),
            "caller_pid": os.getpid(),
            "caller": self.node.address,
            "note": str(name.note),
            "twin_pid": 0 if plan.twin_process is None else plan.twin_process.pid,
            "locks": str(locks_dir()),
            "audit": str(audit_file(self.robot)),
            "lock_port": own,
            "listen": listen,
            "label": label_of(self.robot),
            "standby": {
                "lock": str(name.beside(LOCK)),
                "report": str(name.beside(REPORT)),
                "place": where,
            },
            "wire_listen": wire_listen,
            "policy_listen": policy_listen,
            "policy_limits": msgspec.to_builtins(plan.policy_limits),
            "connect": [self._entrance.endpoint],
            "secret": self._entrance.secret,
            "cameras": self._begin_cameras(port),
            "mesh": {
                "listen": [mesh, *plan.mesh.listens],
                "connect": plan.mesh.connects,
                "settings": plan.mesh.robot_settings(),
            },
        }
        entry = "strands_actors.supervisors.root.process:main"
        page = new_page()
        try:
            process = start(entry, args, [name.lock_fd, *hold], label_of(self.robot), [page])
            self._owed = Owed(words_of(page))
        finally:
            os.close(page)
        name.publish(
            Note(
                self.robot,
                plan.robot,
                process.pid,
                [listen, wire_listen],
                [mesh],
                safe_s=self.driver.timing.safe_s,
                late_s=self.driver.late_s,
                arm_s=self.driver.timing.arm_s,
                motors=list(self.driver.axes),
                port=own,
            )
        )
        # These imports run while the root imports the same modules. Before the start of the root they
        # would add a third to the time that a script waits.
        from strands_actors.supervisors.gate.gate import Gate
        from strands_actors.supervisors.root.guardian import Guardian
        from strands_actors.supervisors.root.process import Root
        from strands_actors.supervisors.root.tasks import Tasks

        node, at = self.node, addresses.of(self.robot)
        self.gate: Ref = node.ref(at.gate, Gate, sender=f"{node.address}/{self.robot}")
        self.guardian: Ref = node.ref(at.guardian, Guardian)
        self.root: Ref = node.ref(at.root, Root)
        self.tasks: Ref = node.ref(at.tasks, Tasks)
        self._scope = trio.CancelScope()
        # The link is made here and not in the task. If the root is fenced before the task begins, the task
        # finds a closed link. A closed socket would end the loop of every robot of this program.
        link = process.link(node, channels.of_root(self.robot))
        # This comes last: with it other threads decide whether they can ask the tree.
        self._root_process = process
        self.nursery.start_soon(self._attend, process, link, self._scope, beside)

    def _begin_cameras(self, port: str) -> list[dict[str, Any]]:
        """Return the data with which the root starts the cameras' processes."""
        plan, twin = self.plan, self.plan.twin_process
        control = "" if twin is None else twin.control
        return self.cameras.begin(self.robot, plan.robot, label_of(self.robot), port, control, plan.options)

    def _drill(self, port: str) -> dict[str, Any]:
        """Return the gate's option for a required stop drill; {} if no drill is required."""
        plan = self.plan
        if plan.drill_age_s is None:
            return {}
        place_name = TWIN if plan.transport == "twin" else port
        return {"drill": clause(plan.driver_class, plan.robot, place_name, plan.options, plan.drill_age_s)}

    async def _attend(
        self,
        process: ChildProcess,
        link: Link,
        scope: trio.CancelScope,
        beside: Callable[[], Awaitable[None]],
    ) -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(link.run)
                nursery.start_soon(beside)
                await process.wait()
                nursery.cancel_scope.cancel()

    async def end(self, lease: Lease | None) -> StopResult:
        process = self._root_process
        result: StopResult = stop_result.Confirmed(stop_result.NothingRan())
        if process is not None:
            result = await self._end_root(process)
            self.cameras.end()
        if self._name is not None:
            self._name.release()
            self._name = None
        return result

    async def _end_root(self, process: ChildProcess) -> StopResult:
        """Ask the root to make the robot safe and end. A root that does not answer is fenced at once; the
        wire then stops the robot."""
        answer: Message | None = None
        why: object = "the root process does not answer, and was ended"
        if await self.describe() is not None:
            try:
                answer = await self.root.ask(Shutdown(Reason.CLEANUP, self.holder), self.deadlines.end_s)
            except (AskTimeout, Unreachable) as failure:
                why = f"the root process gave no report ({failure})"
        match answer:
            case StopReport(confirmed=False):
                self._part(process)
            case StopReport():
                with trio.move_on_after(self.deadlines.end_s):
                    await process.wait()
        await self._discard()
        if isinstance(answer, StopReport):
            return stop_result.of_report(answer)
        return await self._await_note("cleanup", why)

    async def _await_note(self, verb: str, why: object) -> StopResult:
        """Return the result of a stop after the root has ended without a report. Wire and standby make the
        robot safe, and note on the shared page that every motor has confirmed it."""
        owed = self._owed
        with trio.move_on_after(self.deadlines.attempt_s):
            if owed.wire_pid:
                await wait_for_end_of(owed.wire_pid)
            while owed.safe_state:  # noqa: ASYNC110  # another process writes it
                await trio.sleep(NOTE_S)
            safe_state = self.driver.fallbacks[Reason.ROOT]
            return stop_result.Confirmed(StopReport(Reason.ROOT, safe_state, 0, True, ()))
        left = "what is left of it tries for a minute. look at the robot, and cut its power if it still moves"
        return stop_result.silent(verb, busy.explained(str(why)), self.driver, left, Code.UNCONFIRMED)

    def _part(self, process: ChildProcess) -> None:
        """Let the root continue without this caller. It goes on trying to make the robot safe."""
        process.part()
        self._root_process = None

    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        """Ask the root to fence the wire and to stop the robot by its own stop channel. If the root does not
        answer, fence the root."""
        try:
            answer = await self.guardian.ask(Fence(reason, by, lock), self.deadlines.root_s)
        except (AskTimeout, Unreachable) as failure:
            # Neither the wire nor the root answers. A wire without a root stops the robot by itself.
            await self._fence()
            why = f"neither wire nor root answers ({failure}); the root was ended"
            return await self._await_note("stop", why)
        return stop_result.of_answer("stop", answer, self.driver.axes)

    async def late(self, verb: str, timeout: AskTimeout) -> Refused:
        """Fence the wire, stop the robot, and return the refusal of the verb."""
        why = busy.explained(str(timeout))
        result = await self.make_safe(Reason.WIRE, f"{verb} timed out", False)
        return stop_result.timed_out(why, result, "the robot was stopped", "resume()").about(verb)

    async def revive(self, lift: bool, beside: Callable[[], Awaitable[None]]) -> Refused | None:
        if await self._answers():
            return None
        if not lift:  # The robot may have been locked, and the tree can no longer tell.
            remedy = "an operator's resume() starts it again"
            return Refused(Code.NOT_CONNECTED, "the tree does not answer", remedy, verb=RESUME)
        if self.started:
            await self._discard()
        await self.start(beside)
        return None

    async def _fence(self) -> None:
        """Kill the root and wait for its end. A wire without a root stops the robot by itself."""
        if self._root_process is not None:
            await self._root_process.drop()

    async def _discard(self) -> None:
        """Fence the root and forget it, so that another one can be started."""
        await self._fence()
        if self._scope is not None:
            self._scope.cancel()
        self._root_process = None

    # -- the state of the tree

    async def require_mesh(self) -> None:
        try:
            answer = await self.root.ask(GetMesh(), CONNECT_S)
        except (AskTimeout, Unreachable) as failure:
            raise NotConnected(f"the root does not say whether it is on the mesh: {failure}") from failure
        if isinstance(answer, OnMesh) and answer.problem:
            raise NotConnected(answer.problem)

    async def describe(self) -> TreeReport | None:
        if self._root_process is None:
            return None
        try:
            answer = await self.root.ask(Describe(), self.patience.ask_s)
        except (AskTimeout, Unreachable):
            return None
        return complete(answer) if isinstance(answer, TreeReport) else None

    async def _answers(self) -> bool:
        """Return True if the root answers and still restarts its wire. If its restart budget is spent, a new
        tree is needed."""
        process = self._root_process
        if process is None or not process.alive:
            return False
        report = await self.describe()
        return report is not None and report.state != Mode.FAILED
