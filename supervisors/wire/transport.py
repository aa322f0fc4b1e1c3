"""The transport: the only actor that writes to the robot. It also reads the robot.

Before each write the wire calls a permit, as its last step before the bytes are sent. The permit checks the epoch,
the deadline, and that no stop waits in the mailbox. After a lost link the transport connects again, with growing
pauses. It never arms the robot by itself.

If the link was lost while something was energised, the safe state is written before anything else: when the link is
lost, before each attempt to connect, and at every stop. It is written on every connection that still accepts bytes
(``Wire.reach``), without waiting for a handshake. If a stop comes during a handshake, the handshake is cancelled.

A stop is confirmed only when no earlier request can take effect any more (``late_requests.py``). Until then the
transport writes the safe state again and again.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import trio

from strands_actors.contract.driver import HOLDING_REASONS, ORDERED, Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import (
    MotorReport,
    Observation,
    PermitDenied,
    ProcessSpent,
    Wire,
    WireDown,
    all_safe,
)
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.realtime import memory, scheduling
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.supervisors.deadlines import settle_s
from strands_actors.supervisors.gate.messages import (
    ArmDone,
    CarriedOut,
    LinkLost,
    LinkUp,
    Observed,
    SafeDone,
    StopReport,
)
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.refusals import link_lost
from strands_actors.supervisors.root.messages import Handover, Renew, SilentUntil
from strands_actors.supervisors.root.stop_channel import AGAIN_S, attempt_anew, not_reached, not_settled
from strands_actors.supervisors.wire.messages import Arm, CarryOut, Cycle, Cycled, HandOverAgain, MakeSafe, Write

from . import refusals
from .late_requests import LateRequests
from .serving import Serving

ROOT_AGAIN_S = 0.01
REACH_MARGIN_S = 0.25
"""``Wire.reach`` is cancelled this many seconds before ``Timing.safe_s`` have passed."""
BACKOFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)

SLOW = frozenset({SafeState.LAND, SafeState.LOWERED, SafeState.SETTLE})
"""Safe states that take seconds to reach. A stop that comes meanwhile interrupts them."""

_PROMPT = (Write, Cycle)
"""Messages that a prompt wire handles without waiting."""


class _Permit:
    """The last check before a setpoint is sent. It fails if the epoch (a counter of stops and holds) has changed,
    the deadline has passed, a stop waits, or the last hold has failed."""

    __slots__ = ("_ask", "_deadline_ns", "_epoch", "_transport")

    def __init__(
        self, transport: Transport, epoch: int, deadline_ns: int, ask: Callable[[], None] | None = None
    ) -> None:
        self._transport = transport
        self._epoch = epoch
        self._deadline_ns = deadline_ns
        self._ask = ask  # notes on the shared page that a request may take effect later

    def check(self) -> None:
        transport = self._transport
        if transport.epoch != self._epoch:
            raise PermitDenied("the robot has stopped or held since this command was made")
        if transport.hold_failed:
            raise PermitDenied("the robot could not hold, and was stopped")
        if self._deadline_ns and transport.context.clock.now_ns() >= self._deadline_ns:
            raise PermitDenied("past its deadline")
        if transport.context.urgent_waiting:
            raise PermitDenied("a stop is waiting")
        if self._ask is not None:
            self._ask()


class Transport(Actor):
    """Write to one robot and read it.

    Args:
        driver: The driver of the robot.
        gate: Address of the gate.
        watchdog: Address of the watchdog.
        guardian: Address of the guardian, in the root process.
        epoch: First value of the epoch, a counter of stops and holds. A setpoint that was made in another epoch is
            not written.
        energised: True if an earlier wire process may have left something energised.
        safety_page: The shared page on which root and standby read if anything may be energised.
    """

    def __init__(
        self,
        driver: Driver,
        gate: str,
        watchdog: str,
        guardian: str,
        epoch: int,
        energised: bool = False,
        safety_page: SafetyPage | None = None,
    ) -> None:
        self._driver = driver
        self._addresses = gate, watchdog, guardian
        self.epoch = epoch
        self._wire: Wire | None = None
        self._serving = Serving()
        self._lost: Wire | None = None  # the connection that was lost last, until a new one is open
        self._safety_page = safety_page or SafetyPage()
        self._safety_page.may_be_energised = energised
        self._performing: trio.CancelScope | None = None
        # True if a call of an SDK hangs: this process can then only stop the robot.
        self._replacement_requested = False
        self._last: Write | None = None
        self._reason = ""  # the reason of the newest stop or hold
        timing = driver.timing
        self._keepalive_ns = round(timing.keepalive_s * NS)
        self._cycle_ns = round(max(1.0 / timing.control_hz, timing.tick_s) * NS)
        self._written_ns = 0  # when the last setpoint was last sent
        self._writes = 0
        self._reads = 0
        self._denied = 0
        self._attempts = 0
        self._open_at_ns = 0
        self._written_ns = 0  # Time at which the running stop began to wait for replies; 0 before.

    @property
    def hold_failed(self) -> str:
        """Return why the last hold failed. Empty if it did not fail, or if the robot was armed since."""
        return "" if self._wire is None else self._wire.hold_failed

    async def started(self) -> None:
        gate, watchdog, guardian = self._addresses
        self._gate: Ref = self.context.ref(gate)
        self._watchdog: Ref = self.context.ref(watchdog)
        self._guardian: Ref = self.context.ref(guardian)
        self._late_requests = LateRequests(self._safety_page, self.context.clock)

    def is_prompt(self, message: Message) -> bool:
        message_type = type(message)
        return message_type is CarryOut or (
            message_type in _PROMPT and self._wire is not None and self._wire.prompt
        )

    async def receive(self, message: Write | Cycle | MakeSafe | Arm | CarryOut | HandOverAgain) -> None:
        if self._replacement_requested and not isinstance(message, MakeSafe):
            # The root was already asked to replace this process.
            return
        try:
            await self._obey(message)
        except ProcessSpent as error:
            self._replacement_requested = True
            self._guardian.tell(Renew(str(error)))

    async def _obey(self, message: Write | Cycle | MakeSafe | Arm | CarryOut | HandOverAgain) -> None:
        match message:
            case Write():
                self._last = None
                if await self._write(message, message.deadline_ns):
                    # A setpoint whose deadline had passed is not sent again either.
                    self._last = message
            case Cycle():
                await self._cycle(message)
            case MakeSafe():
                await self._make_safe(message)
            case Arm():
                await self._arm(message)
            case CarryOut():
                self._carry_out(message)
            case HandOverAgain():
                if self._wire is not None:
                    self._guardian.tell(Handover(tuple(self._wire.handover()), again=True))

    async def _write(self, write: Write, deadline_ns: int) -> bool:
        """Write a setpoint if its last check before sending (its permit) passes. Return True if it was written."""
        if self._wire is None:
            return False
        wire, permit = self._wire, _Permit(self, write.epoch, deadline_ns)
        wire.expires_ns, wire.streamed = write.expires_ns, write.streamed
        written = False
        try:
            if wire.prompt:
                await wire.write(write.values, permit)
                written = True
            else:
                with self._waiting():
                    await wire.write(write.values, permit)
                    written = True
        except PermitDenied:
            self._denied += 1
        except WireDown as down:
            self._lose(down)
        if written:
            self._writes += 1
            self._written_ns = self.context.clock.now_ns()
        return written

    async def _cycle(self, cycle: Cycle) -> None:
        if self._wire is None:
            await self._open(cycle.number)
        else:
            await self._resend(cycle.resend_epoch)
            try:
                self._serving.check()
                if cycle.feed:
                    await self._feed()
                await self._read()
            except WireDown as down:
                self._lose(down)
        self._watchdog.tell(Cycled(cycle.number))

    async def _resend(self, epoch: int) -> None:
        """Send the last setpoint again before ``Timing.keepalive_s`` have passed.

        This is called once in each control period. A single setpoint is sent in the last period before the time is
        over. A stream has its next setpoint soon, so its last setpoint is sent again only after ``keepalive_s``.

        Args:
            epoch: The watchdog allows this while the epoch (a counter of stops and holds) has this value; 0
                forbids it.
        """
        last = self._last
        if last is None or epoch != last.epoch:
            return
        next_ns = 0 if last.streamed else self._cycle_ns
        if self.context.clock.now_ns() + next_ns >= self._written_ns + self._keepalive_ns:
            await self._write(last, last.expires_ns)

    async def _feed(self) -> None:
        if self._wire is not None:
            with self._waiting():
                await self._wire.feed()

    async def _read(self) -> Observation | None:
        wire, observation = self._wire, None
        if wire is None:
            return None
        if wire.prompt:
            observation = await wire.read()
        else:
            with self._waiting():
                observation = await wire.read()
        if observation is not None:
            self._reads += 1
            self._gate.tell(Observed(observation, self._writes, self._reads))
        return observation

    # -- stops and arming

    async def _make_safe(self, message: MakeSafe) -> None:
        self.epoch = max(self.epoch, message.epoch)
        self._last = None
        self._reason = str(message.reason)
        if self._performing is not None:
            self._performing.cancel()
        if self._wire is not None:
            self._wire.reason = self._reason
        # If a script ends that has not energised the robot, the robot is left as it is.
        lasts = self._safety_page.may_be_energised or message.reason in ORDERED
        safe_state = self._safety_page.order(message.safe_state, lasts)
        holds = message.reason in HOLDING_REASONS and self._driver.energised(safe_state)
        began_ns, self._written_ns = self.context.clock.now_ns(), 0
        with contextlib.nullcontext() if holds else RESERVE.freed():
            motors = await self._bring_until_settled(safe_state, holds, lasts)
        if motors is None:
            # Another stop interrupted this one. Its report answers both orders.
            return
        if self._wire is not None and self._wire.ended_in is not None:
            safe_state = self._wire.ended_in
        hold_failed = self.hold_failed if holds else ""
        observation = await self._read_held_position(motors) if holds and not hold_failed else None
        self._report_safe(message.reason, safe_state, message.epoch, began_ns, motors, hold_failed, observation)
        if not holds and not all_safe(motors):
            RESERVE.end_if_short()
        if not all_safe(motors) or hold_failed:
            return
        self._safety_page.confirm(safe_state)
        if not holds and self._wire is not None:
            self._safety_page.may_be_energised = False

    async def _bring_until_settled(
        self, safe_state: SafeState, holds: bool, lasts: bool
    ) -> tuple[MotorReport, ...] | None:
        """Bring the robot to a safe state. Repeat this until no earlier request can take effect any more.

        Args:
            safe_state: The safe state.
            holds: True for a hold, in which the motors stay energised.
            lasts: True if the order also counts for a robot that is not connected.

        Returns:
            The reports of all motors, or None if another stop has interrupted this.
        """
        clock, began_ns = self.context.clock, self.context.clock.now_ns()
        longest_s = settle_s(self._driver.timing.safe_s, self._driver.late_s)
        while True:
            unsettled_s = self._safety_page.unsettled_s(clock.now_ns())
            with self._busy(self._driver.timing.safe_s):
                motors = await self._bring(safe_state, holds, lasts)
            if motors is None or not unsettled_s or not all_safe(motors) or (holds and self.hold_failed):
                return motors
            if self._replacement_requested or clock.now_ns() - began_ns > longest_s * NS:
                # The request is in a call of an SDK, and only the end of this process ends that call.
                return not_settled(motors)
            rested = False
            with self._busy(AGAIN_S[0]), self._cancelled_by_stop():
                await trio.sleep(min(unsettled_s, AGAIN_S[0]))
                rested = True
            if not rested:
                return None

    async def _bring(self, safe_state: SafeState, holds: bool, lasts: bool) -> tuple[MotorReport, ...] | None:
        """Bring the robot to a safe state once. Arguments and result are those of ``_bring_until_settled``."""
        began_ns = self.context.clock.now_ns()
        motors: tuple[MotorReport, ...] | None = ()
        if self._wire is not None:
            motors, self._wire.ended_in = None, None
            with (
                self._cancelled_by_stop((holds or safe_state in SLOW) and self._wire.interruptible),
                self._published(self._wire, safe_state in SLOW),
            ):
                # This runs when ``make_safe`` waits for the first time. By then the first frame is written.
                trio.lowlevel.current_trio_token().run_sync_soon(self._note_written)
                motors = await self._wire.make_safe(safe_state)
        if motors is None or any(motor.written or motor.safe for motor in motors):
            return motors
        if holds and self._wire is not None:
            # While connected, the wire itself reports a failed hold (``hold_failed``).
            return motors
        if self._wire is not None:
            self._lose(WireDown(next((motor.detail for motor in motors), "nothing can be written")))
        if not lasts:
            return motors
        # The order also counts for a robot that was never connected.
        reached: tuple[MotorReport, ...] | None = None
        with self._cancelled_by_stop(safe_state in SLOW):
            reached = await self._reach(safe_state, self._reason, began_ns)
        return None if reached is None else reached or motors

    def _note_written(self) -> None:
        self._written_ns = self._written_ns or self.context.clock.now_ns()

    @contextlib.contextmanager
    def _published(self, wire: Wire, is_slow: bool) -> Iterator[None]:
        """Publish the readings of a slow stop during the block."""
        scope = trio.CancelScope()
        if is_slow:
            self.context.start_soon(self._publish, wire, scope)
        try:
            yield
        finally:
            scope.cancel()

    async def _publish(self, wire: Wire, scope: trio.CancelScope) -> None:
        published = None
        with scope:
            while True:
                await trio.sleep(self._cycle_ns / NS)
                if (seen := wire.seen) is not None and seen is not published:
                    published = seen
                    self._gate.tell(Observed(seen, self._writes, self._reads))

    async def _read_held_position(self, motors: tuple[MotorReport, ...]) -> Observation | None:
        """Read the robot after a hold, if the report of the hold has no positions. Otherwise the next command would
        start from an older observation, and would move axes that it does not name back to their old positions."""
        if all(motor.target is not None or not motor.safe for motor in motors):
            return None
        try:
            return await self._read()
        except WireDown as down:
            self._lose(down)
            return None

    async def _reach(self, safe_state: SafeState, reason: str, began_ns: int) -> tuple[MotorReport, ...]:
        """Write the safe state to a robot that is not connected, on any connection that still works. Return no
        reports if this takes too long."""
        if self._lost is None:
            self._lost = self._driver.open_wire(self.context.clock)
        self._lost.reason = reason
        passed_s = (self.context.clock.now_ns() - began_ns) / NS
        with trio.move_on_after(self._driver.timing.safe_s - REACH_MARGIN_S - passed_s):
            # If the wire cannot write without a handshake, a new stop channel is opened, which needs no handshake.
            return await self._lost.reach(safe_state) or await attempt_anew(
                self._driver, self.context.clock, safe_state
            )
        return ()

    def _report_safe(
        self,
        reason: Reason,
        safe_state: SafeState,
        epoch: int,
        began_ns: int,
        motors: tuple[MotorReport, ...],
        hold_failed: str = "",
        observation: Observation | None = None,
    ) -> None:
        now_ns = self.context.clock.now_ns()
        took_ms = (now_ns - began_ns) / 1e6
        motors = motors or not_reached(self._driver, "no link")
        written_ms = max(0.0, (self._written_ns - began_ns) / 1e6)
        confirmed = all_safe(motors)
        report = StopReport(
            reason, safe_state, epoch, confirmed, motors, took_ms=took_ms, at_ns=now_ns, written_ms=written_ms
        )
        self._gate.tell(SafeDone(report, hold_failed, observation))

    async def _arm(self, message: Arm) -> None:
        epoch = message.epoch
        if epoch <= self.epoch:
            return
        self.epoch = epoch
        self._last = None
        observation: Observation | None = None
        error = "the link was lost"
        arm_s = self._driver.timing.arm_s
        try:
            with self._busy(arm_s), self._silent(), trio.fail_after(arm_s):
                if missing := RESERVE.check():
                    raise WireDown(f"the wire process could not stop the robot: {missing}")
                if self._wire is not None:
                    self._safety_page.may_be_energised = True
                    self._safety_page.begin_anew()
                    error = "a stop came before the robot was armed"
                    self._wire.hold_failed, self._wire.lifts = "", message.lifts
                    late_s = self._driver.timing.late_s
                    with (
                        self._cancelled_by_stop(self._wire.interruptible),
                        self._late_requests.asking(late_s) as request,
                    ):
                        observation = await self._wire.arm(_Permit(self, epoch, 0, request.begin))
                        request.answered = True
        except (WireDown, PermitDenied, trio.TooSlowError) as failure:
            error = str(failure) or busy.explained(f"arming took longer than {arm_s:g} s")
        self._gate.tell(ArmDone(epoch, observation, error))

    # -- services of the driver

    def _carry_out(self, message: CarryOut) -> None:
        wire = self._wire
        if wire is None or self._performing is not None:
            name = message.service
            refusal = refusals.service_without_link(name) if wire is None else refusals.other_running_service(name)
            self._gate.tell(CarriedOut(message.number, {}, refusal))
            return
        service = self._driver.SERVICES[message.service]
        if service.moves or service.ends_motion:
            self._last = None
        self._performing = trio.CancelScope()
        self.context.start_soon(self._perform, wire, message, self._performing)

    async def _perform(self, wire: Wire, message: CarryOut, scope: trio.CancelScope) -> None:
        service = message.service
        answer: dict[str, Any] | Refused = refusals.stopped_meanwhile()
        declared = self._driver.SERVICES[service]
        within_s = declared.within_s
        scope.deadline = trio.current_time() + within_s
        try:
            with scope, self._late_requests.asking(declared.late_s, declared.powers) as request:
                permit = _Permit(self, message.epoch, 0, request.begin)
                answer = await wire.perform(service, message.arguments, permit)
                request.answered = not isinstance(answer, Refused)
        except PermitDenied:
            pass
        except WireDown as down:
            answer = link_lost(str(down))
        if scope.cancelled_caught and trio.current_time() >= scope.deadline:
            answer = busy.with_load(refusals.not_finished(within_s))
        self._performing = None
        result, refusal = ({}, answer.about(service)) if isinstance(answer, Refused) else (answer, None)
        moved = declared.moves
        self._gate.tell(CarriedOut(message.number, result, refusal, moved))

    # -- the link to the robot: open, hand over and close it

    async def _open(self, number: int) -> None:
        now_ns = self.context.clock.now_ns()
        if now_ns < self._open_at_ns:
            return
        if self._safety_page.may_be_energised:
            await self._settle(number)
            if self.context.urgent_waiting:
                # A stop waits, and will also write the safe state.
                return
        wire, open_s = self._driver.open_wire(self.context.clock), self._driver.timing.open_s
        opened = False
        try:
            with (
                self._cancelled_by_stop(),
                self._busy(open_s, number),
                self._silent(),
                trio.fail_after(open_s),
            ):
                facts = await wire.open()
                await self._serve(wire)
                observation = await wire.read()
                await self._hand_over(wire)
                opened = True
            if not opened:
                raise WireDown("a stop interrupted the connection")
        except (WireDown, trio.TooSlowError) as failure:
            self._serving.scope.cancel()
            wire.close()
            reason = str(failure) or busy.explained(f"the robot did not answer within {open_s:g} s")
            self._back_off(reason)
        except trio.Cancelled:
            if wire.handover():
                # Close the port, since the process that takes over must open it.
                wire.close()
            raise
        else:
            if self._lost is not None:
                self._lost.close()
            self._wire, self._lost = wire, None
            self._attempts = 0
            facts = {**facts, "scheduling": scheduling(), "memory": memory()}
            self._gate.tell(LinkUp(facts, observation))

    def descriptors(self) -> tuple[int, ...]:
        """Return duplicates of the open file descriptors of the wire. The caller uses them to stop the robot after
        this actor has ended, and must close them."""
        wire = self._wire or self._lost
        return () if wire is None else tuple(os.dup(fd) for fd in wire.handover())

    def close(self) -> None:
        """Close the port after this actor has ended."""
        for wire in (self._wire, self._lost):
            if wire is not None:
                wire.close()
        self._wire = self._lost = None

    async def _serve(self, wire: Wire) -> None:
        self._serving = serving = Serving()
        self.context.start_soon(serving.run, wire)
        await serving.ready.wait()
        serving.check()

    async def _settle(self, number: int) -> None:
        """Write the safe state before a lost link is opened again."""
        safe_state = self._safety_page.order(self._driver.fallbacks[Reason.LINK])
        began_ns = self.context.clock.now_ns()
        with self._cancelled_by_stop(), self._busy(self._driver.timing.safe_s, number):
            motors = await self._reach(safe_state, str(Reason.LINK), began_ns)
            if not all_safe(motors):
                RESERVE.end_if_short()
            if any(motor.written for motor in motors):
                if self._safety_page.unsettled_s(began_ns):
                    # The stop after the next connection waits until no request can take effect.
                    motors = not_settled(motors)
                self._report_safe(Reason.LINK, safe_state, self.epoch, began_ns, motors)

    def _cancelled_by_stop(self, may_be: bool = True) -> contextlib.AbstractContextManager[None]:
        """Return a context manager whose block is cancelled when a stop comes. After that, an assignment at the end
        of the block may not have been made."""
        return self.context.until_urgent() if may_be else contextlib.nullcontext()

    async def _hand_over(self, wire: Wire) -> None:
        """Hand over file descriptors to the root, for stop channels that reach the robot without this process.
        Without them the robot cannot be armed."""
        handover, handover_s = Handover(tuple(wire.handover())), self._driver.timing.handover_s
        until_s = trio.current_time() + handover_s
        while True:
            try:
                answer = await self._guardian.ask(handover, handover_s)
                break
            except (AskTimeout, Unreachable) as failure:
                # A root that waits for a processor cannot be reached until it has started its actors.
                if isinstance(failure, AskTimeout) or trio.current_time() >= until_s:
                    raise WireDown(f"the root process did not answer: {failure}") from failure
                await trio.sleep(ROOT_AGAIN_S)
        if isinstance(answer, Refused):
            raise WireDown(f"the root process could not connect to the robot: {answer.reason}")

    def _lose(self, down: WireDown) -> None:
        """Close a link that was lost. If something may be energised, keep it open until the next cycle has written
        the safe state on it."""
        if self._wire is not None:
            if self._performing is not None:
                self._performing.cancel()
            self._serving.scope.cancel()
            lost = self._lost = self._wire
            self._wire = None
            # Most links are lost because no answer comes. The reason may be a busy computer, so the text mentions
            # that.
            self._back_off(busy.explained(str(down)))
            if self._safety_page.may_be_energised:
                self._open_at_ns = 0
            else:
                lost.close()

    def _back_off(self, reason: str) -> None:
        pause_s = BACKOFF_S[min(self._attempts, len(BACKOFF_S) - 1)]
        self._attempts += 1
        self._open_at_ns = self.context.clock.now_ns() + round(pause_s * NS)
        self._gate.tell(LinkLost(reason))

    @contextlib.contextmanager
    def _waiting(self) -> Iterator[None]:
        """Run a ``with`` block that waits for the robot. A stop cancels the block. If the driver declares that a
        call may take longer than a heartbeat, inform the watchdog."""
        with contextlib.ExitStack() as stack:
            if self._driver.timing.call_s:
                stack.enter_context(self._busy(self._driver.timing.call_s))
            stack.enter_context(self.context.until_urgent())
            yield

    @contextlib.contextmanager
    def _busy(self, at_most_s: float, number: int = 0) -> Iterator[None]:
        """Inform the watchdog that the ``with`` block may take ``at_most_s`` seconds, so that it expects no replies
        meanwhile."""
        until_ns = self.context.clock.now_ns() + round(at_most_s * NS)
        self._watchdog.tell(Cycled(number, until_ns))
        try:
            yield
        finally:
            self._watchdog.tell(Cycled(number))

    @contextlib.contextmanager
    def _silent(self) -> Iterator[None]:
        """Announce to root and standby that this process may send no heartbeats, because a library holds the
        interpreter's lock."""
        silent_s = self._driver.timing.silent_s
        if not silent_s:
            yield
            return
        until_ns = self.context.clock.now_ns() + round(silent_s * NS)
        self._guardian.tell(SilentUntil(until_ns))
        self._safety_page.silent_until_ns = until_ns
        try:
            yield
        finally:
            self._safety_page.silent_until_ns = 0
            self._guardian.tell(SilentUntil(0))
