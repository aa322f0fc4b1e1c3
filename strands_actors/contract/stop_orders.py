"""The conversation between a process and the children that stop a robot for it (``stop_process``):
orders and answers on a socket pair."""

from __future__ import annotations

import socket
from collections.abc import Callable

import msgspec
import trio

from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.health.processor import life_of
from strands_actors.kernel.processes.process import ChildProcess

from .safe_state import SafeState
from .stop_channels import Reports
from .wire import MotorReport, WireDown

_HEADER = 4


class Order(msgspec.Struct, frozen=True):
    """``safe_state`` None: give a sign of life, and do nothing."""

    number: int
    safe_state: SafeState | None = None


class Answer(msgspec.Struct, frozen=True):
    """``number``: of the order, 0 before the first: the child is ready. ``reports`` None: it has the
    order, and begins to carry it out. ``trouble``: why it cannot be used."""

    number: int = 0
    reports: tuple[MotorReport, ...] | None = None
    trouble: str = ""


class StopChild:
    """The root's end of the conversation. Every answer acknowledges the orders up to its number."""

    def __init__(self, process: ChildProcess, name: str, clock: Clock) -> None:
        self.process = process
        self._name = short_name(name)
        self._clock = clock
        self._frames = Frames(process.socket)
        self._is_ready = False
        self._sent = self._acknowledged = 0  # numbers of orders
        self._unheard_ns = 0  # since when an order is not acknowledged; 0: every one is
        self._carries_out_ns = 0  # since when it carries out an order; 0: it is idle
        self._done: Answer | None = None  # the last order that it has carried out
        self._is_awaited = False  # a task waits for its answers, and judges how long they may take

    @property
    def is_lost(self) -> bool:
        """Return whether the system says that it has been killed, or is stopped."""
        life = life_of(self.process.pid)
        return life.dying or life.stopped or not self.process.alive

    def send(self, safe_state: SafeState | None) -> int:
        """Send an order and return its number; None: ask for a sign of life. Raise ``WireDown``."""
        try:
            self._frames.send(Order(self._sent + 1, safe_state))
        except OSError as error:
            raise WireDown(f"stop channel: the process of {self._name} takes no order ({error.strerror})") from None
        self._sent += 1
        now_ns = self._clock.now_ns()
        self._unheard_ns = self._unheard_ns or now_ns
        if safe_state is not None:
            self._carries_out_ns = now_ns
        return self._sent

    async def ready(self, within_s: float) -> None:
        """Return when it could carry out an order. Raise ``WireDown``."""
        if not await self._until(lambda: self._is_ready, within_s):
            raise self._silent(within_s)

    async def acknowledges(self, number: int, within_s: float) -> bool:
        """Return whether it acknowledges an order in time, from the first one on that it has not
        acknowledged. Raise ``WireDown`` when it ends."""
        self._take_waiting()  # its answer to the last look may be here, unread: then it is not silent
        left_s = within_s - (self._clock.now_ns() - self._unheard_ns) / NS
        return await self._until(lambda: self._acknowledged >= number, max(0.0, left_s))

    async def carried_out(self, number: int, within_s: float) -> Reports:
        """Return the reports of an order. Raise ``WireDown`` when they do not come in time."""

        def reports() -> Reports | None:
            return self._done.reports if self._done is not None and self._done.number == number else None

        await self._until(lambda: reports() is not None, within_s)
        found = reports()
        if found is None:
            raise self._silent(within_s)
        return found

    def is_alive(self, now_ns: int, busy_s: float) -> bool:
        """Return whether it has answered all that it was asked, and ask for the next sign of life. One
        that carries out an order need not answer for ``busy_s``."""
        if self._is_awaited:
            return True
        try:
            self._take_waiting()
            if self._carries_out_ns and now_ns - self._carries_out_ns < busy_s * NS:
                return True
            if self._acknowledged < self._sent:
                return False
            self.send(None)
        except WireDown:
            return False  # its end is seen elsewhere
        return True

    def hang_up(self) -> None:
        """End the wait for its answers: before its socket is closed."""
        trio.lowlevel.notify_closing(self.process.socket)

    def abandon(self) -> None:
        """Kill it; nobody waits for its end."""
        self.hang_up()
        self.process.kill()
        self.process.part()
        self.process.socket.close()

    async def _until(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Take answers until ``condition()``; return whether that came in time. Raise ``WireDown``
        when the child ends, or tells of trouble."""
        self._take_waiting()
        self._is_awaited = True
        try:
            with trio.move_on_after(within_s):
                while not condition():
                    self._take(await self._frames.receive())
        finally:
            self._is_awaited = False
        return condition()

    def _take_waiting(self) -> None:
        while (data := self._frames.waiting()) is not None:
            self._take(data)

    def _take(self, data: bytes) -> None:
        if not data:
            raise WireDown(f"stop channel: the process of {self._name} has ended. What it says is above")
        answer = msgspec.msgpack.decode(data, type=Answer)
        if answer.trouble:
            raise WireDown(answer.trouble)
        self._is_ready = True
        self._acknowledged = max(self._acknowledged, answer.number)
        self._unheard_ns = 0 if self._acknowledged == self._sent else self._clock.now_ns()
        if answer.reports is not None:
            self._done, self._carries_out_ns = answer, 0

    def _silent(self, within_s: float) -> WireDown:
        return WireDown(f"stop channel: the process of {self._name} did not answer within {within_s:g} s")


class Frames:
    """Messages on a stream: four bytes of length, then msgpack."""

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._socket = sock
        self._received = b""

    def send(self, message: msgspec.Struct) -> None:
        """Raise ``OSError``: at once, or not at all."""
        data = msgspec.msgpack.encode(message)
        self._socket.send(len(data).to_bytes(_HEADER, "little") + data)

    async def receive(self) -> bytes:
        """Return the next message; empty: the other end is gone."""
        while (data := self.waiting()) is None:
            try:
                await trio.lowlevel.wait_readable(self._socket)
            except trio.ClosedResourceError:  # we have hung up
                return b""
        return data

    def waiting(self) -> bytes | None:
        """Return the next message, empty when the other end is gone, None when there is none yet."""
        while True:
            size = int.from_bytes(self._received[:_HEADER], "little")
            if len(self._received) >= _HEADER + size and self._received:
                data, self._received = (
                    self._received[_HEADER : _HEADER + size],
                    self._received[_HEADER + size :],
                )
                return data
            try:
                more = self._socket.recv(1 << 16)
            except BlockingIOError:
                return None
            except OSError:
                return b""
            if not more:
                return b""
            self._received += more


def short_name(place: str) -> str:
    """Return the class's name of ``module:class``."""
    return place.rpartition(":")[2]
