"""The guardian: the root's actor that keeps a wire running, and stops the robot when it does not.

When the wire process is silent or dies, the guardian

1. writes the safe frame by the root's stop channel,
2. fences the wire: kills it and waits for its end, since a frozen process would write again,
3. writes the safe frame again, and reads every motor back.

The first frame covers the death of the root between 1 and 3. Before it, the wire is alive and stops
the robot when it misses its root. After it, the robot has got the safe frame.

An unconfirmed stop is repeated for ``INSIST_S`` before the next wire is started. If the tree ends,
and no other wire follows, it is repeated for ``LINGER_S``.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from functools import partial

import msgspec
import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport
from strands_actors.kernel.actor import Actor, Deferred
from strands_actors.kernel.clock import NS
from strands_actors.kernel.health import busy
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.heartbeat import Heartbeat
from strands_actors.kernel.health.processor import Life, Standing, life_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Ref
from strands_actors.kernel.processes.child import report_failure
from strands_actors.supervisors.gate.failsafe import SAFE, Mode, State
from strands_actors.supervisors.gate.messages import LockKept, Stopped, StoppedAt, StopReport
from strands_actors.supervisors.page import Owed
from strands_actors.supervisors.root.messages import (
    Decided,
    Fence,
    HandedOver,
    Handover,
    Happened,
    Renew,
    SilentUntil,
    StateIs,
)
from strands_actors.supervisors.wire.messages import HandOverAgain
from strands_actors.supervisors.wire.watchdog import Tick

from .channel_keeper import ChannelKeeper
from .guarded import GuardedStandby, GuardedWire
from .lock_keeper import Kept, LockKeeper
from .stop_channel import INSIST_S, LINGER_S, all_safe, attempt, attempt_anew, pauses_s, settled
from .stopped_detector import LOOK_EVERY, LOOKS, StoppedDetector

START_DEADLINE_S = 5.0
"""Longest time from the start of a wire process to its first heartbeat. It computes for a quarter of
a second, half a second with an SDK, and may get a tenth of a processor. A stopped process is noticed
earlier. After its handover a wire must send heartbeats at once, since it may have energised the
robot."""
RENEW_PAUSE_S = 0.05
FENCE_AGAIN_S = 0.1
END_S = 0.5
"""Time for a wire that has confirmed its stop to exit. Then it is fenced."""
DYING = "the wire process dies"
"""The reason for a broken wire until its exit code is known."""


class WireBroken(Exception):
    """The wire has ended. It was fenced, and the robot was stopped."""


class Guardian(Actor):
    """Keep the wire of one robot.

    Args:
        driver: The driver of the robot.
        heartbeat: The heartbeats of root and wire, on a shared page.
        start_wire: Start a wire from a failsafe state, with the cause of that state.
        on_state: Called at each change of the failsafe state.
        gate: Address of the gate. It gets a message when a writer was stopped (SIGSTOP), and when the lock of
            an e-stop is on the disk.
        writers: Return the process ids that may write setpoints.
        keeper: Writes the locks of e-stops; None in tests with one process.
        on_report: Called with the result of each stop that the guardian makes.
        on_dying: Called with a writer that was killed and has not exited yet.
        standby: The standby; None in tests with one process.
        transport: Address of the transport.
        owed: The shared page that tells the standby if anything may be energised.
        on_decided: Called with each decision of the gate, for the audit.
        on_failed: Called after each unconfirmed attempt.
    """

    def __init__(
        self,
        driver: Driver,
        heartbeat: Heartbeat,
        start_wire: Callable[[State, str], GuardedWire],
        on_state: Callable[[StateIs], None] | None = None,
        gate: str = "",
        writers: Callable[[], Iterable[int]] = tuple,
        keeper: LockKeeper | None = None,
        on_report: Callable[[StopReport], None] | None = None,
        on_dying: Callable[[int], None] = lambda _: None,
        standby: GuardedStandby | None = None,
        transport: str = "",
        owed: Owed | None = None,
        on_decided: Callable[[Decided], None] = lambda _: None,
        on_failed: Callable[[], None] = lambda: None,
    ) -> None:
        self._driver = driver
        self._heartbeat = heartbeat
        self._start_wire = start_wire
        self._on_state = on_state
        self._gate_address = gate
        self._writers = writers
        self._on_report = on_report
        self._on_dying = on_dying
        self._transport_address = transport
        self._owed = owed or Owed()
        self._lives: dict[int, Life] = {}  # the writers as last observed
        self.stopped_detector = StoppedDetector(lambda pid: self._lives[pid].stopped)
        self.channels = ChannelKeeper(driver, standby, lambda why: self._break(Reason.WIRE, why))
        self._keeper = keeper
        self._on_decided = on_decided
        self._on_failed = on_failed
        self.state = StateIs(Mode.DOWN, 0, "" if keeper is None else keeper.found_by, "")
        self.last_report: StopReport | None = None
        self._confirmed = True
        self._leaving = self._released = False
        self._is_last = False  # no other wire will be started
        self._ticks = 0
        self._guarded: GuardedWire | None = None  # the running wire
        self._stopped_looks = 0
        self._failure_detector = self._listen()
        self._silent_until_ns = 0
        self._renews = False  # this wire is replaced because its SDK hangs
        self._broken = trio.Event()
        self._why = (Reason.WIRE, "")
        self.idle = trio.Event()  # set while no wire runs, and the stop after the last one is over
        self.idle.set()
        self.reported = trio.Event()  # set when the stop after the last wire was reported
        self.reported.set()
        self._again = trio.Event()
        self._waiting: list[Deferred] = []
        self._ordered = SafeState.HOLD  # the most severe order since this wire was started
        self._was_told = False  # this wire has reported its state
        self._begins_locked = False  # this wire was started with a lock
        self._alone = trio.Lock()  # held by the task that stops the robot between two wires, or starts the next
        self._attempting: trio.CancelScope | None = None
        self._attempting_state = self._usual

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(self._gate_address)
        self._transport: Ref = self.context.ref(self._transport_address)
        self.channels.begin(self.context, self._gate, self._transport)
        self.context.every(self._driver.timing.tick_s, Tick)

    def receive(
        self, message: Tick | SilentUntil | Renew | StateIs | Decided | Handover | Fence
    ) -> HandedOver | StopReport | Refused | Deferred | None:
        match message:
            case Tick():
                self._tick(message.now_ns)
            case SilentUntil():
                self._failure_detector.heard(self.context.clock.now_ns())
                longest_ns = self._failure_detector.heard_ns + round(self._driver.timing.silent_s * NS)
                self._silent_until_ns = min(message.until_ns, longest_ns)
            case Renew():
                self._renews = True
                self._break(Reason.WIRE, message.why)
            case StateIs():
                if self._guarded is not None:  # else it is a late message of a wire that has ended
                    if self._broken.is_set() and self.state.locked_by and not message.locked_by:
                        # It was sent before the wire's end, without the e-stop that the root was asked for.
                        message = msgspec.structs.replace(message, locked_by=self.state.locked_by)
                    self.state = message
                    if not self._was_told:  # The gate has started, and its link is not up yet.
                        self._was_told = True
                        self._tell_stopped()
                    self._confirmed = message.mode in SAFE
                    self._keep_lock()
                    if self._on_state is not None:
                        self._on_state(message)
            case Decided():
                self._on_decided(message)
            case Handover():
                self._failure_detector.heard(self.context.received_ns)
                return self.channels.take(message)
            case Fence():
                return self._fence(message)
        return None

    def _listen(self, look: Callable[[], Standing | None] = lambda: None) -> FailureDetector:
        """Return a failure detector for a new wire."""
        self._heartbeat.forget()
        timing = self._driver.timing
        return FailureDetector(timing.heartbeat_ttl_s, timing.tick_s, look)

    def _tick(self, now_ns: int) -> None:
        self._heartbeat.beat(now_ns)
        if not self._failure_detector.heard(self._heartbeat.heard_ns):
            self._look_at_wire()
        self._ticks += 1
        if self._ticks % LOOK_EVERY == 0:
            self._look_at_writers()
            self._look_at_start()
            self.channels.look()
        if now_ns >= self._silent_until_ns and self._failure_detector.tick(now_ns):
            silent = self._failure_detector.told(now_ns)
            self._break(Reason.WIRE, busy.explained(f"the wire process stopped answering ({silent})"))

    def _look_at_wire(self) -> None:
        """Notice a wire that is dying. The system reports its end only after its memory was freed."""
        guarded = self._guarded
        if guarded is not None and self._failure_detector.heard_ns and not self._released and guarded.dying():
            self._break(Reason.WIRE, DYING)

    def _look_at_writers(self) -> None:
        self._lives = lives = {pid: life_of(pid) for pid in self._writers()}
        for pid in self.stopped_detector.look(lives):
            self._gate.tell(Stopped(pid))
        for pid, life in lives.items():
            if life.dying:
                self._on_dying(pid)

    def _look_at_start(self) -> None:
        """Notice a wire that was stopped (SIGSTOP) before its first heartbeat, which no silence shows."""
        if self._guarded is None or self._failure_detector.heard_ns:
            return
        standing = self._guarded.standing()
        self._stopped_looks = self._stopped_looks + 1 if standing is not None and standing.stopped else 0
        if self._stopped_looks == LOOKS:
            self._break(Reason.WIRE, "the wire process was stopped before it had begun")

    def _break(self, reason: Reason, why: str) -> None:
        if not self._broken.is_set():
            self._why = reason, why
            self._broken.set()

    # -- the standby, and the lock of an e-stop

    def lose_standby(self, why: str) -> None:
        """Note that there is no standby. A robot that moves goes on, since root and wire both run.
        Nothing is armed before there is another one."""
        self.context.note(Happened("there is no standby", why))
        if self._guarded is not None:
            self.channels.set_standby_problem(f"{why}; another is being started")

    def begin_standby(self) -> None:
        """Give a new standby a stop channel: an open wire hands over again. A closed one does it when it
        opens."""
        if self._guarded is not None and self.channels.own is not None:
            self._transport.tell(HandOverAgain())

    def _keep_lock(self) -> None:
        """Write the lock to the disk, and tell the gate when it is there."""
        state = self.state
        if self._keeper is not None:
            self._keeper.want(state.locked_by)
        if state.locked_by:
            self.context.start_soon(self._report_lock, state)

    async def _report_lock(self, state: StateIs) -> None:
        kept = await self._kept(state.locked_by)
        self._gate.tell(LockKept(state.epoch, kept.since, kept.problem))

    async def _kept(self, by: str) -> Kept:
        return Kept("") if self._keeper is None else await self._keeper.kept(by)

    async def _answer_fence(self, waiting: Deferred, report: StopReport) -> None:
        """Reply to an order when its lock is on the disk."""
        kept = await self._kept(self.state.locked_by)
        waiting.send(msgspec.structs.replace(report, note=kept.problem) if self.state.locked_by else report)

    def _fence(self, message: Fence) -> Deferred:
        usual, ordered = self._usual, SafeState(self._driver.fallbacks[message.reason])
        self._owed.stopped_ns = self.context.received_ns
        lock = (message.by or "an operator") if message.lock else self.state.locked_by
        self.state = StateIs(self.state.mode, self.state.epoch, lock, self.state.cause)
        deferred = self.context.defer()
        if (report := self._covering(message, ordered)) is not None:
            self._keep_lock()
            self._tell_stopped()
            self.context.start_soon(self._answer_fence, deferred, report)
            return deferred
        self._ordered = self._ordered.or_more(self._owed.order(ordered))
        if ordered.severity > usual.severity:  # The confirmed state is milder than the ordered one.
            self._confirmed, self._owed.safe_state = False, True
        self._waiting.append(deferred)
        self._again.set()
        if self._attempting is not None and ordered.severity > self._attempting_state.severity:
            self._attempting.cancel()  # for example a landing, which takes seconds
        if self._guarded is None and self.idle.is_set():
            self.context.start_soon(self.serve_waiting)
        else:
            self._break(message.reason, f"{message.reason}: no answer from the wire")
        return deferred

    def _tell_stopped(self) -> None:
        """Tell the gate of a stop that was made without it, so that it refuses an earlier resume."""
        if self._guarded is not None and self._owed.stopped_ns:
            self._gate.tell(StoppedAt(self._owed.stopped_ns))

    @property
    def _usual(self) -> SafeState:
        """Return the safe state for the end of a wire."""
        return SafeState(self._driver.fallbacks[Reason.WIRE])

    def _covering(self, message: Fence, ordered: SafeState) -> StopReport | None:
        """Return an earlier report that already fulfils an order; None if something has to be done."""
        report = self.last_report
        if report is None or not self._confirmed or not SafeState(report.safe_state).at_least(ordered):
            return None
        if self._guarded is None:
            return report if self.reported.is_set() else None
        # A starting wire has energised nothing, and ending it would use up a restart. But it must know
        # a lock from its start.
        knows = not message.lock or self._begins_locked
        return report if knows and not self._failure_detector.heard_ns else None

    async def serve_waiting(self) -> None:
        """Carry out orders that come while there is no wire. The next wire is started afterwards."""
        async with self._alone:
            if self._guarded is None and self._waiting:
                await self._make_safe(self.state.epoch)
                if not self._confirmed and (self._is_last or self._leaving):
                    await self._insist(self.state.epoch, float("inf"))

    # -- the end of the tree

    def leave(self) -> None:
        """Begin the end of the tree: start no new wire. A robot that is not confirmed safe is stopped again for
        up to ``LINGER_S``."""
        self._leaving = True
        self._again.set()

    async def end(self, reason: Reason, by: str, confirmed: bool) -> None:
        """End the wire, after ``leave``, and return when the robot was stopped once (``reported``).

        Args:
            reason: The reason for the end.
            by: The cause, for people.
            confirmed: True if the gate's own stop was confirmed. Then the wire ends by itself, and its exit
                code shows whether that is still true. Otherwise it is fenced.
        """
        guarded = self._guarded
        if guarded is None and self.idle.is_set() and not self._confirmed and not self._is_last:
            # The next wire could not be started, and no other will be.
            self.idle, self.reported = trio.Event(), trio.Event()
            self.context.start_soon(self.insist)
        if guarded is not None and confirmed:
            self._released = True
            guarded.let_go()
            with trio.move_on_after(END_S):
                await self.idle.wait()
        self._break(reason, by)
        await self.reported.wait()

    @property
    def confirmed(self) -> bool:
        """True if nothing is energised by this tree any more, as far as is known."""
        return self._confirmed

    @property
    def at_work(self) -> bool:
        """True while an order is waiting or being carried out."""
        return bool(self._waiting) or self._alone.locked()

    # -- one life of the wire group after the other

    async def keep(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run a wire, as a child of the supervisor, and another one whenever its process is spent.

        Raises:
            WireBroken: The wire has ended.
        """
        while True:
            while self.at_work:
                async with self._alone:
                    if self._waiting:
                        await self._make_safe(self.state.epoch)
            # Checked last: no wire may start after ``end``, which would end it.
            if self._leaving:
                task_status.started()
                await trio.sleep_forever()
            await self._live(task_status)
            if not self._renews:
                raise WireBroken(self._why[1])
            task_status = trio.TASK_STATUS_IGNORED
            await trio.sleep(RENEW_PAUSE_S)

    async def insist(self) -> None:
        """Stop the robot until it is confirmed, or the tree ends. No other wire will be started."""
        self.idle = trio.Event()
        self._is_last = True
        async with self._alone:
            await self._insist(self.state.epoch, float("inf"))
        self.idle.set()

    async def _live(self, task_status: trio.TaskStatus[None]) -> None:
        self._renews = False
        self._broken = trio.Event()
        self.idle = trio.Event()
        self.reported = trio.Event()
        self._silent_until_ns = 0
        self._stopped_looks = 0
        self._ordered = SafeState.HOLD
        self._was_told = False
        locked_by = self.state.locked_by
        self._begins_locked = bool(locked_by)
        start = State(Mode.DOWN if self._confirmed else Mode.LOST, self.state.epoch + 1, locked_by)
        try:
            guarded = self._guarded = self._start_wire(start, self.state.cause)
        # There is no process or no descriptor. No task may wait for the end of this wire.
        except BaseException:
            self.idle.set()
            self.reported.set()
            raise
        self._failure_detector = self._listen(guarded.standing)
        try:
            task_status.started()
            await self._until_broken(guarded)
        finally:
            with trio.CancelScope(shield=True):
                await self._take_over(guarded, start.epoch)

    async def _until_broken(self, guarded: GuardedWire) -> None:
        async with trio.open_nursery() as nursery:

            async def watch() -> None:
                self._break(Reason.WIRE, await guarded.ended())

            async def watch_start() -> None:
                await trio.sleep(START_DEADLINE_S)
                if not self._failure_detector.heard_ns:
                    late = f"the wire did not start within {START_DEADLINE_S:g} s"
                    self._break(Reason.WIRE, busy.explained(late))

            nursery.start_soon(watch)
            nursery.start_soon(watch_start)
            await self._broken.wait()
            nursery.cancel_scope.cancel()

    async def _take_over(self, guarded: GuardedWire, epoch: int) -> None:
        fenced = await self._fence_guarded(guarded)
        if fenced and self._why[1] == DYING:
            self._why = self._why[0], await guarded.ended()
        self._guarded = None
        self._look_for_requests(fenced)
        self.context.note(Happened("the wire has ended", self._why[1]))
        self._failure_detector = self._listen()
        if self._released and guarded.left_safe and not self._waiting and not self._unsettled_s:
            self._confirmed = True
            self._owed.safe_state = False
            # The wire had confirmed it. That report does not answer an e-stop.
            self.last_report = None
        else:
            await self._insist(epoch, INSIST_S)
        await self.channels.let_go()
        began_s = trio.current_time()
        # Two processes at one port would be worse than no process.
        while not fenced:
            if self._leaving and trio.current_time() > began_s + LINGER_S:
                break  # no other wire will be started
            fenced = await self._fenced(guarded)
            if fenced and self._look_for_requests(fenced):
                await self._insist(epoch, INSIST_S)
        while self._waiting:  # orders that came meanwhile
            await self._make_safe(epoch)
        self.reported.set()
        self.idle.set()

    def _look_for_requests(self, fenced: bool) -> bool:
        """Note that the requests of the wire are cut off now. Return True if one of them may still take effect.

        Then the robot does not count as safe, whatever the wire has reported.
        """
        now_ns = self.context.clock.now_ns()
        if fenced:
            self._owed.cut_off(now_ns)
        unsettled = self._owed.unsettled_s(now_ns) > 0
        if unsettled:
            self._confirmed = False
        return unsettled

    async def _fence_guarded(self, guarded: GuardedWire) -> bool:
        """Write the safe frame, then fence the wire.

        A root that dies in between leaves a wire that stops the robot by itself, or a robot that has
        got the safe frame. This order is for a broken wire only. A working wire is fenced first, since
        it could write a setpoint after the safe frame; if the root dies before the fence, that wire
        stops the robot by itself.
        """
        async with trio.open_nursery() as nursery:
            if self.channels.own is not None and guarded.alive and self._broken.is_set():
                nursery.start_soon(attempt, self.channels.own, self._driver, self._wanted())
                for _ in range(2):  # By then the attempt has run to its first wait, so its frame was sent.
                    await trio.lowlevel.checkpoint()
            fenced = await self._fenced(guarded)
            nursery.cancel_scope.cancel()
        return fenced

    async def _fenced(self, guarded: GuardedWire) -> bool:
        """Fence a wire. Return False if that failed; the robot is stopped in any case."""
        try:
            return await guarded.fence()
        except Exception as error:
            report_failure("the fence of the wire process", error)
            await trio.sleep(FENCE_AGAIN_S)
            return False

    async def _insist(self, epoch: int, for_s: float) -> None:
        """Stop the robot until every motor confirms it, or the time is over (``LINGER_S`` when the tree
        ends). If the gate had confirmed it before, one attempt is enough, since a motor that does not
        answer may not exist."""
        was_safe = self._confirmed
        began_s = trio.current_time()
        for pause_s in pauses_s():
            self._again = trio.Event()
            await self._make_safe(epoch)
            longest_s = LINGER_S if self._leaving else for_s
            over = was_safe or trio.current_time() + pause_s > began_s + longest_s
            if self._confirmed or (over and not self._waiting):
                return
            with trio.move_on_after(pause_s):
                await self._again.wait()

    async def _settled(
        self, make_safe: Callable[[], Awaitable[tuple[MotorReport, ...]]]
    ) -> tuple[MotorReport, ...]:
        return await settled(self._owed, self.context.clock, make_safe)

    @property
    def _unsettled_s(self) -> float:
        return self._owed.unsettled_s(self.context.clock.now_ns())

    def _wanted(self) -> SafeState:
        """Return the safe state to bring the robot to.

        The most severe order is on the shared page and in this actor, because a wire that is ending may
        still confirm a milder order and clear the page.
        """
        return self._owed.order(self._usual.or_more(self._ordered), lasts=False)

    async def _make_safe(self, epoch: int) -> None:
        reason, why = self._why
        safe_state = self._wanted()
        began_ns = self.context.clock.now_ns()
        motors: tuple[MotorReport, ...] = ()
        self._attempting_state = safe_state
        with trio.CancelScope() as self._attempting:
            if self.channels.own is not None:
                motors = await self._settled(partial(attempt, self.channels.own, self._driver, safe_state))
            elif not self._confirmed or safe_state.severity > self._usual.severity:
                # This wire has energised nothing, but the robot may be in the state that an earlier one left.
                motors = await self._settled(partial(attempt_anew, self._driver, self.context.clock, safe_state))
        self._attempting = None
        if not all_safe(motors):
            self._on_failed()
        if not safe_state.at_least(self._wanted()):
            self._confirmed = False
            return  # A more severe order has come meanwhile. The next attempt is for all orders.
        if motors:  # Otherwise nothing was attempted, and nothing has changed.
            self._confirmed = all_safe(motors)
        if self._confirmed:
            self._owed.safe_state = False
            if motors:
                self._owed.confirm(safe_state)
                self._ordered = SafeState.HOLD
        now_ns = self.context.clock.now_ns()
        took_ms = (now_ns - began_ns) / 1e6
        epoch = max(epoch, self.state.epoch) + 1
        report = StopReport(reason, safe_state, epoch, self._confirmed, motors, "stop_channel", took_ms, now_ns)
        self.last_report = report
        self.state = StateIs(Mode.DOWN if self._confirmed else Mode.LOST, epoch, self.state.locked_by, why)
        self.context.note(report)
        self.context.note(self.state)
        if self._on_state is not None:
            self._on_state(self.state)
        self._keep_lock()
        if self._on_report is not None:
            self._on_report(report)
        for waiting in self._waiting:
            self.context.start_soon(self._answer_fence, waiting, report)
        self._waiting.clear()
        self.reported.set()
