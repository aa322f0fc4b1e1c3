"""The guardian: the root's actor that keeps a wire process running, and stops the robot when that process fails.

If the wire process is silent or dies, the guardian

1. writes the safe frame (it stops the robot) by the root's own connection to the robot (its stop channel),
2. fences the wire process: kills it and waits for its end, since a frozen process could write again,
3. writes the safe frame again, and reads every motor back.

The root itself may die between these steps. If it dies before the first frame, the wire process is still there, and
stops the robot when it misses the root. If it dies later, the robot has already received the safe frame.

A stop that is not confirmed is repeated for ``REPEAT_S`` before the next wire process is started. When the robot's
processes are ended and no wire process follows, it is repeated for ``LINGER_S``.
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
from strands_actors.kernel.health.processor import Life, ProcessorUse, life_of
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Ref
from strands_actors.kernel.processes.child import report_failure
from strands_actors.supervisors.gate.failsafe import SAFE, Mode, State
from strands_actors.supervisors.gate.messages import LockKept, Stopped, StoppedAt, StopReport
from strands_actors.supervisors.page import SafetyPage
from strands_actors.supervisors.root.messages import (
    Decided,
    Fence,
    GetState,
    HandedOver,
    Handover,
    Happened,
    RecorderGap,
    Renew,
    SilentUntil,
    StateIs,
)
from strands_actors.supervisors.wire.messages import HandOverAgain
from strands_actors.supervisors.wire.watchdog import Tick

from .channel_keeper import ChannelKeeper
from .guarded import GuardedStandby, GuardedWire
from .lock_keeper import Kept, LockKeeper
from .stop_channel import LINGER_S, REPEAT_S, attempt, attempt_anew, none_unsafe, pauses_s, settled
from .stopped_detector import LOOK_EVERY, LOOKS, StoppedDetector

START_DEADLINE_S = 5.0
"""Longest time from the start of a wire process to its first heartbeat. It computes for a quarter of
a second, half a second with an SDK, and may get a tenth of a processor. A stopped process is noticed
earlier. After its handover a wire must send heartbeats at once, since it may have energised the
robot."""
RENEW_PAUSE_S = 0.05
FENCE_AGAIN_S = 0.1
END_S = 0.5
"""Time for a wire process to exit after its stop was confirmed, in seconds. After that it is killed."""
DYING = "the wire process dies"
"""Reason for the end of a wire process until its exit code is known."""


class WireBroken(Exception):
    """Raised when a wire process has ended. It was killed if necessary, and the robot was stopped."""


class Guardian(Actor):
    """Keep the wire process of one robot running.

    Args:
        driver: The driver of the robot.
        heartbeat: The heartbeats of root and wire, on a shared page.
        start_wire: Starts a wire process with a failsafe state and the cause of that state.
        on_state: Called at each change of the failsafe state.
        gate: Address of the gate.
        writers: Returns the ids of the processes that may send setpoints.
        keeper: Writes the locks of e-stops to the disk; None in tests with one process.
        on_report: Called with the result of each stop that the guardian makes.
        on_dying: Called with the id of a writer's process that was killed and has not exited yet.
        standby: The standby; None in tests with one process.
        transport: Address of the transport.
        safety_page: The shared page on which the standby reads if anything may be energised.
        on_decided: Called with each decision of the gate, for the audit.
        on_failed: Called after each attempt to stop the robot that was not confirmed.
        on_suspended: Called with the id of a writer's process that the system has suspended (SIGSTOP).
        on_gap: Called with the number of missing events of each gap in a recording of the wire process.
        on_look: Called every ``LOOK_EVERY`` ticks with the time, for observations that need no timer of their own.
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
        safety_page: SafetyPage | None = None,
        on_decided: Callable[[Decided], None] = lambda _: None,
        on_failed: Callable[[], None] = lambda: None,
        on_suspended: Callable[[int], None] = lambda _: None,
        on_gap: Callable[[int], None] = lambda _: None,
        on_look: Callable[[int], None] = lambda _: None,
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
        self._safety_page = safety_page or SafetyPage()
        self._lives: dict[int, Life] = {}  # for each writer's process, its state at the last observation
        self.stopped_detector = StoppedDetector(lambda pid: self._lives[pid].stopped)
        self.channels = ChannelKeeper(driver, standby, lambda cause: self._break(Reason.WIRE, cause))
        self._keeper = keeper
        self._on_decided = on_decided
        self._on_failed = on_failed
        self._on_suspended = on_suspended
        self._on_gap = on_gap
        self._on_look = on_look
        self.state = StateIs(Mode.DOWN, 0, "" if keeper is None else keeper.initial_operator, "")
        self.last_report: StopReport | None = None
        self._confirmed = True
        self._leaving = self._released = False
        # True if no other wire process will be started.
        self._is_last = False
        self._ticks = 0
        self._guarded: GuardedWire | None = None  # the running wire process; None while none runs
        self._stopped_looks = 0
        self._failure_detector = self._listen()
        self._silent_until_ns = 0
        # True while the wire process is replaced because a call of its SDK hangs.
        self._renews = False
        self._broken = trio.Event()
        self._break_cause = (Reason.WIRE, "")
        self.idle = trio.Event()  # set while no wire process runs and the stop after the last one is done
        self.idle.set()
        self.reported = trio.Event()  # set when the stop after the last wire process was reported
        self.reported.set()
        self._again = trio.Event()
        self._waiting: list[Deferred] = []
        self._ordered = SafeState.HOLD  # most severe order since this wire process was started
        # True if this wire process has reported its state.
        self._state_received = False
        # True if this wire process was started with the robot locked by an e-stop.
        self._begins_locked = False
        # Held while the robot is stopped between two wire processes, and while the next one is started.
        self._alone = trio.Lock()
        self._attempting: trio.CancelScope | None = None
        self._attempting_state = self._usual

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(self._gate_address)
        self._transport: Ref = self.context.ref(self._transport_address)
        self.channels.begin(self.context, self._gate, self._transport)
        self.context.every(self._driver.timing.tick_s, Tick)

    def receive(
        self, message: Tick | SilentUntil | Renew | StateIs | GetState | RecorderGap | Decided | Handover | Fence
    ) -> HandedOver | StateIs | StopReport | Refused | Deferred | None:
        match message:
            case Tick():
                self._tick(message.now_ns)
            case SilentUntil():
                self._failure_detector.note_heartbeat(self.context.clock.now_ns())
                longest_ns = self._failure_detector.last_received_ns + round(self._driver.timing.silent_s * NS)
                self._silent_until_ns = min(message.until_ns, longest_ns)
            case Renew():
                self._renews = True
                self._break(Reason.WIRE, message.cause)
            case StateIs():
                # Ignore a late message of a wire process that has ended.
                if self._guarded is not None:
                    if self._broken.is_set() and self.state.locked_by and not message.locked_by:
                        # The gate sent this message before the wire process ended, and without knowledge of the
                        # e-stop that the root has carried out.
                        message = msgspec.structs.replace(message, locked_by=self.state.locked_by)
                    self.state = message
                    # This is the first message of a new gate, before the robot is connected.
                    if not self._state_received:
                        self._state_received = True
                        self._tell_stopped()
                    self._confirmed = message.mode in SAFE
                    self._keep_lock()
                    if self._on_state is not None:
                        self._on_state(message)
            case GetState():
                return self.state
            case RecorderGap():
                self._on_gap(message.missed)
            case Decided():
                self._on_decided(message)
            case Handover():
                self._failure_detector.note_heartbeat(self.context.received_ns)
                return self.channels.take(message)
            case Fence():
                return self._fence(message)
        return None

    def _listen(self, look: Callable[[], ProcessorUse | None] = lambda: None) -> FailureDetector:
        """Return a detector that notices when a new wire process sends no heartbeats."""
        self._heartbeat.forget()
        timing = self._driver.timing
        return FailureDetector(timing.heartbeat_ttl_s, timing.tick_s, look)

    def _tick(self, now_ns: int) -> None:
        self._heartbeat.beat(now_ns)
        if not self._failure_detector.note_heartbeat(self._heartbeat.last_received_ns):
            self._check_wire()
        self._ticks += 1
        if self._ticks % LOOK_EVERY == 0:
            self._check_writers()
            self._check_start()
            self.channels.look()
            self._on_look(now_ns)
        if now_ns >= self._silent_until_ns and self._failure_detector.tick(now_ns):
            silent = self._failure_detector.describe_silence(now_ns)
            self._break(Reason.WIRE, busy.explained(f"the wire process stopped answering ({silent})"))

    def _check_wire(self) -> None:
        """Notice that the wire process was killed or is exiting. The system reports its end only after it has freed
        its memory."""
        guarded = self._guarded
        if (
            guarded is not None
            and self._failure_detector.last_received_ns
            and not self._released
            and guarded.dying()
        ):
            self._break(Reason.WIRE, DYING)

    def _check_writers(self) -> None:
        self._lives = lives = {pid: life_of(pid) for pid in self._writers()}
        for pid in self.stopped_detector.look(lives):
            self._gate.tell(Stopped(pid))
            self._on_suspended(pid)
        for pid, life in lives.items():
            if life.dying:
                self._on_dying(pid)

    def _check_start(self) -> None:
        """Notice that the operating system has suspended the wire process (SIGSTOP) before its first heartbeat. A
        missing heartbeat would not show this, because a new process may need long to start."""
        if self._guarded is None or self._failure_detector.last_received_ns:
            return
        use = self._guarded.processor_use()
        self._stopped_looks = self._stopped_looks + 1 if use is not None and use.stopped else 0
        if self._stopped_looks == LOOKS:
            self._break(Reason.WIRE, "the system stopped the wire process (SIGSTOP) before it had begun")

    def _break(self, reason: Reason, cause: str) -> None:
        if not self._broken.is_set():
            self._break_cause = reason, cause
            self._broken.set()

    # -- the standby process, and the lock of an e-stop

    def lose_standby(self, cause: str) -> None:
        """Note that there is no standby. A moving robot continues, since root and wire both run. Nothing is armed
        until there is another standby."""
        self.context.note(Happened("there is no standby", cause))
        if self._guarded is not None:
            self.channels.set_standby_problem(f"{cause}; another is being started")

    def begin_standby(self) -> None:
        """Give a new standby a stop channel: ask the wire process to hand over its descriptors again. If the wire
        process is not connected to the robot, it does so when it connects."""
        if self._guarded is not None and self.channels.own is not None:
            self._transport.tell(HandOverAgain())

    def _keep_lock(self) -> None:
        """Write the lock of an e-stop to the disk, and inform the gate when it is there."""
        state = self.state
        if self._keeper is not None:
            self._keeper.request(state.locked_by)
        if state.locked_by:
            self.context.start_soon(self._report_lock, state)

    async def _report_lock(self, state: StateIs) -> None:
        kept = await self._kept(state.locked_by)
        self._gate.tell(LockKept(state.epoch, kept.since, kept.problem))

    async def _kept(self, by: str) -> Kept:
        return Kept("") if self._keeper is None else await self._keeper.kept(by)

    async def _answer_fence(self, waiting: Deferred, report: StopReport) -> None:
        """Reply to the order of a stop. If it locks the robot, wait until the lock is on the disk."""
        kept = await self._kept(self.state.locked_by)
        waiting.send(msgspec.structs.replace(report, note=kept.problem) if self.state.locked_by else report)

    def _fence(self, message: Fence) -> Deferred:
        usual, ordered = self._usual, SafeState(self._driver.fallbacks[message.reason])
        self._safety_page.stopped_ns = self.context.received_ns
        lock = (message.by or "an operator") if message.lock else self.state.locked_by
        self.state = StateIs(self.state.mode, self.state.epoch, lock, self.state.cause)
        deferred = self.context.defer()
        if (report := self._covering(message, ordered)) is not None:
            self._keep_lock()
            self._tell_stopped()
            self.context.start_soon(self._answer_fence, deferred, report)
            return deferred
        self._ordered = self._ordered.or_more(self._safety_page.order(ordered))
        # The robot was brought to a milder state than the ordered one.
        if ordered.severity > usual.severity:
            self._confirmed, self._safety_page.may_be_energised = False, True
        self._waiting.append(deferred)
        self._again.set()
        if self._attempting is not None and ordered.severity > self._attempting_state.severity:
            self._attempting.cancel()  # the present attempt may take seconds, for example a landing
        if self._guarded is None and self.idle.is_set():
            self.context.start_soon(self.serve_waiting)
        else:
            self._break(message.reason, f"{message.reason}: no answer from the wire process")
        return deferred

    def _tell_stopped(self) -> None:
        """Inform the gate of a stop that was made without it. The gate then refuses a resume that was requested
        before this stop."""
        if self._guarded is not None and self._safety_page.stopped_ns:
            self._gate.tell(StoppedAt(self._safety_page.stopped_ns))

    @property
    def _usual(self) -> SafeState:
        """Return the safe state that the driver declares for the end of the wire process."""
        return SafeState(self._driver.fallbacks[Reason.WIRE])

    def _covering(self, message: Fence, ordered: SafeState) -> StopReport | None:
        """Return an earlier report of a stop that already fulfils this order; None if the robot must be stopped
        again."""
        report = self.last_report
        if report is None or not self._confirmed or not SafeState(report.safe_state).at_least(ordered):
            return None
        if self._guarded is None:
            return report if self.reported.is_set() else None
        # A wire process that has just started has energised nothing, so it need not be killed for this order. But
        # if the order locks the robot, the wire process must have been started with that lock.
        knows = not message.lock or self._begins_locked
        return report if knows and not self._failure_detector.last_received_ns else None

    async def serve_waiting(self) -> None:
        """Carry out the orders that came while no wire process ran. The next wire process is started after that."""
        async with self._alone:
            if self._guarded is None and self._waiting:
                await self._make_safe(self.state.epoch)
                if not self._confirmed and (self._is_last or self._leaving):
                    await self._repeat_stop(self.state.epoch, float("inf"))

    # -- the end of the robot's processes

    def leave(self) -> None:
        """Begin to end the robot's processes: start no new wire process. A robot that is not confirmed as safe is
        stopped again for up to ``LINGER_S``."""
        self._leaving = True
        self._again.set()

    async def end(self, reason: Reason, by: str, confirmed: bool) -> None:
        """End the wire process, after ``leave``. Return when the robot has been stopped once (``reported``).

        Args:
            reason: The reason for the end.
            by: The reason for people.
            confirmed: True if the gate's own stop was confirmed. The wire process then ends by itself, and its exit
                code shows whether the robot is still safe. If False, the wire process is killed.
        """
        guarded = self._guarded
        if guarded is None and self.idle.is_set() and not self._confirmed and not self._is_last:
            # The last start of a wire process has failed, and there will be no other one.
            self.idle, self.reported = trio.Event(), trio.Event()
            self.context.start_soon(self.keep_stopping)
        if guarded is not None and confirmed:
            self._released = True
            guarded.close_link()
            with trio.move_on_after(END_S):
                await self.idle.wait()
        self._break(reason, by)
        await self.reported.wait()

    @property
    def confirmed(self) -> bool:
        """True if, as far as is known, nothing is energised any more by these processes."""
        return self._confirmed

    @property
    def is_stopping(self) -> bool:
        """True while an order to stop the robot waits or is carried out."""
        return bool(self._waiting) or self._alone.locked()

    # -- the wire processes, one after the other

    async def keep(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Run a wire process. Start another one whenever it asks to be replaced (``Renew``). The supervisor runs
        this method.

        Raises:
            WireBroken: The wire process has ended for any other reason.
        """
        while True:
            while self.is_stopping:
                async with self._alone:
                    if self._waiting:
                        await self._make_safe(self.state.epoch)
            # Check this last, since no wire process may be started after ``end`` was called.
            if self._leaving:
                task_status.started()
                await trio.sleep_forever()
            await self._live(task_status)
            if not self._renews:
                raise WireBroken(self._break_cause[1])
            task_status = trio.TASK_STATUS_IGNORED
            await trio.sleep(RENEW_PAUSE_S)

    async def keep_stopping(self) -> None:
        """Stop the robot again and again until it is confirmed or the robot's processes end. No other wire process
        will be started."""
        self.idle = trio.Event()
        self._is_last = True
        async with self._alone:
            await self._repeat_stop(self.state.epoch, float("inf"))
        self.idle.set()

    async def _live(self, task_status: trio.TaskStatus[None]) -> None:
        self._renews = False
        self._broken = trio.Event()
        self.idle = trio.Event()
        self.reported = trio.Event()
        self._silent_until_ns = 0
        self._stopped_looks = 0
        self._ordered = SafeState.HOLD
        self._state_received = False
        locked_by = self.state.locked_by
        self._begins_locked = bool(locked_by)
        start = State(Mode.DOWN if self._confirmed else Mode.LOST, self.state.epoch + 1, locked_by)
        try:
            guarded = self._guarded = self._start_wire(start, self.state.cause)
        # The process could not be started. Set these events, so that no task waits for its end.
        except BaseException:
            self.idle.set()
            self.reported.set()
            raise
        self._failure_detector = self._listen(guarded.processor_use)
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
                if not self._failure_detector.last_received_ns:
                    late = f"the wire process did not start within {START_DEADLINE_S:g} s"
                    self._break(Reason.WIRE, busy.explained(late))

            nursery.start_soon(watch)
            nursery.start_soon(watch_start)
            await self._broken.wait()
            nursery.cancel_scope.cancel()

    async def _take_over(self, guarded: GuardedWire, epoch: int) -> None:
        fenced = await self._fence_guarded(guarded)
        if fenced and self._break_cause[1] == DYING:
            self._break_cause = self._break_cause[0], await guarded.ended()
        self._guarded = None
        self._look_for_requests(fenced)
        self.context.note(Happened("the wire has ended", self._break_cause[1]))
        self._failure_detector = self._listen()
        if self._released and guarded.ended_safe and not self._waiting and not self._unsettled_s:
            self._confirmed = True
            self._safety_page.may_be_energised = False
            # The last stop was confirmed by the wire process, so no report of the root answers a later e-stop.
            self.last_report = None
        else:
            await self._repeat_stop(epoch, REPEAT_S)
        await self.channels.release_channel()
        began_s = trio.current_time()
        # If two processes used one port, that would be worse than no process.
        while not fenced:
            if self._leaving and trio.current_time() > began_s + LINGER_S:
                break  # no other wire process will be started, so this one may remain
            fenced = await self._fenced(guarded)
            if fenced and self._look_for_requests(fenced):
                await self._repeat_stop(epoch, REPEAT_S)
        while self._waiting:  # orders to stop that came during this method
            await self._make_safe(epoch)
        self.reported.set()
        self.idle.set()

    def _look_for_requests(self, fenced: bool) -> bool:
        """Note that the requests of the wire process have been cut off. Return True if one of them may still take
        effect. The robot does not count as safe then, even if the wire process had reported that it is."""
        now_ns = self.context.clock.now_ns()
        if fenced:
            self._safety_page.cut_off(now_ns)
        unsettled = self._safety_page.unsettled_s(now_ns) > 0
        if unsettled:
            self._confirmed = False
        return unsettled

    async def _fence_guarded(self, guarded: GuardedWire) -> bool:
        """Write the safe frame (the bytes that stop the robot), then kill the wire process and wait for its end.

        If the root dies in between, either the wire process still runs and stops the robot, or the robot has
        received the safe frame.

        This order is only for a wire process that does not work. A working one is killed first, because it could
        write a setpoint after the safe frame. If the root dies before that, the wire process stops the robot by
        itself.
        """
        async with trio.open_nursery() as nursery:
            if self.channels.own is not None and guarded.alive and self._broken.is_set():
                nursery.start_soon(attempt, self.channels.own, self._driver, self._required_state())
                # After two checkpoints the attempt has come to its first wait, so its frame was sent.
                for _ in range(2):
                    await trio.lowlevel.checkpoint()
            fenced = await self._fenced(guarded)
            nursery.cancel_scope.cancel()
        return fenced

    async def _fenced(self, guarded: GuardedWire) -> bool:
        """Kill the wire process and wait for its end. Return False if that failed. The robot is stopped in any
        case."""
        try:
            return await guarded.fence()
        except Exception as error:
            report_failure("the fence of the wire process", error)
            await trio.sleep(FENCE_AGAIN_S)
            return False

    async def _repeat_stop(self, epoch: int, for_s: float) -> None:
        """Stop the robot again and again until every motor confirms it, or for ``for_s`` seconds (``LINGER_S`` when
        the robot's processes end).

        If the robot was confirmed as safe before, one attempt is enough: a motor that does not answer then may not
        exist.
        """
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
        return await settled(self._safety_page, self.context.clock, make_safe)

    @property
    def _unsettled_s(self) -> float:
        return self._safety_page.unsettled_s(self.context.clock.now_ns())

    def _required_state(self) -> SafeState:
        """Return the safe state to which the robot must be brought.

        The most severe order is stored on the shared page and in this actor. A wire process that is ending may
        confirm a milder order and clear the page, so the page alone is not enough.
        """
        return self._safety_page.order(self._usual.or_more(self._ordered), lasts=False)

    async def _make_safe(self, epoch: int) -> None:
        reason, cause = self._break_cause
        safe_state = self._required_state()
        began_ns = self.context.clock.now_ns()
        motors: tuple[MotorReport, ...] = ()
        self._attempting_state = safe_state
        with trio.CancelScope() as self._attempting:
            if self.channels.own is not None:
                motors = await self._settled(partial(attempt, self.channels.own, self._driver, safe_state))
            elif not self._confirmed or safe_state.severity > self._usual.severity:
                # This wire process has energised nothing. But an earlier wire process may have left the
                # robot in any state.
                motors = await self._settled(partial(attempt_anew, self._driver, self.context.clock, safe_state))
        self._attempting = None
        if not none_unsafe(motors):
            self._on_failed()
        if not safe_state.at_least(self._required_state()):
            self._confirmed = False
            # A more severe order came during this attempt. The next attempt carries out all orders.
            return
        # A report without motors comes from a stop that was not attempted, so it changes nothing.
        if motors:
            self._confirmed = none_unsafe(motors)
        if self._confirmed:
            self._safety_page.may_be_energised = False
            if motors:
                self._safety_page.confirm(safe_state)
                self._ordered = SafeState.HOLD
        now_ns = self.context.clock.now_ns()
        took_ms = (now_ns - began_ns) / 1e6
        epoch = max(epoch, self.state.epoch) + 1
        report = StopReport(reason, safe_state, epoch, self._confirmed, motors, "stop_channel", took_ms, now_ns)
        self.last_report = report
        self.state = StateIs(Mode.DOWN if self._confirmed else Mode.LOST, epoch, self.state.locked_by, cause)
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
