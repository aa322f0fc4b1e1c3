"""Start, ask and end the processes of one robot on this host.

This module starts the root process, which starts the others, and the process of a simulated robot, if there is
one.
"""

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
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.messages import (
    Describe,
    Fence,
    GetMesh,
    GetState,
    OnMesh,
    Shutdown,
    StateIs,
    TreeReport,
)
from strands_actors.supervisors.standby.report import LOCK, REPORT
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.drill.certificate import TWIN, clause

from . import process_one, refusals
from .descendants import complete
from .descriptors import FOR_ROBOT, require
from .last_standby import until_over
from .leftovers import PAGE
from .nodes import Entrance
from .plan import Plan
from .port_claim import claim_port, port_identity
from .robot_processes import CONNECT_S, NotConnected, Processes
from .run_directory import Name, NameTaken, Note, audit_file, locks_dir
from .strays import label_of
from .twin_process import SIM, TwinProcessDown

NOTE_S = 0.01
"""Period of the check of the shared page, on which wire and standby note that motors may be energised."""


class TreeProcesses(Processes):
    """The processes of one robot on this host. After ``start`` it has references to the robot's actors
    ``guardian`` (stops the robot if the gate does not), ``root`` and ``tasks``.

    Args:
        node: The caller's node (the actors of its process).
        nursery: The nursery for the tasks of this object.
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
        self._safety_page = SafetyPage()
        """The shared page on which the processes of the tree note that motors may be energised."""

    @property
    def started(self) -> bool:
        return self._root_process is not None

    @property
    def alive(self) -> bool:
        return self._root_process is not None and self._root_process.alive

    # -- start and end of the processes

    async def start(self, background: Callable[[], Awaitable[None]]) -> None:
        """Start the simulated robot, if there is one, then the root process.

        Args:
            background: An async function to run as long as the root process, such as sending heartbeats.

        Raises:
            NotConnected: The simulated robot does not start, or another robot uses the port.
            OSError: The system allows too few open files, or no further process.
        """
        require(FOR_ROBOT)
        self.require_open()
        plan = self.plan
        if self._name is None:
            try:
                self._name = Name(plan.tool_name, exact=plan.hosted is not None or plan.is_part)
            except NameTaken as taken:
                raise NotConnected(str(taken)) from None
            self.robot = self._name.name
        port = await self._start_hardware()
        self.require_open()
        if plan.mesh.listens or plan.mesh.connects:
            try:
                plan.mesh.check_robot(self.robot)
            except (ValueError, OSError) as error:
                raise NotConnected(str(error)) from None
        has_port = plan.twin_process is None and not plan.parts
        identity = port_identity(plan) if has_port else ""
        claim = await claim_port(plan, self.robot) if has_port else None
        try:
            self.require_open()
            report = await until_over(self.robot, identity)
            if report is not None:
                self.standby_report = report
            self.require_open()
            self._begin(port, identity, () if claim is None else (claim.fd,), background)
        finally:
            if claim is not None:
                claim.close()  # The root has inherited the lock, and keeps it as long as it lives.

    async def _start_hardware(self) -> str:
        """Start what stands in for the hardware, if anything does, and return the port of the robot."""
        twin = self.plan.twin_process
        if twin is None:
            return self.plan.port
        try:
            await twin.start()
        except TwinProcessDown as down:
            raise NotConnected(str(down)) from None
        return twin.control if self.plan.transport == SIM else twin.port

    def _begin(
        self, port: str, identity: str, hold: tuple[int, ...], background: Callable[[], Awaitable[None]]
    ) -> None:
        """Start the root process.

        Nothing in here waits. So a cleanup runs either before it, or after it and then finds the root process.

        Args:
            port: The port of the robot or of its simulation.
            identity: Identifies the port (``port_claim.port_identity``); empty for a simulated robot.
            hold: Descriptors that the root inherits in addition to the lock of its name.
            background: As in ``start``.
        """
        plan, name = self.plan, self._name
        assert name is not None
        own = "" if plan.twin_process is not None or plan.parts else port
        if plan.twin_process is None:
            process_one.warn_once()
        roles = ("root", "wire", "policy", "mesh")
        listen, wire_listen, policy_listen, mesh = (unix_endpoint(name.socket(role)) for role in roles)
        driver = describe_driver(plan.driver_class, plan.robot, port, plan.options)
        args = {
            "robot": self.robot,
            "driver": driver | self._drill(port),
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
                "lock": str(name.path_with_suffix(LOCK)),
                "report": str(name.path_with_suffix(REPORT)),
                "place": identity,
            },
            "wire_listen": wire_listen,
            "policy_listen": policy_listen,
            "policy_limits": msgspec.to_builtins(plan.policy_limits),
            "connect": [self._entrance.endpoint],
            "secret": self._entrance.secret,
            "cameras": self._begin_cameras(port),
            "hosted": self._hosted(driver) if plan.is_part or plan.hosted is not None else None,
            "is_part": plan.is_part,
            "mesh": {
                "listen": [mesh, *plan.mesh.listens],
                "connect": plan.mesh.connects,
                "settings": plan.mesh.robot_settings(),
            },
        }
        entry = "strands_actors.supervisors.root.process:main"
        page = new_page(name.path_with_suffix(PAGE) if plan.is_part else None)
        try:
            process = start(entry, args, [name.lock_fd, *hold], label_of(self.robot), [page])
            self._safety_page = SafetyPage(words_of(page))
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
                host=0 if plan.hosted is None else os.getpid(),
            )
        )
        # Import these modules while the root process imports the same ones. Imported before its start, they
        # would make a script wait a third longer.
        from strands_actors.supervisors.gate.gate import Gate
        from strands_actors.supervisors.root.guardian import Guardian
        from strands_actors.supervisors.root.process import Root
        from strands_actors.supervisors.root.tasks import Tasks

        node, actor_addresses = self.node, addresses.of(self.robot)
        self.gate: Ref = node.ref(actor_addresses.gate, Gate, sender=f"{node.address}/{self.robot}")
        self.guardian: Ref = node.ref(actor_addresses.guardian, Guardian)
        self.root: Ref = node.ref(actor_addresses.root, Root)
        self.tasks: Ref = node.ref(actor_addresses.tasks, Tasks)
        self._scope = trio.CancelScope()
        # Make the link here and not in the task. If the root process is killed before the task begins, the task
        # must find a closed link. A closed socket would raise an error that ends the loop of every robot in
        # this program.
        link = process.link(node, channels.of_root(self.robot))
        # Set this last. Other threads read it to decide whether they can ask the robot.
        self._root_process = process
        self.nursery.start_soon(self._attend, process, link, self._scope, background)

    def _begin_cameras(self, port: str) -> list[dict[str, Any]]:
        """Return the data with which the root process starts the processes of the cameras."""
        plan, twin = self.plan, self.plan.twin_process
        control = "" if twin is None else twin.control
        return self.cameras.begin(self.robot, plan.robot, label_of(self.robot), port, control, plan.options)

    def _hosted(self, driver: dict[str, Any]) -> dict[str, Any]:
        """Return the settings that the root process gives to the programs that attach themselves to the robot."""
        plan = self.plan
        return {
            "driver": driver,
            "cameras": [msgspec.to_builtins(camera) for camera in plan.cameras],
            "data_config": plan.data_config,
            "lifetime_s": plan.lifetime_s,
            "transport": plan.transport if plan.is_simulated else None,
            **(plan.hosted or {}),
        }

    def _drill(self, port: str) -> dict[str, Any]:
        """Return the option by which the gate refuses motion without a recent stop drill (a test that faults stop
        the robot); {} if it needs no drill.
        """
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
        background: Callable[[], Awaitable[None]],
    ) -> None:
        with scope:
            async with trio.open_nursery() as nursery:
                nursery.start_soon(link.run)
                nursery.start_soon(background)
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
        """Ask the root process to make the robot safe and to end.

        If it does not answer, kill it at once. The wire process, which talks to the robot, then stops the
        robot.
        """
        answer: Message | None = None
        reason: object = "the root process does not answer, and was ended"
        if await self.describe() is not None:
            try:
                answer = await self.root.ask(Shutdown(Reason.CLEANUP, self.holder), self.deadlines.end_s)
            except (AskTimeout, Unreachable) as failure:
                reason = f"the root process gave no report ({failure})"
        match answer:
            case StopReport(confirmed=False):
                self._detach(process)
            case StopReport():
                with trio.move_on_after(self.deadlines.end_s):
                    await process.wait()
        await self._discard()
        if isinstance(answer, StopReport):
            return stop_result.of_report(answer)
        return await self._await_note("cleanup", reason)

    async def _await_note(self, verb: str, reason: object) -> StopResult:
        """Return the result of a stop after the root process has ended without a report.

        The wire or the standby process makes the robot safe. It then notes on the page of shared memory that
        every motor has confirmed it.
        """
        page = self._safety_page
        with trio.move_on_after(self.deadlines.attempt_s):
            if page.wire_pid:
                await wait_for_end_of(page.wire_pid)
            while page.may_be_energised:  # noqa: ASYNC110  # another process writes it
                await trio.sleep(NOTE_S)
            safe_state = self.driver.fallbacks[Reason.ROOT]
            return stop_result.Confirmed(StopReport(Reason.ROOT, safe_state, 0, True, ()))
        remedy = "what is left of it tries for a minute. Look at the robot, and cut its power if it still moves"
        return stop_result.silent(verb, busy.explained(str(reason)), self.driver, remedy, Code.UNCONFIRMED)

    def _detach(self, process: ChildProcess) -> None:
        """Let the root process run on without this program. It keeps trying to make the robot safe."""
        process.detach()
        self._root_process = None

    async def make_safe(self, reason: Reason, by: str, lock: bool) -> StopResult:
        """Ask the root process to kill the wire process, and to stop the robot over its own stop channel.

        If the root process does not answer, kill it.
        """
        try:
            answer = await self.guardian.ask(Fence(reason, by, lock), self.deadlines.root_s)
        except (AskTimeout, Unreachable) as failure:
            # Neither the wire process nor the root process answers. Kill the root, since a wire process without
            # a root stops the robot by itself.
            await self._fence()
            explanation = f"neither the wire process nor the root process answers ({failure})"
            return await self._await_note("stop", explanation)
        return stop_result.of_answer("stop", answer, self.driver.axes)

    async def cancel_late_request(self, verb: str, timeout: AskTimeout) -> Refused:
        """Stop the robot so that a late request has no effect, and return the refusal of the verb.

        The root process kills the wire process first.
        """
        reason = busy.explained(str(timeout))
        result = await self.make_safe(Reason.WIRE, f"{verb} timed out", False)
        return stop_result.timed_out(reason, result, "the robot was stopped", "resume()").about(verb)

    async def revive(self, lift: bool, background: Callable[[], Awaitable[None]]) -> Refused | None:
        if await self._answers():
            return None
        # The robot may have been locked by an e-stop. The processes that stored this lock have ended.
        if not lift:
            return refusals.silent_processes(RESUME)
        if self.started:
            await self._discard()
        await self.start(background)
        return None

    async def _fence(self) -> None:
        """Kill the root process and wait for its end. A wire process without a root stops the robot by itself."""
        if self._root_process is not None:
            await self._root_process.drop()

    async def _discard(self) -> None:
        """Kill the root process and forget it, so that another one can be started."""
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

    async def is_guarded(self, within_s: float) -> bool:
        if not self.alive:
            return False
        try:
            return isinstance(await self.guardian.ask(GetState(), within_s), StateIs)
        except (AskTimeout, Unreachable):
            return False

    async def describe(self) -> TreeReport | None:
        if self._root_process is None:
            return None
        try:
            answer = await self.root.ask(Describe(), self.patience.ask_s)
        except (AskTimeout, Unreachable):
            return None
        return complete(answer) if isinstance(answer, TreeReport) else None

    async def _answers(self) -> bool:
        """Return True if the root process answers and still restarts its children.

        If its restart budget is spent, a new root process is needed.
        """
        process = self._root_process
        if process is None or not process.alive:
            return False
        report = await self.describe()
        return report is not None and report.state != Mode.FAILED
