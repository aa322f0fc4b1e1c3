"""The fifth kind of stop channel: a process of its own, for what needs a vendor's SDK or gRPC.

Neither may be loaded in the root, which must never hang. The child loads ``CHANNEL``, an ordinary
stop channel, and makes safe when it is asked to, over a socket pair; a newer order ends the one
that is being carried out. A child that does not answer in time (its SDK hangs, or keeps the
interpreter's lock) is killed, and another one is started and asked.
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
from typing import Any, ClassVar, Generic

import msgspec
import trio

from strands_actors.kernel.clock import Clock, MonotonicClock
from strands_actors.kernel.health.realtime import STANDBY_PRIORITY, run_first
from strands_actors.kernel.processes.identity import be_taken_last, take_name
from strands_actors.kernel.processes.process import ChildProcess, start
from strands_actors.kernel.processes.reserve import RESERVE, raise_limits

from .loading import load, place_of
from .safe_state import SafeState
from .stop_channels import ConfigT, Reports
from .wire import MotorReport, StopChannel, WireDown

_ENTRY = "strands_actors.contract.stop_process:main"
_DEATH_SIGNAL = 1
"""``PR_SET_PDEATHSIG`` of Linux."""
_KILLED_S = 0.2
"""How long the end of a killed child is waited for, before the next one is started."""
_HEADER = 4


class _Order(msgspec.Struct, frozen=True):
    number: int
    safe_state: SafeState


class _Answer(msgspec.Struct, frozen=True):
    """``number``: of the order, 0 before the first: the child is ready. ``trouble``: why it cannot
    be used."""

    number: int = 0
    reports: tuple[MotorReport, ...] = ()
    trouble: str = ""


class OwnProcess(StopChannel, Generic[ConfigT]):
    """``config`` is a struct of msgspec: it travels to the child as plain data."""

    CHANNEL: ClassVar[str]
    """``module:class`` of the stop channel, made in the child as ``class(config, descriptors,
    clock)``."""
    START_S: ClassVar[float] = 4.0
    """Within which a child has loaded and connected what it needs. Two of them begin at a time, the
    root's and the standby's, on a busy machine."""
    ANSWER_S: ClassVar[float] = 0.6
    """Within which it has made safe. Two answers and a start are to fit into ``Timing.safe_s``."""
    AGAIN_S: ClassVar[float] = 0.2
    """Pause before a child that ended by itself is replaced."""
    ATTEMPTS: ClassVar[int] = 2

    def __init__(self, config: ConfigT, descriptors: Sequence[int], clock: Clock) -> None:
        self.config = config
        self._descriptors = tuple(descriptors)
        self._child: _Child | None = None
        self._starting = trio.Lock()
        self._serving = trio.CancelScope()

    @abstractmethod
    def failed(self, why: str) -> Reports:
        """Report that no motor is confirmed."""

    async def serve(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        told = False
        with self._serving:
            child = await self._ready()
            told = True
            task_status.started()
            while True:
                await child.process.wait()
                await trio.sleep(self.AGAIN_S)
                with contextlib.suppress(WireDown):
                    await self._end()
                    child = await self._ready()
        if not told:
            task_status.started()  # it has been used meanwhile

    async def make_safe(self, safe_state: SafeState) -> Reports:
        self._serving.cancel()
        why = ""
        for _ in range(self.ATTEMPTS):
            try:
                child = await self._ready()
                return await self._ask(child, safe_state)
            except WireDown as down:
                why = str(down)
                await self._end()
        return self.failed(why)

    def close(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            child.abandon()
        for descriptor in self._descriptors:
            os.close(descriptor)
        self._descriptors = ()

    async def _ask(self, child: _Child, safe_state: SafeState) -> Reports:
        """Raise ``WireDown``. When cancelled, the child lives on: the guardian cancels what it asked
        before a fence to ask again after it, and a new child would need a new login."""
        number = child.send(safe_state)
        return (await child.receive(number, self.ANSWER_S)).reports

    async def _ready(self) -> _Child:
        """Return the child to ask, started when there is none. Raise ``WireDown``."""
        # A stop may come while ``serve`` starts one: whoever is second takes that one, or starts
        # another when it was given up, so that none is left that nobody knows of.
        async with self._starting:
            return self._child or await self._begin()

    async def _begin(self) -> _Child:
        """Start a child that is ready to be asked. Raise ``WireDown``."""
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
        child = _Child(process, self.CHANNEL)
        try:
            await child.receive(0, self.START_S)
            self._child = child
            return child
        finally:
            if self._child is not child:
                child.abandon()

    async def _end(self) -> None:
        child, self._child = self._child, None
        if child is not None:
            await child.process.fence(_KILLED_S)


class _Child:
    """The root's end of the conversation."""

    def __init__(self, process: ChildProcess, name: str) -> None:
        self.process = process
        self._name = name.rpartition(":")[2]
        self._frames = _Frames(process.socket)
        self._orders = 0

    def send(self, safe_state: SafeState) -> int:
        """Return the order's number. Raise ``WireDown``."""
        self._orders += 1
        try:
            self._frames.send(_Order(self._orders, safe_state))
        except OSError as error:
            raise WireDown(f"stop channel: the process of {self._name} takes no order ({error.strerror})") from None
        return self._orders

    async def receive(self, number: int, within_s: float) -> _Answer:
        """Return the answer to that order; those before it are dropped. Raise ``WireDown`` when it
        does not come in time, the child ends, or it tells of trouble."""
        with trio.move_on_after(within_s):
            while (data := await self._frames.receive()) is not None:
                answer = msgspec.msgpack.decode(data, type=_Answer)
                if answer.trouble:
                    raise WireDown(answer.trouble)
                if answer.number == number:
                    return answer
            raise WireDown(f"stop channel: the process of {self._name} has ended. What it says is above")
        raise WireDown(f"stop channel: the process of {self._name} did not answer within {within_s:g} s")

    def abandon(self) -> None:
        """Kill it; nobody waits for its end."""
        self.process.kill()
        self.process.part()
        self.process.socket.close()


class _Frames:
    """Messages on a stream: four bytes of length, then msgpack."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._socket = sock
        self._heard = b""

    def send(self, message: msgspec.Struct) -> None:
        """Raise ``OSError``: at once, or not at all."""
        data = msgspec.msgpack.encode(message)
        self._socket.send(len(data).to_bytes(_HEADER, "little") + data)

    async def receive(self) -> bytes | None:
        """Return the next message; None: the other end is gone."""
        while True:
            size = int.from_bytes(self._heard[:_HEADER], "little")
            if len(self._heard) >= _HEADER + size and self._heard:
                data, self._heard = self._heard[_HEADER : _HEADER + size], self._heard[_HEADER + size :]
                return data
            await trio.lowlevel.wait_readable(self._socket)
            try:
                more = self._socket.recv(1 << 16)
            except BlockingIOError:
                continue
            except OSError:
                return None
            if not more:
                return None
            self._heard += more


# -- in the child


def main(args: dict[str, Any], sock: socket.socket) -> None:
    _end_with_parent(args["parent"])
    take_name(args["channel"].rpartition(":")[2], "stop")
    config = msgspec.convert(args["config"], load(args["config_class"]))
    channel: StopChannel = load(args["channel"])(config, args["descriptors"], MonotonicClock())
    be_taken_last()
    raise_limits()
    RESERVE.begin(lambda: True)
    run_first(STANDBY_PRIORITY)  # it is what makes the robot safe when the wire cannot
    trio.run(_answer, channel, _Frames(sock))


async def _answer(channel: StopChannel, frames: _Frames) -> None:
    try:
        async with trio.open_nursery() as nursery:
            try:
                await nursery.start(channel.serve)
            except WireDown as down:
                frames.send(_Answer(trouble=str(down)))
                return
            frames.send(_Answer())
            one_at_a_time, carried_out = trio.Lock(), trio.CancelScope()

            async def carry_out(order: _Order, scope: trio.CancelScope) -> None:
                async with one_at_a_time:
                    with scope:
                        with RESERVE.freed():
                            reports = await channel.make_safe(order.safe_state)
                        if not all(report.safe for report in reports):
                            RESERVE.end_if_short()  # the parent starts another process
                        frames.send(_Answer(order.number, reports))

            while (data := await frames.receive()) is not None:
                carried_out.cancel()  # nobody waits for it any more
                carried_out = trio.CancelScope()
                nursery.start_soon(carry_out, msgspec.msgpack.decode(data, type=_Order), carried_out)
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
