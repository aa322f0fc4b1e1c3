"""The standby process: makes the robot safe when neither root nor wire is left.

It has a session of its own and ignores every signal that can be ignored: it ends by its root's
order (SIGKILL), which is the last thing a root does, or by itself when nothing is left to do.

It holds a stop channel of its own, the driver's: a duplicate of the serial descriptor by way of the
root, or a session of its own on a network. A wire's link counts as up only when that could be used
at once, and it is closed before the next wire opens the port.

It is not the spawner: that one forks what runs code of others, so it must stay a process with one
thread and nothing open. The root forks the standby before it has threads itself.
"""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import trio

from strands_actors.contract.driver import Driver, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown
from strands_actors.kernel.actor import Actor, Deferred, first_of
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.clock import NS, MonotonicClock
from strands_actors.kernel.health.heartbeat import Heartbeat, words_of
from strands_actors.kernel.health.processor import suspected
from strands_actors.kernel.health.realtime import STANDBY_PRIORITY, run_first
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Node
from strands_actors.kernel.processes.child import report_failure
from strands_actors.kernel.processes.identity import be_taken_last, take_name
from strands_actors.kernel.processes.peer import Peer
from strands_actors.kernel.processes.process import FENCE_S
from strands_actors.kernel.processes.reserve import EXIT_SHORT, RESERVE
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.introspection import Introspector
from strands_actors.supervisors.loading import load_driver
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, Owed
from strands_actors.supervisors.root.stop_channel import (
    LINGER_S,
    all_safe,
    attempt,
    attempt_anew,
    pauses_s,
    serve,
    settled,
)
from strands_actors.supervisors.standby.messages import Guard, Guarding, LetGo, LetGone, WatchOver
from strands_actors.supervisors.wire.watchdog import Tick

from .decision import Action, Seen, decide
from .report import LifeLock, StandbyReport, write
from .watch import Watched, look_s

IGNORED = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGXCPU,  # it is the last that can stop the robot: it goes on until the system kills it
    signal.SIGXFSZ,
)
UNCONFIRMED = 4
"""Exit code when a motor did not confirm the safe state."""
NO_CHANNEL = 5
"""Exit code when the way to the hardware was lost: another standby is started, and looks for
one."""
GONE_S = 10.0
"""A port to which nothing could be written for so long is gone."""
LOCK_S = 1.0
"""For whoever only looks at the lock."""
CHECK_S = 0.25
"""Between two looks whether this process still has what a stop needs."""
DISK_S = 1.0
"""A report that takes longer to write is not waited for."""


class _Seen:
    """One of the two processes, as it was last seen."""

    def __init__(self, name: str, pid: int, peer: Peer | None, heartbeat: Heartbeat, watched: Watched) -> None:
        self.name = name
        self.pid = pid  # 0: there is none
        self.peer = peer
        self.heartbeat = heartbeat
        self.watched = watched
        self.seen = Seen.ENDED if peer is None else Seen.RUNS
        self.fenced = ""  # why it was ended by us


class Standby(Actor):
    """``report``: where its report is left. ``watched``: the processes that live when it begins.
    ``leave`` ends the process, with an exit code."""

    def __init__(
        self,
        driver: Driver,
        robot: str,
        place: str,
        report: Path,
        watched: WatchOver,
        leave: Callable[[int], None],
    ) -> None:
        self._driver = driver
        self._robot = robot
        self._place = place
        self._report = report
        self._watched = watched
        self._leave = leave
        self._channel: StopChannel | None = None
        self._channel_scope = trio.CancelScope()
        self._channel_ready = False
        self._acts = False
        self._check_at_ns = 0

    async def started(self) -> None:
        page, root_fd, wire_fd = _parts_of(self._watched)
        self._words = words_of(page)
        os.close(page)
        self._owed = Owed(self._words)
        self._root = self._seen("root", self._watched.root, root_fd, ROOT)
        self._wire = self._seen("wire", self._watched.wire, wire_fd, WIRE)
        self.context.every(look_s(self._driver.timing), Tick)

    def receive(self, message: WatchOver | Guard | LetGo | Tick) -> Guarding | LetGone | Refused | Deferred | None:
        match message:
            case Tick():
                self._tick(message.now_ns)
            case WatchOver():
                self._watch_over(message)
                return Guarding()
            case Guard():
                return self._guard(message)
            case LetGo():
                self._drop_channel()
                return LetGone()
        return None

    # -- what is watched

    def _watch_over(self, message: WatchOver) -> None:
        """The wire that lives now: of page and root it has its own."""
        page, root_fd, wire_fd = _parts_of(message)
        for fd in (page, root_fd):
            if fd is not None:
                os.close(fd)
        self._watch_wire(message.wire, wire_fd)

    def _watch_wire(self, pid: int, pidfd: int | None) -> None:
        if self._wire.peer is not None:
            self._wire.peer.close()
        self._wire = self._seen("wire", pid, pidfd, WIRE)

    def _last_wire(self) -> _Seen:
        """The wire that was started last: its root may have ended before it told us of it."""
        pid = self._owed.wire_pid
        if pid not in (0, self._wire.pid):
            self._watch_wire(pid, None)
        return self._wire

    def _seen(self, name: str, pid: int, pidfd: int | None, at: int) -> _Seen:
        peer = Peer(pid, pidfd) if pid else None
        heartbeat = Heartbeat(self._words, STANDBY, at)
        watched = Watched(self._driver.timing, partial(suspected, pid), self.context.clock.now_ns())
        seen = _Seen(name, pid, peer, heartbeat, watched)
        if peer is not None:
            self.context.start_soon(self._see_end, seen, peer)
        return seen

    async def _see_end(self, seen: _Seen, peer: Peer) -> None:
        await peer.wait()
        seen.seen = Seen.ENDED
        self._decide()

    def _tick(self, now_ns: int) -> None:
        self._check_reserve(now_ns)
        root, wire = self._root, self._last_wire()
        root.heartbeat.beat(now_ns)  # ours: both ends of the two are one
        for process, may_be_silent_until_ns in ((root, 0), (wire, self._owed.silent_until_ns)):
            if process.seen is not Seen.ENDED:
                process.seen = process.watched.see(
                    now_ns, process.heartbeat.heard_ns, False, may_be_silent_until_ns
                )
        self._decide()
        if not self._acts and self._channel is not None and self._channel_ready and self._channel.lacks:
            self._leave(NO_CHANNEL)  # the root starts another, and arms nothing until that one is ready

    def _check_reserve(self, now_ns: int) -> None:
        """End when this process lacks what a stop needs. As long as the root lives it starts another."""
        if self._acts or self._root.seen is not Seen.RUNS or now_ns < self._check_at_ns:
            return
        self._check_at_ns = now_ns + round(CHECK_S * NS)
        if missing := RESERVE.check():
            report_failure("the standby process", RuntimeError(f"it could not stop the robot: {missing}"))
            self._leave(EXIT_SHORT)

    # -- what is done

    def _decide(self) -> None:
        if self._acts:
            return
        root, wire = self._root, self._last_wire()
        match decide(root.seen, wire.seen, self._owed.safe_state):
            case Action.FENCE:
                self._acts = True
                self.context.start_soon(self._fence, root, wire)
            case Action.MAKE_SAFE:
                self._acts = True
                self.context.start_soon(self._make_safe, root, wire)
            case Action.LEAVE:
                self._leave(0)
            case Action.WAIT:
                pass

    async def _fence(self, *processes: _Seen) -> None:
        """Both orders first: nobody of the two may go on while the other is waited for."""
        now_ns = self.context.clock.now_ns()
        async with trio.open_nursery() as nursery:
            for process in processes:
                if process.seen is Seen.SILENT and process.peer is not None:
                    process.fenced = process.watched.told(now_ns)
                    nursery.start_soon(process.peer.fence, FENCE_S)
        for process in processes:
            process.seen = Seen.ENDED  # who was killed and is still there runs no code of its own
        self._acts = False
        self._decide()

    async def _make_safe(self, root: _Seen, wire: _Seen) -> None:
        """Again and again until every motor confirms it, the port is gone, or ``LINGER_S`` are
        over."""
        safe_state = self._owed.order(self._driver.fallbacks[Reason.WIRE])
        self._owed.cut_off(self.context.clock.now_ns())
        why = "; ".join(_told(process) for process in (root, wire))
        attempts, motors = 0, tuple[MotorReport, ...]()
        until_s = trio.current_time() + LINGER_S
        gone_s = trio.current_time() + GONE_S
        for pause_s in pauses_s():
            async with trio.open_nursery() as nursery:
                results: list[tuple[MotorReport, ...]] = []
                nursery.start_soon(self._attempt, safe_state, results)
                if not attempts:
                    for _ in range(2):  # by the second one it has run, as far as its first wait
                        await trio.lowlevel.checkpoint()
                    begun = self._reported(why, safe_state, (), 0, over=False)
                    nursery.start_soon(self._tell, begun)
            attempts, motors = attempts + 1, results[0]
            confirmed = all_safe(motors)
            if confirmed:
                self._owed.safe_state = False
            if any(motor.written for motor in motors):
                gone_s = trio.current_time() + GONE_S
            over = confirmed or trio.current_time() + pause_s > min(until_s, gone_s)
            await self._tell(self._reported(why, safe_state, motors, attempts, over))
            if over:
                break
            await trio.sleep(pause_s)
        self._leave(0 if all_safe(motors) else UNCONFIRMED)

    def _reported(
        self, why: str, safe_state: SafeState, motors: tuple[MotorReport, ...], attempts: int, over: bool
    ) -> StandbyReport:
        confirmed = bool(motors) and all_safe(motors)
        return StandbyReport(
            self._robot, self._place, why, safe_state, confirmed, motors, attempts, over, os.getpid()
        )

    async def _attempt(self, safe_state: SafeState, results: list[tuple[MotorReport, ...]]) -> None:
        clock = self.context.clock

        async def once() -> tuple[MotorReport, ...]:
            if self._channel is not None:
                return await attempt(self._channel, self._driver, safe_state)
            return await attempt_anew(self._driver, clock, safe_state)

        results.append(await settled(self._owed, clock, once))

    async def _tell(self, report: StandbyReport) -> None:
        """In a thread: nothing waits for a disk."""
        with trio.move_on_after(DISK_S):
            try:
                await trio.to_thread.run_sync(write, self._report, report, abandon_on_cancel=True)
            except (OSError, RuntimeError, MemoryError) as error:  # the disk, or no thread can be started
                report_failure("the report of the standby", error)

    # -- the stop channel

    def _guard(self, message: Guard) -> Deferred:
        """Answered when the stop channel could be used at once."""
        self._drop_channel()
        self._channel = channel = self._driver.stop_channel(message.descriptors, self.context.clock)
        self._channel_scope = trio.CancelScope()
        deferred = self.context.defer()
        self.context.start_soon(self._keep_channel, channel, self._channel_scope, deferred)
        return deferred

    async def _keep_channel(self, channel: StopChannel, scope: trio.CancelScope, deferred: Deferred) -> None:
        ready = False
        with scope:
            try:
                async with trio.open_nursery() as nursery:
                    await nursery.start(serve, channel)
                    ready = self._channel_ready = True
                    deferred.send(Guarding())
            except* WireDown as down:
                if not ready:
                    if self._channel is channel:  # who acts later connects anew
                        self._drop_channel()
                    deferred.send(Refused(Code.NO_STOP_CHANNEL, str(first_of(down))))
                elif not self._acts:
                    self._leave(NO_CHANNEL)

    def _drop_channel(self) -> None:
        if self._channel is not None:
            self._channel_scope.cancel()
            self._channel.close()
            self._channel = None
            self._channel_ready = False


def _parts_of(told: WatchOver) -> tuple[int, int | None, int | None]:
    """Return the descriptor of the page, and a pidfd of root and of wire, where there is one."""
    page, *pidfds = told.descriptors
    root_fd, wire_fd, *_ = (*pidfds, None, None)
    return page, root_fd, wire_fd


def _told(process: _Seen) -> str:
    return f"the {process.name} {f'was ended ({process.fenced})' if process.fenced else 'had ended'}"


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Entry of the standby process."""
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    robot: str = args["robot"]
    take_name(robot, "standby", args["label"])
    be_taken_last()
    lock = _take_lock(Path(args["lock"]), args["place"])
    report = Path(args["report"])
    at = addresses.of(robot)
    driver = load_driver(args["driver"])
    run_first(STANDBY_PRIORITY)
    node = Node(f"{robot}.standby.{os.getpid()}", MonotonicClock())
    root_channel = channels.of_root(robot)
    node.linked = root_channel.hosts or frozenset()
    link = Link(node, sock, channel=root_channel)
    watched = WatchOver(args["root"], args["wire"], tuple(args["descriptors"]))
    standby = Standby(driver, robot, args["place"], report, watched, os._exit)
    RESERVE.begin(lambda: False)  # it is the last: what it lacks may come back
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell(at.path("standby"), lambda: standby).run)
        nursery.start_soon(node.cell(at.introspection("standby"), Introspector, "introspection").run)
        await link.run()
        await trio.sleep_forever()  # without a root, too: what it watches decides
    raise AssertionError(lock)


def _take_lock(path: Path, place: str) -> LifeLock:
    """Raise ``BlockingIOError`` when the standby of an earlier tree still lives."""
    until_s = time.monotonic() + LOCK_S
    while True:
        try:
            return LifeLock(path, place)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.005)
