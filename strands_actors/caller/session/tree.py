"""The caller's side of one robot's tree, on trio: connect, command, stop and resume the robot.

``Robot`` and ``open_robot`` are built on it. The methods ``..._here`` are for the other threads of the
program. They ask the gate directly from the calling thread.
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
from strands_actors.supervisors.root.messages import UNREACHABLE, TreeReport
from strands_actors.supervisors.stop_result import StopResult
from strands_actors.surfaces.cameras.handle import Cameras

from ..processes.nodes import Entrance
from ..processes.plan import Plan
from ..processes.robot_processes import CLEANED_UP, NotConnected, Processes, unreachable
from ..processes.tree_processes import TreeProcesses
from .commanding import Commanding, Order, Orders
from .portal import portal
from .rollouts import Rollouts
from .writer import Writer

_log = logging.getLogger("strands_actors")

GUARDED_S, GUARDED_LOOK_S = 5.0, 0.05
"""How long a new tree waits until each process that can stop the robot is ready, and the period of this
check."""
RETRY_S = 3.0
"""Longest pause of the wire process between two attempts to open the wire, and the time of one attempt."""


class RobotTree:
    """The caller's side of one robot's tree. Only the trio loop of ``nursery`` may call it, except for the
    methods ``..._here``.

    Args:
        node: The caller's node.
        nursery: Tasks of the tree run in it.
        entrance: The address at which ``node`` listens.
        plan: The processes to start.
        liveness: As in ``Writer``. The default counts the program as alive.
    """

    def __init__(
        self,
        node: Node,
        nursery: trio.Nursery,
        entrance: Entrance,
        plan: Plan,
        liveness: Callable[[], tuple[bool, float]] = lambda: (True, 0.0),
    ) -> None:
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
        # A cleanup may come while a failed start is being ended. Only one of them ends the tree.
        self._ending = trio.Lock()

    @property
    def robot(self) -> str:
        """Return its name among the robots that run: ``plan.tool_name``, with a number if another robot has
        that name."""
        return self._processes.robot

    @property
    def clock(self) -> Clock:
        """Return the clock of the node."""
        return self._processes.node.clock

    @property
    def facts(self) -> dict[str, Any]:
        """Return the facts of the wire (``Wire.open``) from its last answer."""
        return self._processes.facts

    @property
    def cameras(self) -> Cameras:
        return self._processes.cameras

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return the driver's warnings for the user. A twin has no warnings."""
        return () if self.plan.twin_process is not None else self.driver.caveats

    @property
    def standby_report(self) -> str | None:
        """Return the report of the standby of an earlier tree of this robot."""
        return self._processes.standby_report

    # -- start and end

    async def connect(self, arm: bool = True) -> str | None:
        """Start the tree if it does not run, wait for the link, arm, and acquire the lease.

        Args:
            arm: False ends after the link is up. Nothing is energised, and no lease is acquired.

        Returns:
            None, or the reason why it failed.
        """
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
        # This call may have waited for another connect, and the robot may have been cleaned up meanwhile.
        processes.require_open()
        if processes.started:
            # The wire may be in a pause between two attempts, and its status of the link older than that.
            status = await processes.wait_linked(RETRY_S)
        else:
            try:
                await processes.start(self._writer.beat)
                status = await processes.wait_linked()
                await processes.require_mesh()
                processes.require_open()
            except (NotConnected, OSError):
                # Otherwise the tree would keep trying, and take the port from the next program that uses it.
                await self._end()
                raise
        # For a robot of another host, the script on that host logs the warnings.
        if not self._told_caveats and not processes.elsewhere:
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
            # It does not lift a lock, since an e-stop may have come after the status was read.
            answer = await self._energise_when_guarded(stops, asked_ns)
            if not isinstance(answer, Resumed):
                return answer.about("").text if isinstance(answer, Refused) else "no answer"
        async with self._writer.turn:
            refusal = await self._writer.acquire()
        processes.require_open()
        return None if refusal is None else refusal.about("").text

    async def cleanup(self) -> StopResult:
        """Make the robot safe and end the tree, for good. A start that is under way continues up to its
        next wait, and fails there."""
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
        """Release the lease, so that other programs (also on the mesh) may move the robot.

        A latched target ends in a hold. The next command of this caller acquires the lease again, if it
        is free.

        Returns:
            The result of the hold. A refusal has released nothing.
        """
        self._processes.require()
        refusal = await self.rollouts.refuse("release")
        if refusal is not None:
            return refusal
        async with self._writer.turn:
            return await self._writer.release()

    async def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        """Send one command. The gate checks it, the wire writes it, and it stays in force as long as the
        driver declares (``Timing.oneshot_ttl_s``)."""
        return _accepted(await self._command(self._orders.move(action)))

    def send_action_here(self, action: Mapping[str, Any]) -> Accepted | Refused | None:
        """As ``send_action``, in the calling thread. None: the loop has to do it."""
        answer = self._command_here(self._orders.move(action))
        return None if answer is None else _accepted(answer)

    async def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused:
        """Run a service of the driver (``Driver.SERVICES``), under this caller's lease.

        Args:
            service: Its name.
            arguments: Its arguments.
            action: A command to write first. If it is refused, the service does not run.
        """
        return _performed(service, await self._command(self._orders.perform(service, arguments, action)))

    def perform_here(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused | None:
        """As ``perform``, in the calling thread. None: the loop has to do it."""
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
        """Make the robot safe. If the wire does not answer, the root fences it and uses its own stop
        channel.

        Args:
            reason: The reason, which selects the safe state.
            lock: Lock the robot as an e-stop does.
        """
        stop = self._stopping(reason, lock)
        try:
            answer = await self._processes.gate.ask(stop, self._processes.patience.stop_s)
        except (AskTimeout, Unreachable):
            answer = None
        return await self._stopped(stop, answer)

    def stop_here(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopResult:
        """As ``stop``, in the calling thread. The request leaves at once, even if the loop is busy."""
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
        """Return the result of a stop, after a fence if the gate has not stopped the robot.

        The gate refuses a stop only if it has ended, has crashed, or its queue is full; then the robot is not
        stopped. For a robot of
        another host a refusal is the result, since this host cannot fence its wire.

        Args:
            stop: The request.
            answer: The gate's answer; None if it did not come in time.
        """
        is_final = isinstance(answer, StopReport) or (answer is not None and self._processes.elsewhere)
        if is_final:
            result = stop_result.of_answer("stop", answer, self.driver.axes)
        else:
            result = await self._processes.make_safe(stop.reason, stop.by, stop.lock)
        self.rollouts.end("stop")
        return result

    async def resume(self, lift: bool = True) -> Resumed | Refused:
        """Lift a lock, restart processes that have ended, and energise at the measured position. It starts
        no motion.

        Args:
            lift: False only energises, for a caller that is not an operator.
        """
        self._processes.require_open()
        asked_ns = self.clock.now_ns()
        async with self._starting:
            self._processes.require_open()
            try:
                answer = await self._resume(lift, asked_ns)
            finally:
                if self._processes.closed:  # A cleanup came meanwhile, so end the restarted tree.
                    await self._end()
            self._processes.require_open()
            return answer

    async def _resume(self, lift: bool, asked_ns: int) -> Resumed | Refused:
        stops = self._stops
        was_started = self._processes.started
        refused = await self._processes.revive(lift, self._writer.beat)
        if refused is not None:
            return refused
        # As in ``_connect``, a wire that was started after the stop may be between two attempts.
        await self._processes.wait_linked(RETRY_S if was_started else 0.0)
        answer = await self._energise(stops, asked_ns, lift)
        if isinstance(answer, Resumed):
            async with self._writer.turn:
                refusal = await self._writer.acquire()
                if refusal is None:
                    await self.rollouts.end_without_lease()
            return refusal or answer
        return read_answer(answer, Resumed, RESUME)

    async def _energise_when_guarded(self, stops: int, asked_ns: int) -> Message | None:
        """As ``_energise`` without a lift, but wait for the processes that can stop the robot. A new tree may
        still be starting them, on a busy machine for seconds."""
        end_s = trio.current_time() + GUARDED_S
        while True:
            answer = await self._energise(stops, asked_ns, lift=False)
            unguarded = isinstance(answer, Refused) and answer.code == Code.NO_STANDBY
            if not unguarded or trio.current_time() >= end_s:
                return answer
            await trio.sleep(GUARDED_LOOK_S)

    async def _energise(self, stops: int, asked_ns: int, lift: bool) -> Message | None:
        """Ask the gate to arm, unless a stop came after the user's request.

        Args:
            stops: ``self._stops`` at the time of the request. A greater number now means that this caller
                has stopped the robot since.
            asked_ns: Time of the request. The gate refuses if anyone has stopped the robot since.
            lift: Lift a lock.
        """
        self._processes.require_open()
        if self._stops != stops:
            return Refused(Code.STOPPED, "stopped meanwhile", "resume again when that is over", verb=RESUME)
        within_s = self.driver.timing.arm_s + 2.0  # the longest time for arming, and a margin
        try:
            when_ns = 0 if self._processes.elsewhere else asked_ns  # Clocks of two hosts differ.
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
        """As ``observe``, in the calling thread."""
        self._processes.require()
        try:
            return _observed(self._processes.gate.ask_here(GetObservation(), self._processes.patience.ask_s))
        except (AskTimeout, Unreachable) as failure:
            return unreachable("observe", failure)

    async def status(self) -> Status | None:
        """Return the gate's status; None if the wire process does not answer."""
        return await self._processes.status()

    async def describe(self) -> TreeReport | None:
        """Return processes and actors of the tree. The state is ``unreachable`` if the tree does not answer.
        None: nothing was started."""
        report = await self._processes.describe()
        if report is None and self._processes.started:
            return TreeReport(self.robot, UNREACHABLE, 0, (), ())
        return report


def processes_of(node: Node, nursery: trio.Nursery, entrance: Entrance, plan: Plan, driver: Driver) -> Processes:
    """Return the processes of a plan, on this host or on another."""
    if not plan.at:
        return TreeProcesses(node, nursery, entrance, plan, driver)
    # Only a program with a robot of another host needs this import.
    from strands_actors.surfaces.mesh.remote_processes import RemoteProcesses

    return RemoteProcesses(nursery, plan, driver)


def _accepted(answer: Message | None) -> Accepted | Refused:
    return read_answer(answer, Accepted, MOVE)


def _performed(service: str, answer: Message | None) -> Performed | Refused:
    return read_answer(answer, Performed, service)


def _observed(answer: Message | None) -> Observation | Refused:
    return read_answer(answer, Observation, OBSERVE)
