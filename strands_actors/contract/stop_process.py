"""A stop channel in separate processes, for a stop that needs an SDK.

An SDK must not be loaded in the root, which must never hang. A child loads ``CHANNEL``, an ordinary stop
channel, and stops the robot when it gets an order over a socket pair. A newer order replaces the present one.

Theory. Importing an SDK takes longer than the time in which the robot must be stopped. So two children (``READY``)
wait with the SDK imported. Only one of them may act on an order.

* The first child that is neither dead nor frozen (SIGSTOP) gets the order. It acknowledges the order before it
  acts.
* A child that does not acknowledge within ``ACKNOWLEDGED_S`` is killed, and the next child gets the order at once.
  So two children never write at the same time, and a frozen child never writes later.
* The last child has ``ANSWER_S`` for its answer. If it is frozen, another child is started.
* Idle children are regularly requested to send a sign of life. A child that has ended or does not answer is
  replaced.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import signal
import socket
import sys
from abc import abstractmethod
from collections.abc import Sequence
from functools import partial
from typing import Any, ClassVar, Generic

import msgspec
import trio

from strands_actors.kernel.clock import Clock, MonotonicClock
from strands_actors.kernel.health.failure_detector import FailureDetector
from strands_actors.kernel.health.processor import suspected
from strands_actors.kernel.health.realtime import STANDBY_PRIORITY, run_first
from strands_actors.kernel.processes.identity import lower_oom_score, take_name
from strands_actors.kernel.processes.process import start
from strands_actors.kernel.processes.reserve import RESERVE, raise_limits

from .loading import load, place_of
from .safe_state import SafeState
from .stop_channels import ConfigT, Reports
from .stop_orders import Answer, Frames, Order, StopChild, short_name
from .wire import StopChannel, WireDown

_ENTRY = "strands_actors.contract.stop_process:main"
_DEATH_SIGNAL = 1
"""``PR_SET_PDEATHSIG`` of Linux."""
_KILLED_S = 0.2
"""How long to wait for the end of a killed child, before the next one is started."""
LOOK_S = 0.1
"""Period of the questions for a sign of life."""
SILENT_S = 0.3
"""An idle child without a sign of life for so long is replaced. It is frozen, or its SDK keeps the
interpreter's lock."""


class OwnProcess(StopChannel, Generic[ConfigT]):
    """Stop by a child process, which has loaded the SDK.

    ``config`` is a msgspec struct, since it is sent to the child. A subclass defines ``CHANNEL`` and ``failed``.
    """

    CHANNEL: ClassVar[str]
    """``module:class`` of the stop channel, made in the child as ``class(config, descriptors, clock)``."""
    READY: ClassVar[int] = 2
    """Children that stand ready, since one may be dead or frozen when it is needed."""
    START_S: ClassVar[float] = 8.0
    """Longest start of a child. Root and standby start two each at the same time, and each computes for
    0.7 s. It must be less than ``Timing.handover_s`` of the driver."""
    ACKNOWLEDGED_S: ClassVar[float] = 0.02
    """Longest time to an acknowledgement, while there is another child to ask."""
    ANSWER_S: ClassVar[float] = 0.6
    """Longest time to a result. Two of them fit into ``Timing.safe_s``."""
    AGAIN_S: ClassVar[float] = 0.2
    """Pause before a lost child is replaced."""
    ATTEMPTS: ClassVar[int] = 2
    """How many children may fail at one order."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self._descriptors = tuple(descriptors)
        self._children: list[StopChild] = []  # child processes that are ready; the first one gets the next order
        self._beginning = 0  # number of child processes that are starting
        self._begun = trio.Event()  # set when a starting child is ready or has failed
        self._closed = False

    @abstractmethod
    def failed(self, reason: str) -> Reports:
        """Return a report on each motor, according to which its safe state is not confirmed for this reason."""

    @property
    def lacks(self) -> str:
        """Why no stop is possible at once (no child is ready); empty if a child is ready."""
        return "" if self._children else f"no process of {short_name(self.CHANNEL)} is ready to stop the robot"

    @property
    def processes(self) -> tuple[int, ...]:
        """The process ids of the ready children. The first one gets the next order."""
        return tuple(child.process.pid for child in self._children)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        """Start ``READY`` children, keep them ready, and replace each that is lost.

        Raises:
            WireDown: One of the first children cannot start.
        """
        try:
            async with trio.open_nursery() as nursery:
                async with trio.open_nursery() as beginning:
                    for _ in range(self.READY):
                        beginning.start_soon(nursery.start, self._keep_one)
                task_status.started()
        except* WireDown as down:
            raise _first_of(down) from None

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """Stop the robot. If a child is ready, the order is sent before this function first waits.

        If the call is cancelled, the child stays alive. The supervisor (guardian) cancels an order when it has to
        kill the wire process first, and repeats the order afterwards.
        """
        reason, failures = "", 0
        while failures < self.ATTEMPTS:
            try:
                child = await self._ready()
            except WireDown as down:
                reason, failures = str(down), failures + 1
                continue
            try:
                number = child.send(safe_state)
                if len(self._children) == 1 or await child.acknowledges(number, self.ACKNOWLEDGED_S):
                    failures += 1
                    return await child.carried_out(number, self.ANSWER_S)
            except WireDown as down:
                reason = str(down)
            await self._discard(child)
        return self.failed(reason)

    def close(self) -> None:
        """End all children, and close the descriptors."""
        self._closed = True
        children, self._children = self._children, []
        for child in children:
            child.abandon()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = ()

    # -- the children

    async def _ready(self) -> StopChild:
        """Return the child that gets the next order.

        Start one if no child is ready. Raise ``WireDown`` if that fails.
        """
        while True:
            while self._children and self._children[0].is_lost:
                self._children.pop(0).abandon()
            if self._children:
                return self._children[0]
            if self._beginning:
                await self._begun.wait()
            else:
                await self._begin()

    async def _keep_one(self, task_status: trio.TaskStatus[None]) -> None:
        """Keep a child ready and replace it when it is lost.

        Raises:
            WireDown: The first child cannot start.
        """
        child = await self._begin()
        task_status.started()
        while True:
            await self._until_lost(child)
            await self._discard(child)
            await trio.sleep(self.AGAIN_S)
            with contextlib.suppress(WireDown):
                child = await self._begin()

    async def _until_lost(self, child: StopChild) -> None:
        """Wait until a child has ended, was discarded, or does not answer although it is idle."""
        detector = FailureDetector(SILENT_S, LOOK_S, partial(suspected, child.process.pid))
        while child in self._children and child.process.alive:
            now_ns = self.clock.now_ns()
            if child.is_alive(now_ns, self.ANSWER_S):
                detector.note_heartbeat(now_ns)
            if detector.tick(now_ns):
                return
            await trio.sleep(LOOK_S)

    async def _begin(self) -> StopChild:
        """Start a child and wait until it is ready. Raise ``WireDown`` if it does not become ready."""
        self._beginning += 1
        kept = False
        child: StopChild | None = None
        try:
            child = self._start()
            await child.ready(self.START_S)
            kept = not self._closed
            if kept:
                self._children.append(child)
            return child
        finally:
            if child is not None and not kept:
                child.abandon()
            self._beginning -= 1
            begun, self._begun = self._begun, trio.Event()
            begun.set()

    def _start(self) -> StopChild:
        """Start a child process. Raise ``WireDown`` if the system cannot start one."""
        args = {
            "channel": self.CHANNEL,
            "config_class": place_of(type(self.config)),
            "config": msgspec.to_builtins(self.config),
            "descriptors": list(self._descriptors),
            "parent": os.getpid(),
        }
        try:
            process = start(_ENTRY, args, self._descriptors, label=f"stop channel {self.CHANNEL}")
        except OSError as error:
            RESERVE.lacked(error)
            raise WireDown(f"stop channel: cannot start a process for {self.CHANNEL} ({error.strerror})") from None
        return StopChild(process, self.CHANNEL, self.clock)

    async def _discard(self, child: StopChild) -> None:
        """Kill a child.

        The next child can get the order at once, because a killed process no longer runs any of its code.
        """
        if child not in self._children:
            # Another task has discarded the child.
            return
        self._children.remove(child)
        if self._children:
            child.abandon()
        else:
            child.hang_up()
            await child.process.fence(_KILLED_S)


def _first_of(group: BaseExceptionGroup[WireDown]) -> WireDown:
    first = group.exceptions[0]
    return _first_of(first) if isinstance(first, BaseExceptionGroup) else first


# -- code that runs in the child process


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Run a child: load its stop channel, and carry out orders until the parent ends.

    Args:
        args: The names of the channel and of the class of its configuration, that configuration as plain data,
            the descriptors, and the process id of the parent (``OwnProcess._start``).
        sock: The socket to the parent.
    """
    _end_with_parent(args["parent"])
    take_name(short_name(args["channel"]), "stop")
    config = msgspec.convert(args["config"], load(args["config_class"]))
    channel: StopChannel = load(args["channel"])(config, args["descriptors"], MonotonicClock())
    lower_oom_score()
    raise_limits()
    RESERVE.begin(lambda: True)
    # A high priority, because this process stops the robot when the wire process cannot.
    run_first(STANDBY_PRIORITY)
    trio.run(_answer, channel, Frames(sock))


async def _answer(channel: StopChannel, frames: Frames) -> None:
    try:
        async with trio.open_nursery() as nursery:
            try:
                await nursery.start(channel.serve)
            except WireDown as down:
                frames.send(Answer(trouble=str(down)))
                return
            frames.send(Answer())
            order_lock, carried_out = trio.Lock(), trio.CancelScope()

            async def carry_out(number: int, safe_state: SafeState, scope: trio.CancelScope) -> None:
                async with order_lock:
                    with scope:
                        with RESERVE.freed():
                            reports = await channel.make_safe(safe_state)
                        if not all(report.safe for report in reports):
                            # If memory or open files are short, this child ends, and its parent starts another one.
                            RESERVE.end_if_short()
                        frames.send(Answer(number, reports))

            while data := await frames.receive():
                order = msgspec.msgpack.decode(data, type=Order)
                frames.send(Answer(order.number))
                if order.safe_state is not None:
                    # The newer order replaces the one that is being carried out.
                    carried_out.cancel()
                    carried_out = trio.CancelScope()
                    nursery.start_soon(carry_out, order.number, order.safe_state, carried_out)
            nursery.cancel_scope.cancel()
    finally:
        channel.close()


def _end_with_parent(parent: int) -> None:
    """End with the parent, even if an SDK hangs or keeps the interpreter's lock.

    Only Linux can do that. On other systems a hanging child continues after its parent was killed.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, int(signal.SIGKILL))
        if os.getppid() != parent:
            # The parent had already ended when prctl was called, so no signal will come.
            os._exit(1)
