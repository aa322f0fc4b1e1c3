"""The fifth kind of stop channel: processes of its own, for what needs a vendor's SDK.

An SDK may not be loaded in the root, which must never hang. A child loads ``CHANNEL``, an ordinary
stop channel, and makes the robot safe when it is ordered to, over a socket pair. A newer order ends
the one that is being carried out.

``READY`` children stand ready, because importing an SDK takes longer than a robot's bound. Only one
of them acts on an order: the first, unless the system says that it has been killed or stopped. It
acknowledges the order before it carries it out. One that does not acknowledge within ``HEARD_S`` is
killed, and the next one is ordered at once: so two never write at a time, and a frozen one that is
continued later writes nothing. The last one is given ``ANSWER_S``, unless the system says that it
is stopped, too: then another one is begun. While nobody needs them they are
asked for a sign of life; whoever has ended, or does not answer, is replaced.
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
from strands_actors.kernel.processes.identity import be_taken_last, take_name
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
"""How long the end of a killed child is waited for, before the next one is started."""
LOOK_S = 0.1
"""How often an idle child is asked for a sign of life."""
SILENT_S = 0.3
"""An idle child that has given none for so long is frozen, or its SDK keeps the interpreter's lock."""


class OwnProcess(StopChannel, Generic[ConfigT]):
    """``config`` is a struct of msgspec: it travels to the child as plain data."""

    CHANNEL: ClassVar[str]
    """``module:class`` of the stop channel, made in the child as ``class(config, descriptors,
    clock)``."""
    READY: ClassVar[int] = 2
    """Children that stand ready: one may be dead or frozen when it is needed."""
    START_S: ClassVar[float] = 8.0
    """Within which a child has loaded and connected what it needs. Four of them begin at a time, two
    of the root's and two of the standby's: 0.7 s of computing each, on a busy machine. Less than
    ``Timing.handover_s`` of its driver."""
    HEARD_S: ClassVar[float] = 0.02
    """Within which a child acknowledges an order, as long as there is another one to ask."""
    ANSWER_S: ClassVar[float] = 0.6
    """Within which it has made safe. Two answers fit into ``Timing.safe_s``."""
    AGAIN_S: ClassVar[float] = 0.2
    """Pause before a child that was lost is replaced."""
    ATTEMPTS: ClassVar[int] = 2
    """Children that may fail to carry out one order."""

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self.clock = clock
        self._descriptors = tuple(descriptors)
        self._children: list[StopChild] = []  # that are ready, the one to ask first
        self._beginning = 0  # children that are not ready yet
        self._begun = trio.Event()  # the next of them is ready, or was given up
        self._closed = False

    @abstractmethod
    def failed(self, why: str) -> Reports:
        """Report that no motor is confirmed."""

    @property
    def lacks(self) -> str:
        return "" if self._children else f"no process of {short_name(self.CHANNEL)} is ready to stop the robot"

    @property
    def processes(self) -> tuple[int, ...]:
        """Return the ids of the children that stand ready, the one to ask first in front."""
        return tuple(child.process.pid for child in self._children)

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        try:
            async with trio.open_nursery() as nursery:
                async with trio.open_nursery() as beginning:
                    for _ in range(self.READY):
                        beginning.start_soon(nursery.start, self._keep_one)
                task_status.started()
        except* WireDown as down:
            raise _first_of(down) from None

    async def make_safe(self, safe_state: SafeState) -> Reports:
        """The first order leaves before the first wait, where a child is ready. When cancelled, the
        child lives on: the guardian cancels what it ordered before a fence to order it again after
        that, and a new child would have to load everything again."""
        why, failures = "", 0
        while failures < self.ATTEMPTS:
            try:
                child = await self._ready()
            except WireDown as down:
                why, failures = str(down), failures + 1
                continue
            try:
                number = child.send(safe_state)
                if len(self._children) == 1 or await child.acknowledges(number, self.HEARD_S):
                    failures += 1
                    return await child.carried_out(number, self.ANSWER_S)
            except WireDown as down:
                why = str(down)
            await self._discard(child)
        return self.failed(why)

    def close(self) -> None:
        self._closed = True
        children, self._children = self._children, []
        for child in children:
            child.abandon()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = ()

    # -- the children

    async def _ready(self) -> StopChild:
        """Return the child to order next; start one when there is none. Raise ``WireDown``."""
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
        """Keep a child ready, and another when it is lost. Raise ``WireDown`` when the first one
        cannot begin."""
        child = await self._begin()
        task_status.started()
        while True:
            await self._until_lost(child)
            await self._discard(child)
            await trio.sleep(self.AGAIN_S)
            with contextlib.suppress(WireDown):
                child = await self._begin()

    async def _until_lost(self, child: StopChild) -> None:
        """Return when it has ended or was given up, and when it is silent although it is idle."""
        detector = FailureDetector(SILENT_S, LOOK_S, partial(suspected, child.process.pid))
        while child in self._children and child.process.alive:
            now_ns = self.clock.now_ns()
            if child.is_alive(now_ns, self.ANSWER_S):
                detector.heard(now_ns)
            if detector.tick(now_ns):
                return
            await trio.sleep(LOOK_S)

    async def _begin(self) -> StopChild:
        """Start a child, and return it when it is ready. Raise ``WireDown``."""
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
        """Raise ``WireDown``."""
        told = {
            "channel": self.CHANNEL,
            "config_class": place_of(type(self.config)),
            "config": msgspec.to_builtins(self.config),
            "descriptors": list(self._descriptors),
            "parent": os.getpid(),
        }
        try:
            process = start(_ENTRY, told, self._descriptors, label=f"stop channel {self.CHANNEL}")
        except OSError as error:
            RESERVE.lacked(error)
            raise WireDown(f"stop channel: no process for {self.CHANNEL} ({error.strerror})") from None
        return StopChild(process, self.CHANNEL, self.clock)

    async def _discard(self, child: StopChild) -> None:
        """Kill it. The next one is ordered at once: who was killed runs no code of its own."""
        if child not in self._children:
            return  # somebody else has
        self._children.remove(child)
        if self._children:
            child.abandon()
        else:
            child.hang_up()
            await child.process.fence(_KILLED_S)


def _first_of(group: BaseExceptionGroup[WireDown]) -> WireDown:
    first = group.exceptions[0]
    return _first_of(first) if isinstance(first, BaseExceptionGroup) else first


# -- in the child


def main(args: dict[str, Any], sock: socket.socket) -> None:
    _end_with_parent(args["parent"])
    take_name(short_name(args["channel"]), "stop")
    config = msgspec.convert(args["config"], load(args["config_class"]))
    channel: StopChannel = load(args["channel"])(config, args["descriptors"], MonotonicClock())
    be_taken_last()
    raise_limits()
    RESERVE.begin(lambda: True)
    run_first(STANDBY_PRIORITY)  # it is what makes the robot safe when the wire cannot
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
            one_at_a_time, carried_out = trio.Lock(), trio.CancelScope()

            async def carry_out(number: int, safe_state: SafeState, scope: trio.CancelScope) -> None:
                async with one_at_a_time:
                    with scope:
                        with RESERVE.freed():
                            reports = await channel.make_safe(safe_state)
                        if not all(report.safe for report in reports):
                            RESERVE.end_if_short()  # the parent starts another process
                        frames.send(Answer(number, reports))

            while data := await frames.receive():
                order = msgspec.msgpack.decode(data, type=Order)
                frames.send(Answer(order.number))
                if order.safe_state is not None:
                    carried_out.cancel()  # nobody waits for it any more
                    carried_out = trio.CancelScope()
                    nursery.start_soon(carry_out, order.number, order.safe_state, carried_out)
            nursery.cancel_scope.cancel()
    finally:
        channel.close()


def _end_with_parent(parent: int) -> None:
    """End when the root does, whatever an SDK does here: it may hang, or keep the interpreter's
    lock. Without Linux a child that hangs outlives a root that is killed."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DEATH_SIGNAL, int(signal.SIGKILL))
        if os.getppid() != parent:
            os._exit(1)  # it ended before that was said
