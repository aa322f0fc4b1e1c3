"""The guardian keeps the wire group, and holds the second path to the hardware.

When the wire process dies or stops beating: **fence** it (SIGKILL, and wait for its end: a paused owner
that resumes would write again), *then* write the safe frames by its own descriptors, then confirm, then
let the supervisor start the wire anew, closed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Protocol

import msgspec
import trio

from strands_actors.runtime.actor import Actor, Deferred, describe
from strands_actors.runtime.clock import NS
from strands_actors.runtime.contract import Driver, MotorReport, Reason, SecondPath, WireDown
from strands_actors.runtime.messages import Refused
from strands_actors.runtime.node import Ref
from strands_actors.runtime.processor import Standing, is_stopped
from strands_actors.runtime.pulse import Pulse
from strands_actors.runtime.silence import Silence

from .failsafe import Mode, State
from .lock_keeper import Kept, LockKeeper
from .messages import (
    Fence,
    HandedOver,
    Handover,
    Happened,
    LockKept,
    Renew,
    SilentUntil,
    StateIs,
    Stopped,
    StopReport,
)
from .stoppage import LOOK_EVERY, Stoppage
from .watchdog import Tick

START_DEADLINE_S = 10.0
RENEW_PAUSE_S = 0.05


class WireBroken(Exception):
    """The wire group has ended; it was fenced and the robot made safe."""


class Place(Protocol):
    """Where the wire group lives: a process of its own, or this one (tests)."""

    async def ended(self) -> str:
        """Return when it has ended by itself, with the reason."""
        ...

    async def fence(self) -> None:
        """Return when it can never write again."""
        ...

    def standing(self) -> Standing | None:
        """How its process stands with the processor; None where nobody can tell."""
        ...


class Guardian(Actor):
    """``start_wire(start, cause)`` starts the wire group from a failsafe state, with what led to it, and returns
    its place. ``gate`` is told when one of the processes that ``writers`` names has been stopped, and when the
    lock of an e-stop is kept by the ``keeper``."""

    def __init__(
        self,
        driver: Driver,
        pulse: Pulse,
        start_wire: Callable[[State, str], Place],
        on_state: Callable[[StateIs], None] | None = None,
        gate: str = "",
        writers: Callable[[], Iterable[int]] = tuple,
        keeper: LockKeeper | None = None,
    ) -> None:
        self._driver = driver
        self._pulse = pulse
        self._start_wire = start_wire
        self._on_state = on_state
        self._gate_address = gate
        self._writers = writers
        self._stoppage = Stoppage(is_stopped)
        self._second: SecondPath | None = None
        self._second_scope = trio.CancelScope()
        self._keeper = keeper
        self.state = StateIs(Mode.DOWN, 0, "" if keeper is None else keeper.found_by, "")
        self.last_report: StopReport | None = None
        self._confirmed = True
        self._orderly = self._leaving = False
        self._ticks = 0
        self._silence = self._listen()
        self._silent_until_ns = 0
        self._renews = False  # this life of the wire ends because its process is spent
        self._broken = trio.Event()
        self._why = (Reason.WIRE, "")
        self.idle = trio.Event()  # no wire group runs, and the last one was made safe
        self.idle.set()
        self._waiting: list[Deferred] = []

    async def started(self) -> None:
        self._gate: Ref = self.context.ref(self._gate_address)
        self.context.every(self._driver.timing.tick_s, Tick)

    def receive(
        self, message: Tick | SilentUntil | Renew | StateIs | Handover | Fence
    ) -> HandedOver | StopReport | Refused | Deferred | None:
        match message:
            case Tick():
                self._tick(message.now_ns)
            case SilentUntil():
                self._silence.heard(self.context.clock.now_ns())
                longest_ns = self._silence.heard_ns + round(self._driver.timing.silent_s * NS)
                self._silent_until_ns = min(message.until_ns, longest_ns)
            case Renew():
                self._renews = True
                self._break(Reason.WIRE, message.why)
            case StateIs():
                self.state = message
                self._confirmed = message.mode in (Mode.DOWN, Mode.DISARMED)
                self._keep_lock()
                if self._on_state is not None:
                    self._on_state(message)
            case Handover():
                return self._take(message)
            case Fence():
                return self._fence(message)
        return None

    def _listen(self, look: Callable[[], Standing | None] = lambda: None) -> Silence:
        """To another wire than before."""
        self._pulse.forget()
        timing = self._driver.timing
        return Silence(timing.beat_ttl_s, timing.tick_s, look)

    def _tick(self, now_ns: int) -> None:
        self._pulse.beat(now_ns)
        self._silence.heard(self._pulse.heard_ns)
        self._ticks += 1
        if self._ticks % LOOK_EVERY == 0:
            for pid in self._stoppage.look(self._writers()):
                self._gate.tell(Stopped(pid))
        if now_ns >= self._silent_until_ns and self._silence.tick(now_ns):
            self._break(Reason.WIRE, f"the wire process stopped answering ({self._silence.told(now_ns)})")

    def _break(self, reason: Reason, why: str) -> None:
        if not self._broken.is_set():
            self._why = reason, why
            self._broken.set()

    # -- the second path

    def _take(self, message: Handover) -> Deferred:
        """Answered when the path could be used at once."""
        self._drop_second()
        self._second = path = self._driver.second_path(message.descriptors, self.context.clock)
        self._second_scope = trio.CancelScope()
        deferred = self.context.defer()
        self.context.start_soon(self._keep_second, path, self._second_scope, deferred)
        return deferred

    async def _keep_second(self, path: SecondPath, scope: trio.CancelScope, deferred: Deferred) -> None:
        ready = False
        with scope:
            try:
                async with trio.open_nursery() as nursery:
                    await nursery.start(path.serve)
                    ready = True
                    deferred.send(HandedOver())
            except* WireDown as down:
                why = describe(down).partition(": ")[2]
                if ready:
                    self._break(Reason.WIRE, f"the root has lost its way to the hardware: {why}")
                else:
                    deferred.send(Refused("no_second_path", why))  # the wire tries again by itself

    def _drop_second(self) -> None:
        if self._second is not None:
            self._second_scope.cancel()
            self._second.close()
            self._second = None

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
        lock = (message.by or "an operator") if message.lock else self.state.locked_by
        self.state = StateIs(self.state.mode, self.state.epoch, lock, self.state.cause)
        deferred = self.context.defer()
        if self.idle.is_set() and self.last_report is not None:
            self._keep_lock()
            self.context.start_soon(self._answer_fence, deferred, self.last_report)
            return deferred
        self._break(message.reason, f"{message.reason}: no answer from the wire")
        self._waiting.append(deferred)
        return deferred

    def leave(self, confirmed: bool) -> None:
        """The tree is being shut down: no new wire. ``confirmed``: the gate's own stop was, so fence without
        writing again."""
        self._leaving = True
        self._orderly = confirmed

    async def keep(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """The supervisor's child: one life of the wire group, and another whenever its process is spent. Always
        raises ``WireBroken`` or ``Cancelled``."""
        while True:
            if self._leaving:
                task_status.started()
                await trio.sleep_forever()
            await self._live(task_status)
            if not self._renews:
                raise WireBroken(self._why[1])
            task_status = trio.TASK_STATUS_IGNORED
            await trio.sleep(RENEW_PAUSE_S)

    async def _live(self, task_status: trio.TaskStatus[None]) -> None:
        self._renews = False
        self._broken = trio.Event()
        self.idle = trio.Event()
        self._silent_until_ns = 0
        locked_by = self.state.locked_by
        start = State(Mode.DOWN if self._confirmed else Mode.LOST, self.state.epoch + 1, locked_by)
        place = self._start_wire(start, self.state.cause)
        self._silence = self._listen(place.standing)
        try:
            task_status.started()
            await self._until_broken(place)
        finally:
            with trio.CancelScope(shield=True):
                await place.fence()
                self.context.note(Happened("the wire has ended", self._why[1]))
                self._silence = self._listen()
                if not self._orderly:
                    await self._make_safe(start.epoch)
                self.idle.set()

    async def _until_broken(self, place: Place) -> None:
        async with trio.open_nursery() as nursery:

            async def watch() -> None:
                self._break(Reason.WIRE, await place.ended())

            async def watch_start() -> None:
                await trio.sleep(START_DEADLINE_S)
                if not self._silence.heard_ns:
                    self._break(Reason.WIRE, f"the wire did not start within {START_DEADLINE_S:g} s")

            nursery.start_soon(watch)
            nursery.start_soon(watch_start)
            await self._broken.wait()
            nursery.cancel_scope.cancel()

    async def _make_safe(self, epoch: int) -> None:
        reason, why = self._why
        rung = self._driver.ladder[Reason.WIRE]
        began_ns = self.context.clock.now_ns()
        motors: tuple[MotorReport, ...] = ()
        if self._second is not None:
            motors = await self._second.make_safe(rung)
            self._confirmed = all(motor.safe for motor in motors)
            self._drop_second()  # it would keep the next wire from the port, which is locked while it is open
        elif not self._confirmed:
            # This wire had not come so far as to energise anything, and what the one before left is as it was.
            motors = tuple(
                MotorReport(axis, number, False, False, False, "the link is not back yet")
                for axis, number in zip(self._driver.axes, self._driver.ids, strict=True)
            )
        now_ns = self.context.clock.now_ns()
        took_ms = (now_ns - began_ns) / 1e6
        epoch = max(epoch, self.state.epoch) + 1
        self.last_report = StopReport(reason, rung, epoch, self._confirmed, motors, "second", took_ms, now_ns)
        self.state = StateIs(Mode.DOWN if self._confirmed else Mode.LOST, epoch, self.state.locked_by, why)
        self.context.note(self.last_report)
        self.context.note(self.state)
        if self._on_state is not None:
            self._on_state(self.state)
        self._keep_lock()
        for waiting in self._waiting:
            self.context.start_soon(self._answer_fence, waiting, self.last_report)
        self._waiting.clear()
