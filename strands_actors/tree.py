"""The caller's end of one robot's tree, on trio: connects it, writes to it, stops it, resumes it.

``Robot`` puts synchronous verbs on it, ``open_robot`` hands it to a trio program.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import trio

from .direct import Direct
from .factory import Plan
from .rollouts import Rollouts
from .runtime.contract import Driver, Observation, Reason
from .runtime.messages import Message, Refused
from .runtime.node import AskTimeout, Node, Unreachable
from .supervisors.actions import plain, refuse_shape
from .supervisors.failsafe import Mode
from .supervisors.loading import build_driver
from .supervisors.messages import (
    Accepted,
    Fence,
    GetObservation,
    Lease,
    Perform,
    Performed,
    Resume,
    Resumed,
    Setpoint,
    Status,
    Stop,
    StopReport,
    TreeReport,
)
from .tree_processes import ASK_S, FENCE_S, STOP_S, NotConnected, TreeProcesses, unreachable
from .writer import STALE, Writer

COMMAND_S = 0.25
"""A command that has not reached the wire by then never will."""
RETRY_S = 3.0
"""The wire's longest pause between two attempts to open it, and one attempt."""


class RobotTree:
    """One robot. All methods belong to the trio loop of ``nursery``."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        endpoint: str,
        plan: Plan,
        liveness: Callable[[], tuple[bool, float]] = lambda: (True, 0.0),
        by_threads: bool = False,
    ) -> None:
        """``endpoint``: where ``node`` listens. ``liveness``: see ``Writer``. ``by_threads``: for ``Direct``."""
        self.plan = plan
        self.driver: Driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        self.problem = ""
        """Why the last attempt to connect failed."""
        self._node = node
        self._processes = TreeProcesses(node, nursery, endpoint, plan, by_threads)
        self._writer = Writer(self._processes, liveness)
        self.rollouts = Rollouts(self._processes, self._writer, self.driver)
        self.direct = Direct(self, self._processes, self._writer)
        self._stops = 0
        self._starting = trio.Lock()

    @property
    def robot(self) -> str:
        """Its name among the robots that run: ``plan.tool_name``, numbered when that was taken."""
        return self._processes.robot

    @property
    def facts(self) -> dict[str, Any]:
        """What the wire said of itself when it last answered."""
        return self._processes.facts

    # -- start and end

    async def connect(self, arm: bool = True) -> str | None:
        """Start the tree if need be, wait for the link, arm and take the lease (unless ``arm`` is false: then
        nothing is energised). None, or why not."""
        if self._processes.closed:
            return "connect: this robot was cleaned up. make a new one"
        try:
            async with self._starting:
                self.problem = await self._connect(arm) or ""
                return self.problem or None
        except (NotConnected, AskTimeout, Unreachable, OSError, ValueError) as failure:
            self.problem = f"connect: {str(failure).removeprefix('connect: ')}"
            return self.problem

    async def _connect(self, arm: bool) -> str | None:
        stops = self._stops
        processes = self._processes
        if processes.started:
            # What it says of the link may be from before its present pause between two attempts.
            status = await processes.wait_linked(RETRY_S)
        else:
            try:
                await processes.start(self._writer.beat)
                status = await processes.wait_linked()
                await processes.require_mesh()
            except (NotConnected, OSError):
                await self._end()  # it would go on trying, and take the port from whoever has it next
                raise
        if not arm:
            return None
        if status.mode not in (Mode.ARMED, Mode.HOLDING):
            if status.locked_by:
                since = f", {status.locked_since}" if status.locked_since else ""
                return f"connect: e-stopped by {status.locked_by}{since}. resume() lifts the lockout"
            answer = await self._energise(stops)
            if not isinstance(answer, Resumed):
                return answer.text if isinstance(answer, Refused) else "no answer"
        async with self._writer.turn:
            refusal = await self._writer.acquire()
        return None if refusal is None else refusal.text

    async def cleanup(self) -> StopReport | None:
        """Make safe, end the tree. The report, or None when nothing was running."""
        self._processes.closed = True
        self.rollouts.end("cleanup")
        report = await self._end()
        if self.plan.engine is not None and self.plan.owns_engine:
            await self.plan.engine.close()
        return report

    async def _end(self) -> StopReport | None:
        report = await self._processes.end()
        self._writer.lease = None
        return report

    # -- writing

    async def release(self) -> Refused | None:
        """Give the lease up: others, on the mesh too, may then move the robot. A target that was latched is held.
        The next command of ours takes the lease again, if nobody else has it."""
        self._processes.require()
        refusal = await self.rollouts.refuse("release")
        if refusal is not None:
            return refusal
        async with self._writer.turn:
            await self._writer.release()
        return None

    async def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        """One command: gated, then written, then kept for as long as the driver says."""
        self._processes.require()
        refusal = refuse_shape(action)
        if refusal is not None:
            return refusal
        answer = await self._command("move", lambda lease: self.setpoint(lease, action), ASK_S)
        return answer if isinstance(answer, Accepted | Refused) else Refused("no_answer", "move: no answer")

    async def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused:
        """One of the driver's own services (``Driver.SERVICES``), under this caller's lease. ``action``: a command
        that is written first; when it is refused, so is the service."""
        self._processes.require()
        refusal = self.refuse_service(service, arguments, action)
        if refusal is not None:
            return refusal
        answer = await self._command(
            service, lambda lease: self.performing(lease, service, arguments, action), self.within_s(service)
        )
        return answer if isinstance(answer, Performed | Refused) else Refused("no_answer", f"{service}: no answer")

    def refuse_service(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None
    ) -> Refused | None:
        """What can be refused before the gate is asked. Of any thread."""
        refusal = self.driver.check_service(service, arguments)
        return refusal or (None if action is None else refuse_shape(action))

    def setpoint(self, lease: Lease, action: Mapping[str, Any]) -> Setpoint:
        """Of any thread."""
        ttl_s = self.driver.timing.oneshot_ttl_s
        deadline_ns = self._node.clock.now_ns() + round(1e9 * (COMMAND_S if ttl_s is None else ttl_s))
        return Setpoint(lease.id, lease.epoch, deadline_ns, plain(action), 0.0, ttl_s is None)

    def performing(
        self, lease: Lease, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None
    ) -> Perform:
        """Of any thread."""
        first = None if action is None else self.setpoint(lease, action)
        return Perform(lease.id, lease.epoch, service, plain(arguments), first)

    def within_s(self, service: str) -> float:
        """How long one of the driver's own services is waited for."""
        return self.driver.SERVICES[service].within_s + ASK_S

    async def _command(self, verb: str, make: Callable[[Lease], Message], within_s: float) -> Message | None:
        """Ask the gate for what needs the lease. One that is no longer good (the robot was held since, the wire
        restarted, somebody else has it) may be taken anew by an explicit new command; a robot that is disarmed or
        locked out refuses it all the same."""
        writer = self._writer
        async with writer.turn:
            refusal = await self.rollouts.refuse(verb)
            if refusal is not None:
                return refusal
            if writer.lease is not None:
                answer = await self._ask(verb, make(writer.lease), within_s)
                if not (isinstance(answer, Refused) and answer.code in STALE):
                    return answer
            refusal = await writer.acquire()
            if refusal is not None or writer.lease is None:
                return refusal or Refused("lease", f"{verb}: no lease")
            return await self._ask(verb, make(writer.lease), within_s)

    async def _ask(self, verb: str, message: Message, within_s: float) -> Message | None:
        try:
            return await self._processes.gate.ask(message, within_s)
        except AskTimeout as timeout:
            return await self.late(verb, timeout)
        except Unreachable as failure:
            return unreachable(verb, failure)

    async def late(self, verb: str, timeout: AskTimeout) -> Refused:
        """What was not answered in time must not be done late: fence and stop."""
        await self._fence(Reason.WIRE, f"{verb} timed out")
        return Refused("timeout", f"{verb}: {timeout}; the robot was stopped", "resume()")

    # -- stop and resume

    async def stop(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopReport | Refused:
        """Make safe. When the wire does not answer, the root fences it and writes by its own path."""
        self._processes.require()
        self._stops += 1
        holder = self._processes.holder
        try:
            answer = await self._processes.gate.ask(Stop(reason, holder, lock), STOP_S)
        except (AskTimeout, Unreachable):
            answer = await self._fence(reason, holder, lock)
        self.rollouts.end("stop")
        return answer if isinstance(answer, StopReport | Refused) else Refused("no_answer", "stop: no answer")

    async def _fence(self, reason: Reason, by: str, lock: bool = False) -> StopReport | Refused:
        try:
            answer = await self._processes.guardian.ask(Fence(reason, by, lock), FENCE_S)
        except (AskTimeout, Unreachable) as failure:
            # Neither the wire nor the root answers. Without its root the wire makes itself safe.
            await self._processes.fence()
            why = f"neither wire nor root answers ({failure}); the root was ended"
            named = ", ".join(self.driver.axes)
            return Refused("unconfirmed", f"stop: {why}. not confirmed by {named}", "look at the robot")
        return answer if isinstance(answer, StopReport | Refused) else Refused("no_answer", "stop: no answer")

    async def resume(self, lift: bool = True) -> Resumed | Refused:
        """Lift a lockout, or start again what has died; energise at the measured position. No motion.
        ``lift=False`` only energises: for who is no operator."""
        self._processes.require_open()
        async with self._starting:
            return await self._resume(lift)

    async def _resume(self, lift: bool) -> Resumed | Refused:
        stops = self._stops
        if not await self._processes.answers():
            if not lift:  # whether it was locked is no longer known
                remedy = "an operator's resume() starts it again"
                return Refused("not_connected", "resume: the tree does not answer", remedy)
            if self._processes.started:
                await self._processes.discard()
                self._writer.lease = None
            await self._processes.start(self._writer.beat)
        await self._processes.wait_linked()
        answer = await self._energise(stops, lift)
        if isinstance(answer, Resumed):
            async with self._writer.turn:
                refusal = await self._writer.acquire()
                if refusal is None:
                    await self.rollouts.end_overtaken()
            return refusal or answer
        return answer if isinstance(answer, Refused) else Refused("no_answer", "resume: no answer")

    async def _energise(self, stops: int, lift: bool = True) -> Message | None:
        """Have the gate arm, unless it was told to stop since (``stops``: how often it had been before)."""
        if self._stops != stops:
            return Refused("stopped", "resume: stopped meanwhile", "resume again when that is over")
        answer: Message | None = None
        failure: Exception = NotConnected("the wire ended while it was arming; try again")
        within_s = self.driver.timing.arm_s + 2.0  # how long arming may take, and a little more
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._watch_arming, nursery.cancel_scope)
            try:
                answer = await self._processes.gate.ask(Resume(self._processes.holder, lift), within_s)
            except (AskTimeout, Unreachable) as error:
                failure = error
            nursery.cancel_scope.cancel()
        if answer is None:
            raise failure
        return answer

    async def _watch_arming(self, asked: trio.CancelScope) -> None:
        """A gate that dies takes the question with it: its successor, which does not arm, gives it away."""
        idle = 0
        while idle < 2:
            await trio.sleep(0.2)
            status = await self.status()
            idle = 0 if status is None or status.mode in (Mode.ARMING, Mode.STOPPING) else idle + 1
        asked.cancel()

    # -- reading

    async def observe(self) -> Observation | Refused:
        self._processes.require()
        try:
            answer = await self._processes.gate.ask(GetObservation(), ASK_S)
        except (AskTimeout, Unreachable) as failure:
            return Refused("unreachable", f"observe: {failure}", "resume() when the robot is back")
        return answer if isinstance(answer, Observation | Refused) else Refused("no_answer", "no answer")

    async def status(self) -> Status | None:
        """None when the wire does not answer."""
        return await self._processes.status()

    async def describe(self) -> TreeReport | None:
        """Processes and actors of the tree; None when the root does not answer."""
        return await self._processes.describe()
