"""The caller's end of one robot's tree, on trio: connects it, writes to it, stops it, resumes it.

``Robot`` puts synchronous verbs on it, ``open_robot`` hands it to a trio program. What ends in
``_here`` is for any thread of the program but the loop's, and asks the gate from there.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import Any

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.wire import Observation
from strands_actors.kernel.answers import read_answer
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Node, Unreachable
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import stop_result
from strands_actors.supervisors.gate.failsafe import Mode
from strands_actors.supervisors.gate.messages import (
    MOVE,
    OBSERVE,
    RESUME,
    Accepted,
    GetObservation,
    Performed,
    Resume,
    Resumed,
    Status,
    Stop,
    StopReport,
)
from strands_actors.supervisors.loading import build_driver
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.cameras.handle import Cameras

from . import envelopes as answers
from .commanding import Commanding, Order, Orders
from .nodes import Entrance
from .plan import Plan
from .portal import portal
from .processes import CLEANED_UP, NotConnected, Processes, unreachable
from .rollouts import Rollouts
from .tree_processes import TreeProcesses
from .writer import Writer

_log = logging.getLogger("strands_actors")

GUARDED_S, GUARDED_LOOK_S = 5.0, 0.05
"""How long a tree that has just begun waits for each process that could stop its robot."""
RETRY_S = 3.0
"""The wire's longest pause between two attempts to open it, and one attempt."""


class RobotTree:
    """One robot. All methods belong to the trio loop of ``nursery``."""

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        entrance: Entrance,
        plan: Plan,
        liveness: Callable[[], tuple[bool, float]] = lambda: (True, 0.0),
    ) -> None:
        """``entrance``: where ``node`` listens. ``liveness``: see ``Writer``."""
        self.plan = plan
        self.driver: Driver = build_driver(plan.driver_class, plan.robot, plan.port, plan.options)
        self.problem = ""
        """Why the last attempt to connect failed."""
        self._processes = processes_of(node, nursery, entrance, plan, self.driver)
        self._writer = Writer(self._processes, liveness)
        self.rollouts = Rollouts(self._processes, self._writer, self.driver)
        self._orders = Orders(self.driver, node.clock, self._processes.patience)
        self._commanding = Commanding(self._processes, self._writer, self.rollouts)
        self._stops = 0
        self._told_caveats = False
        self._starting = trio.Lock()
        self._ending = trio.Lock()  # one at a time: a cleanup may come while what it ends is being started

    @property
    def robot(self) -> str:
        """Return its name among the robots that run: ``plan.tool_name``, numbered when that was
        taken."""
        return self._processes.robot

    @property
    def clock(self) -> Clock:
        """Of the robot's host."""
        return self._processes.node.clock

    @property
    def facts(self) -> dict[str, Any]:
        """Return what the wire said of itself when it last answered."""
        return self._processes.facts

    @property
    def cameras(self) -> Cameras:
        return self._processes.cameras

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return what its user should know; nothing of a twin, which is as its model."""
        return () if self.plan.twin_process is not None else self.driver.caveats

    @property
    def standby_report(self) -> str | None:
        """Return what the standby of an earlier tree of this robot had to do."""
        return self._processes.standby_report

    # -- start and end

    async def connect(self, arm: bool = True) -> str | None:
        """Start the tree if need be, wait for the link, arm and take the lease (unless ``arm`` is
        false: then nothing is energised). None, or why not."""
        try:
            self._processes.require_open()
            async with self._starting:
                self.problem = await self._connect(arm) or ""
                return self.problem or None
        except (NotConnected, AskTimeout, Unreachable, OSError, ValueError) as failure:
            self.problem = CLEANED_UP if self._processes.closed else str(failure)
            return self.problem

    async def _connect(self, arm: bool) -> str | None:
        stops, asked_ns = self._stops, self.clock.now_ns()
        processes = self._processes
        processes.require_open()  # who waited for another connect may have been cleaned up meanwhile
        if processes.started:
            # What it says of the link may be from before its present pause between two attempts.
            status = await processes.wait_linked(RETRY_S)
        else:
            try:
                await processes.start(self._writer.beat)
                status = await processes.wait_linked()
                await processes.require_mesh()
                processes.require_open()
            except (NotConnected, OSError):
                await self._end()  # it would go on trying, and take the port from whoever has it next
                raise
        if not self._told_caveats and not processes.elsewhere:  # its own script has told
            self._told_caveats = True
            for caveat in self.caveats:
                _log.warning("%s: %s", self.robot, caveat)
        if not arm:
            return None
        if status.mode != Mode.ARMED and (status.mode != Mode.HOLDING or processes.elsewhere):
            if status.locked_by:
                since = f", {status.locked_since}" if status.locked_since else ""
                how = f"resume() lifts the lockout, as does `strands-actors resume {self.robot}`"
                return f"e-stopped by {status.locked_by}{since}. {how}"
            # It lifts no lock: one may have been put on since the status was read.
            answer = await self._energise_when_guarded(stops, asked_ns)
            if not isinstance(answer, Resumed):
                return answer.about("").text if isinstance(answer, Refused) else "no answer"
        async with self._writer.turn:
            refusal = await self._writer.acquire()
        processes.require_open()
        return None if refusal is None else refusal.about("").text

    async def cleanup(self) -> StopResult:
        """Make safe, end the tree. What is being started goes on to its next wait at most, and sees
        there that it is closed."""
        self._processes.close()
        self.rollouts.end("cleanup")
        result = await self._end()
        if self.plan.twin_process is not None and self.plan.owns_twin_process:
            await self.plan.twin_process.close()
        return result

    async def _end(self) -> StopResult:
        async with self._ending:
            result = await self._processes.end(self._writer.lease)
            self._writer.lease = None
            return result

    # -- writing

    async def release(self) -> StopResult | Refused:
        """Give the lease up: others, on the mesh too, may then move the robot. A target that was
        latched is held. The next command of ours takes the lease again, if nobody else has it. A
        refusal has released nothing."""
        self._processes.require()
        refusal = await self.rollouts.refuse("release")
        if refusal is not None:
            return refusal
        async with self._writer.turn:
            return await self._writer.release()

    async def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        """Send one command: gated, then written, then kept for as long as the driver says."""
        return _accepted(await self._command(self._orders.move(action)))

    def send_action_here(self, action: Mapping[str, Any]) -> Accepted | Refused | None:
        """Do the same in the thread that calls; None when the loop has to do it."""
        answer = self._command_here(self._orders.move(action))
        return None if answer is None else _accepted(answer)

    async def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused:
        """Do one of the driver's own services (``Driver.SERVICES``), under this caller's lease.
        ``action``: a command that is written first; when it is refused, so is the service."""
        return _performed(service, await self._command(self._orders.perform(service, arguments, action)))

    def perform_here(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused | None:
        """Do the same in the thread that calls; None when the loop has to do it."""
        answer = self._command_here(self._orders.perform(service, arguments, action))
        return None if answer is None else _performed(service, answer)

    async def _command(self, order: Order | Refused) -> Message | None:
        self._processes.require()
        return order if isinstance(order, Refused) else await self._commanding.ask(order)

    def _command_here(self, order: Order | Refused) -> Message | None:
        self._processes.require()
        return order if isinstance(order, Refused) else self._commanding.ask_here(order)

    # -- stop and resume

    async def stop(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopResult:
        """Make safe. When the wire does not answer, the root fences it and writes by its own
        path."""
        stop = self._stopping(reason, lock)
        try:
            answer = await self._processes.gate.ask(stop, self._processes.patience.stop_s)
        except (AskTimeout, Unreachable):
            answer = None
        return await self._stopped(stop, answer)

    def stop_here(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopResult:
        """Do the same in the thread that calls: the order leaves in it, whatever the loop does."""
        stop = self._stopping(reason, lock)
        try:
            answer = self._processes.gate.ask_here(stop, self._processes.patience.stop_s)
        except (AskTimeout, Unreachable):
            answer = None
        return portal().call(self._stopped, stop, answer)

    def _stopping(self, reason: Reason, lock: bool) -> Stop:
        self._processes.require()
        self._stops += 1
        return Stop(reason, self._processes.holder, lock)

    async def _stopped(self, stop: Stop, answer: Message | None) -> StopResult:
        """``answer``: the gate's; None when there was none. A refusal has stopped nothing: the gate is
        gone, has crashed, or has no room. Of a robot elsewhere it is told as it is: nobody is fenced
        from here."""
        told = isinstance(answer, StopReport) or (answer is not None and self._processes.elsewhere)
        if told:
            result = stop_result.of_answer("stop", answer, self.driver.axes)
        else:
            result = await self._processes.make_safe(stop.reason, stop.by, stop.lock)
        self.rollouts.end("stop")
        return result

    async def resume(self, lift: bool = True) -> Resumed | Refused:
        """Lift a lockout, or start again what has died; energise at the measured position. No
        motion. ``lift=False`` only energises: for who is no operator."""
        self._processes.require_open()
        asked_ns = self.clock.now_ns()
        async with self._starting:
            self._processes.require_open()
            try:
                answer = await self._resume(lift, asked_ns)
            finally:
                if self._processes.closed:  # meanwhile: what was started again is ended
                    await self._end()
            self._processes.require_open()
            return answer

    async def _resume(self, lift: bool, asked_ns: int) -> Resumed | Refused:
        stops = self._stops
        known = self._processes.started
        refused = await self._processes.revive(lift, self._writer.beat)
        if refused is not None:
            return refused
        # As in ``_connect``: a wire that is new since the stop may be between two attempts.
        await self._processes.wait_linked(RETRY_S if known else 0.0)
        answer = await self._energise(stops, asked_ns, lift)
        if isinstance(answer, Resumed):
            async with self._writer.turn:
                refusal = await self._writer.acquire()
                if refusal is None:
                    await self.rollouts.end_overtaken()
            return refusal or answer
        return read_answer(answer, Resumed, RESUME)

    async def _energise_when_guarded(self, stops: int, asked_ns: int) -> Message | None:
        """As ``_energise`` without a lift. A tree that has just begun may still be starting a process
        that could stop the robot: wait for it, on a busy machine for seconds."""
        end_s = trio.current_time() + GUARDED_S
        while True:
            answer = await self._energise(stops, asked_ns, lift=False)
            unguarded = isinstance(answer, Refused) and answer.code == Code.NO_STANDBY
            if not unguarded or trio.current_time() >= end_s:
                return answer
            await trio.sleep(GUARDED_LOOK_S)

    async def _energise(self, stops: int, asked_ns: int, lift: bool) -> Message | None:
        """Have the gate arm, unless it was told to stop since: by us (``stops``: how often it had been
        before), or by anybody (``asked_ns``)."""
        self._processes.require_open()
        if self._stops != stops:
            return Refused(Code.STOPPED, "stopped meanwhile", "resume again when that is over", verb=RESUME)
        within_s = self.driver.timing.arm_s + 2.0  # how long arming may take, and a little more
        try:
            when_ns = 0 if self._processes.elsewhere else asked_ns  # another host has another clock
            return await self._processes.gate.ask(Resume(self._processes.holder, lift, when_ns), within_s)
        except Unreachable as gone:
            raise NotConnected(f"the wire ended while it was arming ({gone}); try again") from gone

    # -- reading

    async def observe(self) -> Observation | Refused:
        self._processes.require()
        try:
            return _observed(await self._processes.gate.ask(GetObservation(), self._processes.patience.ask_s))
        except (AskTimeout, Unreachable) as failure:
            return unreachable("observe", failure)

    def observe_here(self) -> Observation | Refused:
        """Do the same in the thread that calls."""
        self._processes.require()
        try:
            return _observed(self._processes.gate.ask_here(GetObservation(), self._processes.patience.ask_s))
        except (AskTimeout, Unreachable) as failure:
            return unreachable("observe", failure)

    async def status(self) -> Status | None:
        """None when the wire does not answer."""
        return await self._processes.status()

    async def describe(self) -> TreeReport | None:
        """Processes and actors of the tree. Its state is ``unreachable`` when it does not answer. None:
        nothing was started."""
        report = await self._processes.describe()
        if report is None and self._processes.started:
            return TreeReport(self.robot, answers.UNREACHABLE, 0, (), ())
        return report


def processes_of(node: Node, nursery: trio.Nursery, entrance: Entrance, plan: Plan, driver: Driver) -> Processes:
    """Return those that a plan is about."""
    if not plan.at:
        return TreeProcesses(node, nursery, entrance, plan, driver)
    from strands_actors.surfaces.mesh.remote_processes import RemoteProcesses  # for who has a robot elsewhere

    return RemoteProcesses(nursery, plan, driver)


def _accepted(answer: Message | None) -> Accepted | Refused:
    return read_answer(answer, Accepted, MOVE)


def _performed(service: str, answer: Message | None) -> Performed | Refused:
    return read_answer(answer, Performed, service)


def _observed(answer: Message | None) -> Observation | Refused:
    return read_answer(answer, Observation, OBSERVE)
