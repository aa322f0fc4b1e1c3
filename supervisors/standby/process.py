"""The standby process stops the robot when neither the root nor the wire process can.

It runs in its own session and ignores every signal that can be ignored. Normally the root kills it as the root's
last action. Without a root, it exits when nothing is left to do.

It keeps a second stop channel ready, its own way to the hardware: a duplicate of the open serial port, passed on by
the root, or its own network connection. The robot counts as connected only when this channel is ready. The channel
is closed before the next wire process opens the port.

The root forks the standby itself, before it has threads. The spawner cannot do this. It forks processes that run
user code, so it must keep one thread and no open files.
"""

from __future__ import annotations

import mmap
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
from strands_actors.contract.wire import MotorReport, StopChannel, WireDown, all_safe
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
from strands_actors.supervisors import addresses
from strands_actors.supervisors import permissions as channels
from strands_actors.supervisors.introspection import Introspector
from strands_actors.supervisors.loading import load_driver
from strands_actors.supervisors.page import ROOT, STANDBY, WIRE, SafetyPage
from strands_actors.supervisors.refusals import no_stop_channel
from strands_actors.supervisors.root.stop_channel import (
    LINGER_S,
    attempt,
    attempt_anew,
    none_unsafe,
    pauses_s,
    serve,
    settled,
)
from strands_actors.supervisors.standby.messages import Guard, Guarding, LetGo, LetGone, WatchOver
from strands_actors.supervisors.wire.watchdog import Tick

from .decision import Action, ProcessState, decide
from .report import LifeLock, StandbyReport, write
from .watch import Watched, look_s

IGNORED = (
    signal.SIGINT,
    signal.SIGTERM,
    signal.SIGHUP,
    signal.SIGQUIT,
    signal.SIGUSR1,
    signal.SIGUSR2,
    signal.SIGXCPU,  # a standby that has used up its CPU time must still stop the robot
    signal.SIGXFSZ,
)
UNCONFIRMED = 4
"""Exit code when a motor did not confirm the safe state."""
NO_CHANNEL = 5
"""Exit code when the stop channel has failed. The root then starts another standby, which opens a new
channel."""
UNREACHABLE_S = 10.0
"""After this many seconds without a successful write, the port no longer exists for the standby."""
LOCK_S = 1.0
"""How long to wait for the lock, in seconds. Other processes take it for a moment to see if it is free."""
CHECK_S = 0.25
"""Period of the check that this process still has the resources that a stop needs."""
STOP_BYTES = 256 << 10
"""Memory that the check uses for a moment, in bytes. A stop takes up to 92 KiB of new memory, measured on Spot,
RB-Y1, SO-101 and xArm."""
DISK_S = 1.0
"""Longest time for writing a report to the disk, in seconds."""


class _WatchedProcess:
    """The root or the wire process, as the standby watches it."""

    def __init__(self, name: str, pid: int, peer: Peer | None, heartbeat: Heartbeat, watched: Watched) -> None:
        self.name = name
        self.pid = pid  # process id; 0 if the process was not started
        self.peer = peer
        self.heartbeat = heartbeat
        self.watched = watched
        self.state = ProcessState.ENDED if peer is None else ProcessState.RUNS
        self.fenced = ""  # why the standby killed this process; empty if it did not


class Standby(Actor):
    """Watch root and wire, and stop the robot when neither can.

    Args:
        driver: The driver of the robot.
        robot: Name of the robot.
        place: Port or address of the robot (``StandbyReport.place``).
        report: Path of the file for the report.
        watched: The processes that run at the start.
        leave: Ends this process with an exit code.
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
        self._safety_page = SafetyPage(self._words)
        self._root = self._watch("root", self._watched.root, root_fd, ROOT)
        self._wire = self._watch("wire", self._watched.wire, wire_fd, WIRE)
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

    # -- the processes that are watched

    def _watch_over(self, message: WatchOver) -> None:
        """Watch a new wire process. The page and the root are already known, so their new descriptors are
        closed."""
        page, root_fd, wire_fd = _parts_of(message)
        for fd in (page, root_fd):
            if fd is not None:
                os.close(fd)
        self._watch_wire(message.wire, wire_fd)

    def _watch_wire(self, pid: int, pidfd: int | None) -> None:
        if self._wire.peer is not None:
            self._wire.peer.close()
        self._wire = self._watch("wire", pid, pidfd, WIRE)

    def _last_wire(self) -> _WatchedProcess:
        """Return the wire process that was started last. Its pid is read from the shared page, since the root may
        have died before it could send the message about it."""
        pid = self._safety_page.wire_pid
        if pid not in (0, self._wire.pid):
            self._watch_wire(pid, None)
        return self._wire

    def _watch(self, name: str, pid: int, pidfd: int | None, index: int) -> _WatchedProcess:
        peer = Peer(pid, pidfd) if pid else None
        heartbeat = Heartbeat(self._words, STANDBY, index)
        watched = Watched(self._driver.timing, partial(suspected, pid), self.context.clock.now_ns())
        watched_process = _WatchedProcess(name, pid, peer, heartbeat, watched)
        if peer is not None:
            self.context.start_soon(self._note_end, watched_process, peer)
        return watched_process

    async def _note_end(self, process: _WatchedProcess, peer: Peer) -> None:
        await peer.wait()
        process.state = ProcessState.ENDED
        self._decide()

    def _tick(self, now_ns: int) -> None:
        self._check_reserve(now_ns)
        root, wire = self._root, self._last_wire()
        # The standby has one heartbeat, which both root and wire read.
        root.heartbeat.beat(now_ns)
        for process, may_be_silent_until_ns in ((root, 0), (wire, self._safety_page.silent_until_ns)):
            if process.state is not ProcessState.ENDED:
                process.state = process.watched.see(
                    now_ns, process.heartbeat.last_received_ns, False, may_be_silent_until_ns
                )
        self._decide()
        if not self._acts and self._channel is not None and self._channel_ready and self._channel.lacks:
            # The root then starts another standby, and arms nothing until that one is ready.
            self._leave(NO_CHANNEL)

    def _check_reserve(self, now_ns: int) -> None:
        """Exit if this process lacks a resource, such as memory, that it needs to stop the robot. The root then
        starts another standby."""
        if self._acts or self._root.state is not ProcessState.RUNS or now_ns < self._check_at_ns:
            return
        self._check_at_ns = now_ns + round(CHECK_S * NS)
        if missing := RESERVE.check() or _lacks_memory():
            report_failure("the standby process", RuntimeError(f"the standby could not stop the robot: {missing}"))
            self._leave(EXIT_SHORT)

    # -- actions of the standby: decide, fence, stop the robot

    def _decide(self) -> None:
        if self._acts:
            return
        root, wire = self._root, self._last_wire()
        match decide(root.state, wire.state, self._safety_page.may_be_energised):
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

    async def _fence(self, *processes: _WatchedProcess) -> None:
        """Kill all silent processes, then wait until they have ended. Kill all of them before the first wait, since
        a silent process may wake up meanwhile."""
        now_ns = self.context.clock.now_ns()
        async with trio.open_nursery() as nursery:
            for process in processes:
                if process.state is ProcessState.SILENT and process.peer is not None:
                    process.fenced = process.watched.describe_silence(now_ns)
                    nursery.start_soon(process.peer.fence, FENCE_S)
        for process in processes:
            # A killed process runs no more of its code, even if it still exists.
            process.state = ProcessState.ENDED
        self._acts = False
        self._decide()

    async def _make_safe(self, root: _WatchedProcess, wire: _WatchedProcess) -> None:
        """Write the safe state until every motor confirms it, the port no longer exists, or ``LINGER_S`` have
        passed. Then exit."""
        safe_state = self._safety_page.order(self._driver.fallbacks[Reason.WIRE])
        self._safety_page.cut_off(self.context.clock.now_ns())
        cause = "; ".join(_describe_end(process) for process in (root, wire))
        attempts, motors = 0, tuple[MotorReport, ...]()
        until_s = trio.current_time() + LINGER_S
        unreachable_s = trio.current_time() + UNREACHABLE_S
        for pause_s in pauses_s():
            async with trio.open_nursery() as nursery:
                results: list[tuple[MotorReport, ...]] = []
                nursery.start_soon(self._attempt, safe_state, results)
                if not attempts:
                    # After two checkpoints the attempt has come to its first wait, so the first frame was sent.
                    for _ in range(2):
                        await trio.lowlevel.checkpoint()
                    begun = self._reported(cause, safe_state, (), 0, over=False)
                    nursery.start_soon(self._tell, begun)
            attempts, motors = attempts + 1, results[0]
            confirmed = none_unsafe(motors)
            if confirmed:
                self._safety_page.may_be_energised = False
            if any(motor.written for motor in motors):
                unreachable_s = trio.current_time() + UNREACHABLE_S
            over = confirmed or trio.current_time() + pause_s > min(until_s, unreachable_s)
            await self._tell(self._reported(cause, safe_state, motors, attempts, over))
            if over:
                break
            await trio.sleep(pause_s)
        self._leave(0 if none_unsafe(motors) else UNCONFIRMED)

    def _reported(
        self, cause: str, safe_state: SafeState, motors: tuple[MotorReport, ...], attempts: int, over: bool
    ) -> StandbyReport:
        confirmed = all_safe(motors)
        return StandbyReport(
            self._robot, self._place, cause, safe_state, confirmed, motors, attempts, over, os.getpid()
        )

    async def _attempt(self, safe_state: SafeState, results: list[tuple[MotorReport, ...]]) -> None:
        clock = self.context.clock

        async def once() -> tuple[MotorReport, ...]:
            if self._channel is not None:
                return await attempt(self._channel, self._driver, safe_state)
            return await attempt_anew(self._driver, clock, safe_state)

        results.append(await settled(self._safety_page, clock, once))

    async def _tell(self, report: StandbyReport) -> None:
        """Write the report in a thread, for ``DISK_S`` at most, so that a slow disk does not delay a stop."""
        with trio.move_on_after(DISK_S):
            try:
                await trio.to_thread.run_sync(write, self._report, report, abandon_on_cancel=True)
            # Error of the disk, or no thread could be started.
            except (OSError, RuntimeError, MemoryError) as error:
                report_failure("the report of the standby", error)

    # -- the stop channel of the standby

    def _guard(self, message: Guard) -> Deferred:
        """Open the stop channel. The reply is sent when it is ready to stop the robot."""
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
                    # Without this channel, a later stop opens a new one.
                    if self._channel is channel:
                        self._drop_channel()
                    deferred.send(no_stop_channel(str(first_of(down))))
                elif not self._acts:
                    self._leave(NO_CHANNEL)

    def _drop_channel(self) -> None:
        if self._channel is not None:
            self._channel_scope.cancel()
            self._channel.close()
            self._channel = None
            self._channel_ready = False


def _parts_of(message: WatchOver) -> tuple[int, int | None, int | None]:
    """Return the descriptors in a message: the shared page, and the pidfds of root and wire. A pidfd that is
    missing in the message is None."""
    page, *pidfds = message.descriptors
    root_fd, wire_fd, *_ = (*pidfds, None, None)
    return page, root_fd, wire_fd


def _lacks_memory() -> str:
    """Use as much new memory as a stop does, and free it again.

    A waiting standby uses no new memory, so it does not notice that its control group has none left. The kernel
    would end it in the middle of a stop, when no process is left that could start another one. Here the kernel ends
    it while the root can still do that.

    Returns:
        The resource that this process lacks, for people; empty if the memory was there.
    """
    try:
        with mmap.mmap(-1, STOP_BYTES, flags=mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS) as memory:
            for offset in range(0, STOP_BYTES, mmap.PAGESIZE):
                memory[offset] = 1
    except (OSError, MemoryError):
        return "no memory is free"
    return ""


def _describe_end(process: _WatchedProcess) -> str:
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
    actors = addresses.of(robot)
    driver = load_driver(args["driver"])
    run_first(STANDBY_PRIORITY)
    node = Node(f"{robot}.standby.{os.getpid()}", MonotonicClock())
    root_channel = channels.of_root(robot)
    node.linked = root_channel.hosts or frozenset()
    link = Link(node, sock, channel=root_channel)
    watched = WatchOver(args["root"], args["wire"], tuple(args["descriptors"]))
    standby = Standby(driver, robot, args["place"], report, watched, os._exit)
    # Never exit because a resource is missing, since it may become free again.
    RESERVE.begin(lambda: False)
    async with trio.open_nursery() as nursery:
        await nursery.start(node.run)
        await nursery.start(node.cell(actors.path("standby"), lambda: standby).run)
        nursery.start_soon(node.cell(actors.introspection("standby"), Introspector, "introspection").run)
        await link.run()
        # The link ends with the root process, but the standby must continue.
        await trio.sleep_forever()
    raise AssertionError(lock)


def _take_lock(path: Path, place: str) -> LifeLock:
    """Take the lock of the standby. Raise ``BlockingIOError`` if a standby of an earlier start still runs."""
    until_s = time.monotonic() + LOCK_S
    while True:
        try:
            return LifeLock(path, place)
        except BlockingIOError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.005)
