"""The transport: the only actor that writes to the robot.

Before each write the wire calls a permit, as its last step before the bytes leave. The permit checks
the epoch and the deadline, and that no stop waits in the mailbox. The transport also reads the robot,
and opens a lost link again after a growing pause. It never arms by itself.

If a link was lost while something was energised, the safe state is written before anything else: at
the loss, before each attempt to open the link, and at every stop, on whatever can still be written
(``Wire.reach``). This waits for no handshake, and a stop cuts a handshake short.

A stop is confirmed only when no earlier request can take effect any more (``asks.py``). Until then
the transport writes the safe state again and again.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import trio

from strands_actors.contract.driver import HOLDING_REASONS, ORDERED, Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, Observation, PermitDenied, ProcessSpent, Wire, WireDown
from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.realtime import memory, scheduling
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import AskTimeout, Ref, Unreachable
from strands_actors.kernel.processes.reserve import RESERVE
from strands_actors.kernel.refusals import Code
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
from strands_actors.supervisors.page import Owed
from strands_actors.supervisors.root.messages import Handover, Renew, SilentUntil
from strands_actors.supervisors.root.stop_channel import AGAIN_S, attempt_anew, not_reached, not_settled
from strands_actors.supervisors.wire.messages import Arm, CarryOut, Cycle, Cycled, HandOverAgain, MakeSafe, Write

from .asks import Asks
from .serving import Serving

ROOT_AGAIN_S = 0.01
REACH_MARGIN_S = 0.25
"""``Wire.reach`` is cancelled so long before ``Timing.safe_s`` is over."""
BACKOFF_S = (0.1, 0.2, 0.5, 1.0, 2.0)

SLOW = frozenset({SafeState.LAND, SafeState.SETTLE})
"""Safe states that take seconds to reach. A stop that comes meanwhile interrupts them."""

_PROMPT = (Write, Cycle)
"""Messages that a prompt wire handles without waiting."""


class _Permit:
    """The last check before a setpoint leaves: its epoch is the present one, its deadline has not
    passed, no stop waits, and the last hold has not failed."""

    __slots__ = ("_ask", "_deadline_ns", "_epoch", "_transport")

    def __init__(
        self, transport: Transport, epoch: int, deadline_ns: int, ask: Callable[[], None] | None = None
    ) -> None:
        self._transport = transport
        self._epoch = epoch
        self._deadline_ns = deadline_ns
        self._ask = ask  # notes a request that may take effect later

    def check(self) -> None:
        transport = self._transport
        if transport.epoch != self._epoch:
            raise PermitDenied(f"prepared in epoch {self._epoch}, now it is {transport.epoch}")
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
        guardian: Address of the guardian, in the root.
        epoch: The first epoch.
        energised: True if an earlier wire process may have left something energised.
        owed: The shared page on which root and standby read what may be energised.
    """

    def __init__(
        self,
        driver: Driver,
        gate: str,
        watchdog: str,
        guardian: str,
        epoch: int,
        energised: bool = False,
        owed: Owed | None = None,
    ) -> None:
        self._driver = driver
        self._addresses = gate, watchdog, guardian
        self.epoch = epoch
        self._wire: Wire | None = None
        self._serving = Serving()
        self._lost: Wire | None = None  # the last open wire, until another is open
        self._owed = owed or Owed()
        self._owed.safe_state = energised
        self._performing: trio.CancelScope | None = None
        self._spent = False  # an SDK hangs in this process, which can only write safe frames now
        self._last: Write | None = None
        timing = driver.timing
        self._keepalive_ns = round(timing.keepalive_s * NS)
        self._cycle_ns = round(max(1.0 / timing.control_hz, timing.tick_s) * NS)
        self._written_ns = 0  # when the last setpoint was last written
        self._writes = 0
        self._reads = 0
        self._denied = 0
        self._attempts = 0
        self._open_at_ns = 0

    @property
    def hold_failed(self) -> str:
        """Why the last hold failed; empty if it did not, and from the next arming on."""
        return "" if self._wire is None else self._wire.hold_failed

    async def started(self) -> None:
        gate, watchdog, guardian = self._addresses
        self._gate: Ref = self.context.ref(gate)
        self._watchdog: Ref = self.context.ref(watchdog)
        self._guardian: Ref = self.context.ref(guardian)
        self._asks = Asks(self._owed, self.context.clock)

    def is_prompt(self, message: Message) -> bool:
        kind = type(message)
        return kind is CarryOut or (kind in _PROMPT and self._wire is not None and self._wire.prompt)

    async def receive(self, message: Write | Cycle | MakeSafe | Arm | CarryOut | HandOverAgain) -> None:
        if self._spent and not isinstance(message, MakeSafe):
            return  # The root has been asked to end this process.
        try:
            await self._obey(message)
        except ProcessSpent as spent:
            self._spent = True
            self._guardian.tell(Renew(str(spent)))

    async def _obey(self, message: Write | Cycle | MakeSafe | Arm | CarryOut | HandOverAgain) -> None:
        match message:
            case Write():
                self._last = None
                if await self._write(message, message.deadline_ns):
                    self._last = message  # A setpoint that came too late is not re-sent either.
            case Cycle():
                await self._cycle(message)
            case MakeSafe():
                await self._make_safe(message)
            case Arm():
                await self._arm(message.epoch)
            case CarryOut():
                self._carry_out(message)
            case HandOverAgain():
                if self._wire is not None:
                    self._guardian.tell(Handover(tuple(self._wire.handover()), again=True))

    async def _write(self, write: Write, deadline_ns: int) -> bool:
        """Write a setpoint if its permit allows it. Return True if it was written."""
        if self._wire is None:
            return False
        wire, permit = self._wire, _Permit(self, write.epoch, deadline_ns)
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
        """Write the last setpoint again before ``Timing.keepalive_s`` is over.

        Cycles come once a control period. So a single setpoint is re-sent in the last cycle in which
        that is in time. A stream is re-sent only when its next setpoint is overdue, after
        ``keepalive_s``.

        Args:
            epoch: The epoch in which the watchdog allows re-sending; 0 allows none.
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

    # -- safe and armed

    async def _make_safe(self, message: MakeSafe) -> None:
        self.epoch = max(self.epoch, message.epoch)
        self._last = None
        if self._performing is not None:
            self._performing.cancel()
        # When a script ends, a robot that it had not energised is left alone.
        lasts = self._owed.safe_state or message.reason in ORDERED
        safe_state = self._owed.order(message.safe_state, lasts)
        holds = message.reason in HOLDING_REASONS and self._driver.energised(safe_state)
        began_ns = self.context.clock.now_ns()
        with contextlib.nullcontext() if holds else RESERVE.freed():
            motors = await self._bring_for_good(safe_state, holds, lasts)
        if motors is None:
            return  # A stop interrupted this; its report answers both.
        hold_failed = self.hold_failed if holds else ""
        seen = await self._look_where_held(motors) if holds and not hold_failed else None
        self._report_safe(message.reason, safe_state, message.epoch, began_ns, motors, hold_failed, seen)
        if not holds and not _all_safe(motors):
            RESERVE.end_if_short()
        if not _all_safe(motors) or hold_failed:
            return
        self._owed.confirm(safe_state)
        if not holds and self._wire is not None:
            self._owed.safe_state = False

    async def _bring_for_good(
        self, safe_state: SafeState, holds: bool, lasts: bool
    ) -> tuple[MotorReport, ...] | None:
        """Bring the robot to a safe state, again and again until no earlier request can take effect.

        Args:
            safe_state: The safe state.
            holds: True for a hold, during which the robot stays energised.
            lasts: True if the order also counts for a robot that is not connected.

        Returns:
            The reports of all motors, or None if a stop interrupted this.
        """
        clock, began_ns = self.context.clock, self.context.clock.now_ns()
        longest_s = settle_s(self._driver.timing.safe_s, self._driver.late_s)
        while True:
            unsettled_s = self._owed.unsettled_s(clock.now_ns())
            with self._busy(self._driver.timing.safe_s):
                motors = await self._bring(safe_state, holds, lasts)
            if motors is None or not unsettled_s or not _all_safe(motors) or (holds and self.hold_failed):
                return motors
            if self._spent or clock.now_ns() - began_ns > longest_s * NS:
                return not_settled(motors)  # Only the end of this process ends a call of its SDK.
            rested = False
            with self._busy(AGAIN_S[0]), self._cut_by_a_stop():
                await trio.sleep(min(unsettled_s, AGAIN_S[0]))
                rested = True
            if not rested:
                return None

    async def _bring(self, safe_state: SafeState, holds: bool, lasts: bool) -> tuple[MotorReport, ...] | None:
        """As ``_bring_for_good``, once."""
        began_ns = self.context.clock.now_ns()
        motors: tuple[MotorReport, ...] | None = ()
        if self._wire is not None:
            motors = None
            with self._cut_by_a_stop((holds or safe_state in SLOW) and self._wire.interruptible):
                motors = await self._wire.make_safe(safe_state)
        if motors is None or any(motor.written or motor.safe for motor in motors):
            return motors
        if holds and self._wire is not None:
            return motors  # On an open link the wire itself reports a failed hold (``hold_failed``).
        if self._wire is not None:
            self._lose(WireDown(next((motor.detail for motor in motors), "nothing can be written")))
        if not lasts:
            return motors
        # An order counts for a robot that was never connected, too.
        reached: tuple[MotorReport, ...] | None = None
        with self._cut_by_a_stop(safe_state in SLOW):
            reached = await self._reach(safe_state, began_ns)
        return None if reached is None else reached or motors

    async def _look_where_held(self, motors: tuple[MotorReport, ...]) -> Observation | None:
        """Read the robot after a hold if its report lacks positions. With an older observation the next command
        would move axes that it does not name back to where they were before."""
        if all(motor.target is not None or not motor.safe for motor in motors):
            return None
        try:
            return await self._read()
        except WireDown as down:
            self._lose(down)
            return None

    async def _reach(self, safe_state: SafeState, began_ns: int) -> tuple[MotorReport, ...]:
        """Write the safe state although there is no link. Return no reports if it took too long."""
        if self._lost is None:
            self._lost = self._driver.open_wire(self.context.clock)
        passed_s = (self.context.clock.now_ns() - began_ns) / NS
        with trio.move_on_after(self._driver.timing.safe_s - REACH_MARGIN_S - passed_s):
            # A wire that cannot do it leaves it to a new stop channel, which needs no handshake either.
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
        seen: Observation | None = None,
    ) -> None:
        now_ns = self.context.clock.now_ns()
        took_ms = (now_ns - began_ns) / 1e6
        motors = motors or not_reached(self._driver, "no link")
        report = StopReport(reason, safe_state, epoch, _all_safe(motors), motors, took_ms=took_ms, at_ns=now_ns)
        self._gate.tell(SafeDone(report, hold_failed, seen))

    async def _arm(self, epoch: int) -> None:
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
                    self._owed.safe_state = True
                    self._owed.begin_anew()
                    error = "a stop came before the robot was armed"
                    self._wire.hold_failed = ""
                    late_s = self._driver.timing.late_s
                    with self._cut_by_a_stop(self._wire.interruptible), self._asks.asking(late_s) as request:
                        observation = await self._wire.arm(_Permit(self, epoch, 0, request.begin))
                        request.answered = True
        except (WireDown, PermitDenied, trio.TooSlowError) as failure:
            error = str(failure) or busy.explained(f"arming took longer than {arm_s:g} s")
        self._gate.tell(ArmDone(epoch, observation, error))

    # -- the driver's own services

    def _carry_out(self, message: CarryOut) -> None:
        wire = self._wire
        if wire is None or self._performing is not None:
            busy = "the link was lost" if wire is None else "another service is being carried out"
            refusal = Refused(Code.BUSY, busy, "try again when that is over", verb=message.service)
            self._gate.tell(CarriedOut(message.number, {}, refusal))
            return
        service = self._driver.SERVICES[message.service]
        if service.moves or service.ends_motion:
            self._last = None
        self._performing = trio.CancelScope()
        self.context.start_soon(self._perform, wire, message, self._performing)

    async def _perform(self, wire: Wire, message: CarryOut, scope: trio.CancelScope) -> None:
        service = message.service
        answer: dict[str, Any] | Refused = Refused(Code.STOPPED, "stopped meanwhile", "ask again after that")
        known = self._driver.SERVICES[service]
        within_s = known.within_s
        scope.deadline = trio.current_time() + within_s
        try:
            with scope, self._asks.asking(known.late_s, known.powers) as request:
                permit = _Permit(self, message.epoch, 0, request.begin)
                answer = await wire.perform(service, message.arguments, permit)
                request.answered = not isinstance(answer, Refused)
        except PermitDenied:
            pass
        except WireDown as down:
            answer = Refused(Code.NOT_CONNECTED, str(down))
        if scope.cancelled_caught and trio.current_time() >= scope.deadline:
            why = busy.explained(f"the robot did not do so within {within_s:g} s")
            answer = Refused(Code.TIMEOUT, why, "look at the robot")
        self._performing = None
        result, refusal = ({}, answer.about(service)) if isinstance(answer, Refused) else (answer, None)
        moved = known.moves
        self._gate.tell(CarriedOut(message.number, result, refusal, moved))

    # -- the link

    async def _open(self, number: int) -> None:
        now_ns = self.context.clock.now_ns()
        if now_ns < self._open_at_ns:
            return
        if self._owed.safe_state:
            await self._settle(number)
            if self.context.urgent_waiting:
                return  # A stop waits, and will do the same.
        wire, open_s = self._driver.open_wire(self.context.clock), self._driver.timing.open_s
        opened = False
        try:
            with (
                self._cut_by_a_stop(),
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
                raise WireDown("a stop came before the robot had answered")
        except (WireDown, trio.TooSlowError) as failure:
            self._serving.scope.cancel()
            wire.close()
            why = str(failure) or busy.explained(f"the robot did not answer within {open_s:g} s")
            self._back_off(why)
        except trio.Cancelled:
            if wire.handover():
                wire.close()  # The process that stops the robot instead opens the port anew.
            raise
        else:
            if self._lost is not None:
                self._lost.close()
            self._wire, self._lost = wire, None
            self._attempts = 0
            facts = {**facts, "scheduling": scheduling(), "memory": memory()}
            self._gate.tell(LinkUp(facts, observation))

    def descriptors(self) -> tuple[int, ...]:
        """Return duplicates of the open wire's descriptors. The caller stops the robot with them when
        this actor no longer runs, and has to close them."""
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
        safe_state = self._owed.order(self._driver.fallbacks[Reason.LINK])
        began_ns = self.context.clock.now_ns()
        with self._cut_by_a_stop(), self._busy(self._driver.timing.safe_s, number):
            motors = await self._reach(safe_state, began_ns)
            if not _all_safe(motors):
                RESERVE.end_if_short()
            if any(motor.written for motor in motors):
                if self._owed.unsettled_s(began_ns):
                    motors = not_settled(motors)  # The stop after the next link-up waits for that.
                self._report_safe(Reason.LINK, safe_state, self.epoch, began_ns, motors)

    def _cut_by_a_stop(self, may_be: bool = True) -> contextlib.AbstractContextManager[None]:
        """Return a block that a waiting stop interrupts. Its assignments may then be missing."""
        return self.context.until_urgent() if may_be else contextlib.nullcontext()

    async def _hand_over(self, wire: Wire) -> None:
        """Give the root its way to the hardware, without which nothing is armed."""
        handover, handover_s = Handover(tuple(wire.handover())), self._driver.timing.handover_s
        until_s = trio.current_time() + handover_s
        while True:
            try:
                answer = await self._guardian.ask(handover, handover_s)
                break
            except (AskTimeout, Unreachable) as failure:
                # A root that waits for a processor is unreachable until it has announced its actors.
                if isinstance(failure, AskTimeout) or trio.current_time() >= until_s:
                    raise WireDown(f"the root did not take its path to the hardware: {failure}") from failure
                await trio.sleep(ROOT_AGAIN_S)
        if isinstance(answer, Refused):
            raise WireDown(f"the root has no path to the hardware: {answer.reason}")

    def _lose(self, down: WireDown) -> None:
        """Close a lost link. If something may be energised it stays open, for the safe state that the
        next cycle writes."""
        if self._wire is not None:
            if self._performing is not None:
                self._performing.cancel()
            self._serving.scope.cancel()
            lost = self._lost = self._wire
            self._wire = None
            # Most links are lost by silence, and a busy computer may be the reason for it.
            self._back_off(busy.explained(str(down)))
            if self._owed.safe_state:
                self._open_at_ns = 0
            else:
                lost.close()

    def _back_off(self, why: str) -> None:
        pause_s = BACKOFF_S[min(self._attempts, len(BACKOFF_S) - 1)]
        self._attempts += 1
        self._open_at_ns = self.context.clock.now_ns() + round(pause_s * NS)
        self._gate.tell(LinkLost(why))

    @contextlib.contextmanager
    def _waiting(self) -> Iterator[None]:
        """Wait for the robot until a stop comes. If the driver declares that this may take longer than a
        heartbeat, tell the watchdog."""
        with contextlib.ExitStack() as stack:
            if self._driver.timing.call_s:
                stack.enter_context(self._busy(self._driver.timing.call_s))
            stack.enter_context(self.context.until_urgent())
            yield

    @contextlib.contextmanager
    def _busy(self, at_most_s: float, number: int = 0) -> Iterator[None]:
        """Tell the watchdog of a bounded operation, so that it does not miss replies meanwhile."""
        until_ns = self.context.clock.now_ns() + round(at_most_s * NS)
        self._watchdog.tell(Cycled(number, until_ns))
        try:
            yield
        finally:
            self._watchdog.tell(Cycled(number))

    @contextlib.contextmanager
    def _silent(self) -> Iterator[None]:
        """Announce to root and standby that this process may be silent, because an SDK keeps the
        interpreter's lock."""
        silent_s = self._driver.timing.silent_s
        if not silent_s:
            yield
            return
        until_ns = self.context.clock.now_ns() + round(silent_s * NS)
        self._guardian.tell(SilentUntil(until_ns))
        self._owed.silent_until_ns = until_ns
        try:
            yield
        finally:
            self._owed.silent_until_ns = 0
            self._guardian.tell(SilentUntil(0))


def _all_safe(motors: tuple[MotorReport, ...]) -> bool:
    return bool(motors) and all(motor.safe for motor in motors)
