"""The standby process stops the robot when neither root nor wire can.

It runs in its own session and ignores every signal that can be ignored. Its root kills it as the
root's last action; otherwise it exits when nothing is left to do.

It keeps a second stop channel of the driver ready: a duplicate of the serial descriptor, passed on
by the root, or its own network session. A wire's link counts as up only when this channel is ready.
The channel is closed before the next wire opens the port.

The root forks the standby itself, before it has threads. The spawner cannot do it: it forks
processes that run user code, so it must keep one thread and no open files.
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
from strands_actors.kernel.processes.identity import lower_oom_score, take_name
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
    signal.SIGXCPU,  # past its CPU limit it still has to stop the robot
    signal.SIGXFSZ,
)
UNCONFIRMED = 4
"""Exit code when a motor did not confirm the safe state."""
NO_CHANNEL = 5
"""Exit code when the stop channel was lost. The root then starts another standby, which opens a new
one."""
GONE_S = 10.0
"""After so many seconds without a successful write the port counts as gone."""
LOCK_S = 1.0
"""How long to wait for the lock, which other processes take for a moment to see if it is free."""
CHECK_S = 0.25
"""Period of the check that this process still has the resources that a stop needs."""
DISK_S = 1.0
"""How long to wait for the disk to take a report."""


class _Seen:
    """One of the two watched processes."""

    def __init__(self, name: str, pid: int, peer: Peer | None, heartbeat: Heartbeat, watched: Watched) -> None:
        self.name = name
        self.pid = pid  # 0 if it was not started
        self.peer = peer
        self.heartbeat = heartbeat
        self.watched = watched
        self.seen = Seen.ENDED if peer is None else Seen.RUNS
        self.fenced = ""  # why the standby killed it


class Standby(Actor):
    """Watch root and wire, and stop the robot when neither can.

    Args:
        driver: The driver of the robot.
        robot: Its name.
        place: Its port or address (``StandbyReport.place``).
        report: File of the report.
        watched: The processes that run at the start.
        leave: Exit with a code.
    """

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

    # -- the watched processes

    def _watch_over(self, message: WatchOver) -> None:
        """Watch a new wire. The page and the root stay the same, so their descriptors are closed."""
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
        """Return the wire that was started last. The root writes its pid to the shared page, since
        it may end before it has sent the message."""
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
        root.heartbeat.beat(now_ns)  # the standby's own beat, which root and wire share
        for process, may_be_silent_until_ns in ((root, 0), (wire, self._owed.silent_until_ns)):
            if process.seen is not Seen.ENDED:
                process.seen = process.watched.see(
                    now_ns, process.heartbeat.heard_ns, False, may_be_silent_until_ns
                )
        self._decide()
        if not self._acts and self._channel is not None and self._channel_ready and self._channel.lacks:
            self._leave(NO_CHANNEL)  # The root starts another standby, and arms nothing before it is ready.

    def _check_reserve(self, now_ns: int) -> None:
        """Exit when this process lacks a resource that a stop needs. The root starts another."""
        if self._acts or self._root.seen is not Seen.RUNS or now_ns < self._check_at_ns:
            return
        self._check_at_ns = now_ns + round(CHECK_S * NS)
        if missing := RESERVE.check():
            report_failure("the standby process", RuntimeError(f"it could not stop the robot: {missing}"))
            self._leave(EXIT_SHORT)

    # -- actions

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
        """Kill all silent processes, then wait for their ends. All are killed first, so that no process runs
        during the wait."""
        now_ns = self.context.clock.now_ns()
        async with trio.open_nursery() as nursery:
            for process in processes:
                if process.seen is Seen.SILENT and process.peer is not None:
                    process.fenced = process.watched.told(now_ns)
                    nursery.start_soon(process.peer.fence, FENCE_S)
        for process in processes:
            process.seen = Seen.ENDED  # A killed process runs no more of its code, even before it is gone.
        self._acts = False
        self._decide()

    async def _make_safe(self, root: _Seen, wire: _Seen) -> None:
        """Write the safe state until every motor confirms it, the port is gone, or ``LINGER_S`` have
        passed. Then exit."""
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
                    for _ in range(2):  # The attempt has then run up to its first wait: the frame left.
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
        """Write the report in a thread, so that a slow disk delays nothing."""
        with trio.move_on_after(DISK_S):
            try:
                await trio.to_thread.run_sync(write, self._report, report, abandon_on_cancel=True)
            except (OSError, RuntimeError, MemoryError) as error:  # disk, or no thread can start
                report_failure("the report of the standby", error)

    # -- the stop channel

    def _guard(self, message: Guard) -> Deferred:
        """Open the stop channel. The reply comes when it is ready for a stop."""
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
                    if self._channel is channel:  # A later stop connects anew.
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
    """Return the descriptor of the page, and the pidfds of root and wire if there are any."""
    page, *pidfds = told.descriptors
    root_fd, wire_fd, *_ = (*pidfds, None, None)
    return page, root_fd, wire_fd


def _told(process: _Seen) -> str:
    return f"the {process.name} {f'was ended ({process.fenced})' if process.fenced else 'had ended'}"


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run the standby process."""
    for number in IGNORED:
        signal.signal(number, signal.SIG_IGN)
    trio.run(_main, args, sock)


async def _main(args: dict[str, Any], sock: socket.socket) -> None:
    robot: str = args["robot"]
    take_name(robot, "standby", args["label"])
    lower_oom_score()
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
    RESERVE.begin(lambda: False)  # Never exit when a resource is missing, since it may become free again.
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell(at.path("standby"), lambda: standby).run)
        nursery.start_soon(node.cell(at.introspection("standby"), Introspector, "introspection").run)
        await link.run()
        await trio.sleep_forever()  # The link ends with the root; the standby goes on.
    raise AssertionError(lock)


def _take_lock(path: Path, place: str) -> LifeLock:
    """Take the lock. Raise ``BlockingIOError`` when the standby of an earlier tree still runs."""
    until_s = time.monotonic() + LOCK_S
    while True:
        try:
            return LifeLock(path, place)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.005)
