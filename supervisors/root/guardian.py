"""The guardian keeps the wire group, and holds the stop channel to the hardware.

When the wire process stops beating, or dies: write the safe frame by the root's own descriptors, then
**fence** the wire (SIGKILL, and wait for its end: a paused owner that resumes would write again),
then write again and have every motor confirm it. The first frame is for a root that dies in
between: before it the wire is alive and acts when its root is gone, after it the robot has been
told.

What is not confirmed is tried again: for a while before the next wire is started, closed; when
there is no next one, because the tree ends, for ``LINGER_S``.
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
"""From a wire process' start to its first heartbeat: a quarter of a second of computing, half for
one that imports an SDK, on a machine that gives it a tenth of a processor. One that is stopped is
noticed at once, and one that has handed its port over is listened to as if it had beaten: what it
may have energised waits for no deadline."""
RENEW_PAUSE_S = 0.05
FENCE_AGAIN_S = 0.1
END_S = 0.5
"""For a wire that has confirmed its stop to end by itself: it is fenced then."""
DYING = "the wire process dies"
"""Why a wire is broken, until its end says how."""


class WireBroken(Exception):
    """The wire group has ended; it was fenced and the robot made safe."""


class Guardian(Actor):
    """``start_wire(start, cause)`` starts the wire group from a failsafe state, with what led to
    it, and returns it. ``gate`` is told when one of the processes that ``writers`` names has
    been stopped, and when the lock of an e-stop is kept by the ``keeper``. ``on_report`` is told
    what became of each attempt to make the robot safe, ``on_dying`` of a writer that has been
    killed and waits for a processor to die on. ``standby``: None in tests of one process. ``owed``:
    what the standby has to know of the wire. ``on_failed`` is called after each attempt that was not
    confirmed."""

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
        self._lives: dict[int, Life] = {}  # of the writers, when they were last looked at
        self.stopped_detector = StoppedDetector(lambda pid: self._lives[pid].stopped)
        self.channels = ChannelKeeper(driver, standby, lambda why: self._break(Reason.WIRE, why))
        self._keeper = keeper
        self._on_decided = on_decided
        self._on_failed = on_failed
        self.state = StateIs(Mode.DOWN, 0, "" if keeper is None else keeper.found_by, "")
        self.last_report: StopReport | None = None
        self._confirmed = True
        self._leaving = self._released = False
        self._is_last = False  # there will be no other wire
        self._ticks = 0
        self._guarded: GuardedWire | None = None  # of the wire that lives
        self._stopped_looks = 0
        self._failure_detector = self._listen()
        self._silent_until_ns = 0
        self._renews = False  # this life of the wire ends because its process is spent
        self._broken = trio.Event()
        self._why = (Reason.WIRE, "")
        self.idle = trio.Event()  # no wire group runs, and nothing more is done about what the last one left
        self.idle.set()
        self.reported = trio.Event()  # since the present wire's end, or there is none to report
        self.reported.set()
        self._again = trio.Event()
        self._waiting: list[Deferred] = []
        self._ordered = SafeState.HOLD  # the most severe since the present wire was started
        self._was_told = False  # the present wire has said how it stands
        self._begins_locked = False  # the present wire knows of a lock since its start
        self._alone = trio.Lock()  # between two wires: who makes safe, or starts the next one
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
                if self._guarded is not None:  # the dead say nothing any more
                    if self._broken.is_set() and self.state.locked_by and not message.locked_by:
                        # Told before its end: it has not heard of an e-stop that came to us.
                        message = msgspec.structs.replace(message, locked_by=self.state.locked_by)
                    self.state = message
                    if not self._was_told:  # a gate is there, and its link is not up yet
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
        """To another wire than before."""
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
        """One that dies is not waited for: its end is told after its memory was taken."""
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
        """A wire that was stopped before its first heartbeat is not missed by its silence."""
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
        """What moves goes on: root and wire are both there. Nothing is armed before there is
        another."""
        self.context.note(Happened("there is no standby", why))
        if self._guarded is not None:
            self.channels.tell_standby(f"{why}; another is being started")

    def begin_standby(self) -> None:
        """A new one has begun. The wire that is open hands over again; one that is not does when it
        opens."""
        if self._guarded is not None and self.channels.own is not None:
            self._transport.tell(HandOverAgain())

    def _keep_lock(self) -> None:
        """On the disk, and tell the gate when it is."""
        state = self.state
        if self._keeper is not None:
            self._keeper.want(state.locked_by)
        if state.locked_by:
            self.context.start_soon(self._tell_kept, state)

    async def _tell_kept(self, state: StateIs) -> None:
        kept = await self._kept(state.locked_by)
        self._gate.tell(LockKept(state.epoch, kept.since, kept.problem))

    async def _kept(self, by: str) -> Kept:
        return Kept("") if self._keeper is None else await self._keeper.kept(by)

    async def _answer_fence(self, waiting: Deferred, report: StopReport) -> None:
        """When its lock is on the disk, too."""
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
        if ordered.severity > usual.severity:  # it is not safe as this wants it
            self._confirmed, self._owed.safe_state = False, True
        self._waiting.append(deferred)
        self._again.set()
        if self._attempting is not None and ordered.severity > self._attempting_state.severity:
            self._attempting.cancel()  # a landing takes seconds
        if self._guarded is None and self.idle.is_set():
            self.context.start_soon(self.serve_waiting)
        else:
            self._break(message.reason, f"{message.reason}: no answer from the wire")
        return deferred

    def _tell_stopped(self) -> None:
        """Tell the gate of a stop that was answered without it: no resume from before that counts."""
        if self._guarded is not None and self._owed.stopped_ns:
            self._gate.tell(StoppedAt(self._owed.stopped_ns))

    @property
    def _usual(self) -> SafeState:
        """Return what the end of a wire by itself leads to."""
        return SafeState(self._driver.fallbacks[Reason.WIRE])

    def _covering(self, message: Fence, ordered: SafeState) -> StopReport | None:
        """Return a report of this robot that answers an order, when nothing has to be done for it."""
        report = self.last_report
        if report is None or not self._confirmed or not SafeState(report.safe_state).at_least(ordered):
            return None
        if self._guarded is None:
            return report if self.reported.is_set() else None
        # A wire that begins has energised nothing, and each that is ended costs of the restarts. Of a
        # lock it has to know from its start.
        knows = not message.lock or self._begins_locked
        return report if knows and not self._failure_detector.heard_ns else None

    async def serve_waiting(self) -> None:
        """For orders that come while there is no wire. The next one waits for it."""
        async with self._alone:
            if self._guarded is None and self._waiting:
                await self._make_safe(self.state.epoch)
                if not self._confirmed and (self._is_last or self._leaving):
                    await self._insist(self.state.epoch, float("inf"))

    # -- the end of the tree

    def leave(self) -> None:
        """The tree ends: no new wire. One that is not confirmed safe is made so for as long as
        ``LINGER_S``."""
        self._leaving = True
        self._again.set()

    async def end(self, reason: Reason, by: str, confirmed: bool) -> None:
        """End the wire, after ``leave``, and return when the robot has been made safe once
        (``reported``), or was. ``confirmed``: the gate's own stop was. Then the wire ends by
        itself, and its exit code says whether that still holds; else it is fenced."""
        guarded = self._guarded
        if guarded is None and self.idle.is_set() and not self._confirmed and not self._is_last:
            # The next wire could not be started: there will be none.
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
        """Return whether nothing of ours is energised any more, as far as is known."""
        return self._confirmed

    @property
    def at_work(self) -> bool:
        """Return whether something was ordered that nobody has done yet."""
        return bool(self._waiting) or self._alone.locked()

    # -- one life of the wire group after the other

    async def keep(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """The supervisor's child: one life of the wire group, and another whenever its process is
        spent. Always raises ``WireBroken`` or ``Cancelled``."""
        while True:
            while self.at_work:
                async with self._alone:
                    if self._waiting:
                        await self._make_safe(self.state.epoch)
            if self._leaving:  # looked at last: no wire is started when nobody ends it any more
                task_status.started()
                await trio.sleep_forever()
            await self._live(task_status)
            if not self._renews:
                raise WireBroken(self._why[1])
            task_status = trio.TASK_STATUS_IGNORED
            await trio.sleep(RENEW_PAUSE_S)

    async def insist(self) -> None:
        """There will be no other wire: make safe until it is confirmed, or the tree ends."""
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
        except BaseException:  # no process, no descriptor: nobody is to wait for the end of this life
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
            self.last_report = None  # it was safe by the wire's word, which is no answer to an e-stop
        else:
            await self._insist(epoch, INSIST_S)
        await self.channels.let_go()
        began_s = trio.current_time()
        while not fenced:  # two processes at one port would be worse than none
            if self._leaving and trio.current_time() > began_s + LINGER_S:
                break  # there will be no other
            fenced = await self._fenced(guarded)
            if fenced and self._look_for_requests(fenced):
                await self._insist(epoch, INSIST_S)
        while self._waiting:  # who asked meanwhile
            await self._make_safe(epoch)
        self.reported.set()
        self.idle.set()

    def _look_for_requests(self, fenced: bool) -> bool:
        """Note that what the wire asked for is cut off now. Return whether that may still take effect:
        then the robot is not safe, whatever the wire said last."""
        now_ns = self.context.clock.now_ns()
        if fenced:
            self._owed.cut_off(now_ns)
        unsettled = self._owed.unsettled_s(now_ns) > 0
        if unsettled:
            self._confirmed = False
        return unsettled

    async def _fence_guarded(self, guarded: GuardedWire) -> bool:
        """Write, then fence. A root that dies in between leaves a wire that acts by itself, or a
        safe robot.

        Only where the wire is broken. A root that ends while its wire is well fences first: that
        wire could write a setpoint after the safe frame. The wire would make safe by itself if the
        root died before the fence."""
        async with trio.open_nursery() as nursery:
            if self.channels.own is not None and guarded.alive and self._broken.is_set():
                nursery.start_soon(attempt, self.channels.own, self._driver, self._wanted())
                for _ in range(2):  # by the second one it has run, as far as its first wait
                    await trio.lowlevel.checkpoint()
            fenced = await self._fenced(guarded)
            nursery.cancel_scope.cancel()
        return fenced

    async def _fenced(self, guarded: GuardedWire) -> bool:
        """Fence it. Whatever fails, the robot is made safe all the same."""
        try:
            return await guarded.fence()
        except Exception as error:
            report_failure("the fence of the wire process", error)
            await trio.sleep(FENCE_AGAIN_S)
            return False

    async def _insist(self, epoch: int, for_s: float) -> None:
        """Make safe until every motor confirms it, or the time is over: ``LINGER_S`` when the tree
        ends. What was safe by the gate's word is written to once: a motor that says nothing may be
        one that is not there."""
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
        """Return where to bring the robot: what was ordered stands on the page, and here, since a wire
        that is about to end may still confirm it, and clear the page."""
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
                # This wire had not come so far as to energise anything, and what the one before left is
                # as it was.
                motors = await self._settled(partial(attempt_anew, self._driver, self.context.clock, safe_state))
        self._attempting = None
        if not all_safe(motors):
            self._on_failed()
        if not safe_state.at_least(self._wanted()):
            self._confirmed = False
            return  # an order has come meanwhile that wants more: the next attempt is for all
        if motors:  # else nothing was attempted, and it is as it was
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
