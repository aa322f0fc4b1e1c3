"""The interface of a program to one robot, on trio: connect, command, stop and resume the robot.

A tree is the set of processes of one robot. ``Robot`` and ``open_robot`` are built on this class. The methods
``..._here`` are for the other threads of the program. They ask the robot's gate, which checks each command,
directly from the calling thread.
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
from . import refusals
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
    """The interface of a program to the processes of one robot. Only the trio loop of ``nursery`` may call it,
    except for the methods ``..._here``.

    Args:
        node: The caller's node (the actors of its process).
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
        self._caveats_logged = False
        self._starting = trio.Lock()
        # A cleanup may come while a failed start is being undone. Only one of the two ends the processes.
        self._ending = trio.Lock()

    @property
    def robot(self) -> str:
        """Return the robot's name among the robots that run.

        It is ``plan.tool_name``, with a number if another robot has that name.
        """
        return self._processes.robot

    @property
    def clock(self) -> Clock:
        """Return the clock of the caller's node (the actors of its process)."""
        return self._processes.node.clock

    @property
    def facts(self) -> dict[str, Any]:
        """Return the facts that the robot reported when it was opened (``Wire.open``), from the last status."""
        return self._processes.facts

    @property
    def cameras(self) -> Cameras:
        return self._processes.cameras

    @property
    def caveats(self) -> tuple[str, ...]:
        """Return the driver's warnings for the user. A simulated robot has no warnings."""
        return () if self.plan.is_simulated else self.driver.caveats

    @property
    def standby_report(self) -> str | None:
        """Return the report of the standby process (the last one that can stop a robot) of an earlier run."""
        return self._processes.standby_report

    # -- start and end of the processes

    async def connect(self, arm: bool = True) -> str | None:
        """Start the robot's processes if they do not run, wait for the link to the robot, arm, and acquire the
        lease (the right to command).

        Args:
            arm: False returns when the link is up. Nothing is energised, and no lease is acquired.

        Returns:
            None, or the reason why connecting failed.
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
        stops, requested_ns = self._stops, self.clock.now_ns()
        processes = self._processes
        # While this call waited for another connect, the robot may have been cleaned up.
        processes.require_open()
        if processes.started:
            # The wire process may pause between two attempts to connect. The status is then that of the last
            # attempt, so allow time for another.
            status = await processes.wait_linked(RETRY_S)
        else:
            try:
                await processes.start(self._writer.beat)
                status = await processes.wait_linked()
                await processes.require_mesh()
                processes.require_open()
            except (NotConnected, OSError):
                # If the processes were not ended here, they would keep trying to connect, and would take the port
                # from the next program.
                await self._end()
                raise
        # For a robot of another host, the script on that host logs the warnings.
        if not self._caveats_logged and not processes.elsewhere:
            self._caveats_logged = True
            for caveat in self.caveats:
                _log.warning("%s: %s", self.robot, caveat)
        if not arm:
            return None
        if status.mode != Mode.ARMED and (status.mode != Mode.HOLDING or processes.elsewhere):
            if status.locked_by:
                since = f", {status.locked_since}" if status.locked_since else ""
                how = f"resume() lifts the lockout, as does `strands-actors resume {self.robot}`"
                return f"e-stopped by {status.locked_by}{since}. {how}"
            # Do not lift a lock here, since an e-stop may have come after the status was read.
            answer = await self._energise_when_guarded(stops, requested_ns)
            if not isinstance(answer, Resumed):
                return answer.about("").text if isinstance(answer, Refused) else "no answer"
        async with self._writer.turn:
            refusal = await self._writer.acquire()
        processes.require_open()
        return None if refusal is None else refusal.about("").text

    async def cleanup(self) -> StopResult:
        """Make the robot safe and end its processes, for good.

        If a start is under way, it continues up to its next ``await``, and fails there.
        """
        self._processes.close()
        self.rollouts.end("cleanup")
        result = await self._end()
        for plan in (self.plan, *self.plan.parts.values()):
            if plan.twin_process is not None and plan.owns_twin_process:
                await plan.twin_process.close()
        return result

    async def _end(self) -> StopResult:
        async with self._ending:
            result = await self._processes.end(self._writer.lease)
            self._writer.lease = None
            return result

    # -- writing

    async def release(self) -> StopResult | Refused:
        """Release the lease, so that other programs (also on the mesh) may move the robot.

        The lease is the right to command the robot. If a target is still in force, the robot holds its position
        instead. The next command of this caller acquires the lease again, if it is free.

        Returns:
            The result of the hold. If it is a refusal, nothing was released.
        """
        self._processes.require()
        refusal = await self.rollouts.refuse("release")
        if refusal is not None:
            return refusal
        async with self._writer.turn:
            return await self._writer.release()

    async def send_action(self, action: Mapping[str, Any]) -> Accepted | Refused:
        """Send one command. If the gate accepts it, it is written to the robot, and stays in force as long as
        the driver declares (``Timing.oneshot_ttl_s``).
        """
        return _accepted(await self._command(self._orders.move(action)))

    def send_action_here(self, action: Mapping[str, Any]) -> Accepted | Refused | None:
        """Send a command as ``send_action`` does, but in the calling thread. None means that the loop must do
        it.
        """
        answer = self._command_here(self._orders.move(action))
        return None if answer is None else _accepted(answer)

    async def perform(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused:
        """Run a service of the driver (``Driver.SERVICES``), under this caller's lease (right to command).

        Args:
            service: Name of the service.
            arguments: Arguments of the service.
            action: A command to write first. If it is refused, the service does not run.
        """
        return _performed(service, await self._command(self._orders.perform(service, arguments, action)))

    def perform_here(
        self, service: str, arguments: Mapping[str, Any], action: Mapping[str, Any] | None = None
    ) -> Performed | Refused | None:
        """Run a service as ``perform`` does, but in the calling thread. None means that the loop must do it."""
        answer = self._command_here(self._orders.perform(service, arguments, action))
        return None if answer is None else _performed(service, answer)

    async def _command(self, order: Order | Refused) -> Message | None:
        self._processes.require()
        return order if isinstance(order, Refused) else await self._commanding.ask(order)

    def _command_here(self, order: Order | Refused) -> Message | None:
        self._processes.require()
        return order if isinstance(order, Refused) else self._commanding.ask_here(order)

    # -- stop and resume the robot

    async def stop(self, reason: Reason = Reason.STOP, lock: bool = False) -> StopResult:
        """Make the robot safe. If the wire process does not answer, the root process kills it and stops the
        robot over its own stop channel.

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
        """Stop the robot as ``stop`` does, but in the calling thread. The request leaves at once, even if the
        loop is busy.
        """
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
        """Return the result of a stop. If the gate (it checks each command) has not stopped the robot, the root
        process stops it.

        The gate refuses a stop only if it has ended, has crashed, or its queue is full. The robot is then not
        stopped. For a robot of another host a refusal is the result, since this host cannot kill the wire
        process there.

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
        """Lift the lock of an e-stop, restart processes that have ended, and energise at the measured position. It
        starts no motion.

        Args:
            lift: False only energises, for a caller that is not an operator.
        """
        self._processes.require_open()
        requested_ns = self.clock.now_ns()
        async with self._starting:
            self._processes.require_open()
            try:
                answer = await self._resume(lift, requested_ns)
            finally:
                # If a cleanup came meanwhile, end the processes that were restarted.
                if self._processes.closed:
                    await self._end()
            self._processes.require_open()
            return answer

    async def _resume(self, lift: bool, requested_ns: int) -> Resumed | Refused:
        stops = self._stops
        was_started = self._processes.started
        refused = await self._processes.revive(lift, self._writer.beat)
        if refused is not None:
            return refused
        # As in ``_connect``, the wire process may pause between two attempts, so allow time for another.
        await self._processes.wait_linked(RETRY_S if was_started else 0.0)
        answer = await self._energise(stops, requested_ns, lift)
        if isinstance(answer, Resumed):
            async with self._writer.turn:
                refusal = await self._writer.acquire()
                if refusal is None:
                    await self.rollouts.end_without_lease()
            return refusal or answer
        return read_answer(answer, Resumed, RESUME)

    async def _energise_when_guarded(self, stops: int, requested_ns: int) -> Message | None:
        """Energise without lifting a lock, but wait until the processes that can stop the robot run.

        On a busy machine the start of these processes takes seconds.
        """
        end_s = trio.current_time() + GUARDED_S
        while True:
            answer = await self._energise(stops, requested_ns, lift=False)
            unguarded = isinstance(answer, Refused) and answer.code == Code.NO_STANDBY
            if not unguarded or trio.current_time() >= end_s:
                return answer
            await trio.sleep(GUARDED_LOOK_S)

    async def _energise(self, stops: int, requested_ns: int, lift: bool) -> Message | None:
        """Ask the gate to arm, unless a stop came after the user's request.

        Args:
            stops: ``self._stops`` at the time of the request. A greater number now means that this caller
                has stopped the robot since.
            requested_ns: Time of the request. The gate refuses if anyone has stopped the robot since.
            lift: True lifts the lock of an e-stop, too.
        """
        self._processes.require_open()
        if self._stops != stops:
            return refusals.stopped_meanwhile(RESUME)
        # This is the longest time for arming, and a margin.
        within_s = self.driver.timing.arm_s + 2.0
        try:
            # Clocks of two hosts differ, so no time is sent to another host.
            when_ns = 0 if self._processes.elsewhere else requested_ns
            return await self._processes.gate.ask(Resume(self._processes.holder, lift, when_ns), within_s)
        except Unreachable as error:
            raise NotConnected(
                f"the process that talks to the robot ended while it armed the robot ({error}). Try again"
            ) from error

    # -- reading

    async def observe(self) -> Observation | Refused:
        self._processes.require()
        try:
            return _observed(await self._processes.gate.ask(GetObservation(), self._processes.patience.ask_s))
        except (AskTimeout, Unreachable) as failure:
            return unreachable("observe", failure)

    def observe_here(self) -> Observation | Refused:
        """Return an observation as ``observe`` does, but in the calling thread."""
        self._processes.require()
        try:
            return _observed(self._processes.gate.ask_here(GetObservation(), self._processes.patience.ask_s))
        except (AskTimeout, Unreachable) as failure:
            return unreachable("observe", failure)

    async def status(self) -> Status | None:
        """Return the gate's status; None if the wire process does not answer."""
        return await self._processes.status()

    @property
    def alive(self) -> bool:
        """Return False if it is certain that the robot's processes cannot answer any more."""
        return self._processes.alive

    async def is_guarded(self, within_s: float) -> bool:
        """Return True if the guardian (it stops the robot if the wire process fails) answers within this time."""
        return await self._processes.is_guarded(within_s)

    async def describe(self) -> TreeReport | None:
        """Return the processes and actors of the robot; None if nothing was started.

        The state is ``unreachable`` if the root process does not answer.
        """
        report = await self._processes.describe()
        if report is None and self._processes.started:
            return TreeReport(self.robot, UNREACHABLE, 0, (), ())
        return report


def processes_of(node: Node, nursery: trio.Nursery, entrance: Entrance, plan: Plan, driver: Driver) -> Processes:
    """Return the processes of a plan: of this program, of a host of this user, or of another computer."""
    if plan.attached:
        # Only a program with a robot of a host needs this import.
        from ..processes.attached_processes import AttachedProcesses

        return AttachedProcesses(nursery, plan, driver)
    if plan.parts:
        # Only a program with a robot of parts needs this import.
        from ..processes.parts_processes import PartsProcesses

        return PartsProcesses(node, nursery, entrance, plan, driver)
    if not plan.host_address:
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
