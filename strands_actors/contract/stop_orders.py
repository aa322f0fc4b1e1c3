"""The messages between a process and the children that stop a robot for it (``stop_process``).

Orders and answers go over a socket pair. The child acknowledges each order at once, and answers again with the
reports when it has carried it out.
"""

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
    """An order. Without a ``safe_state`` it only requests a sign of life."""

    number: int
    safe_state: SafeState | None = None


class Answer(msgspec.Struct, frozen=True):
    """An answer.

    Attributes:
        number: The number of the order. 0 before the first one: the child is ready.
        reports: The reports of the stop. None acknowledges the order, which the child then carries out.
        trouble: Why the child cannot be used. Empty if it can.
    """

    number: int = 0
    reports: tuple[MotorReport, ...] | None = None
    trouble: str = ""


class StopChild:
    """The parent's side of one child. Every answer acknowledges the orders up to its number."""

    def __init__(self, process: ChildProcess, name: str, clock: Clock) -> None:
        self.process = process
        self._name = short_name(name)
        self._clock = clock
        self._frames = Frames(process.socket)
        self._is_ready = False
        self._sent = self._acknowledged = 0  # numbers of orders
        self._unheard_ns = 0  # time since which an order lacks its acknowledgement; 0 if none does
        self._carries_out_ns = 0  # time of the order that it carries out; 0 while it is idle
        self._done: Answer | None = None  # the last order that it has carried out
        # True while a task waits for the child's answers, and itself limits the time for them.
        self._is_awaited = False

    @property
    def is_lost(self) -> bool:
        """True if the system reports that the child was killed or is stopped."""
        life = life_of(self.process.pid)
        return life.dying or life.stopped or not self.process.alive

    def send(self, safe_state: SafeState | None) -> int:
        """Send an order and return its number. None requests a sign of life. Raise ``WireDown``."""
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
        """Wait until the child can carry out an order. Raise ``WireDown``."""
        if not await self._until(lambda: self._is_ready, within_s):
            raise self._silent(within_s)

    async def acknowledges(self, number: int, within_s: float) -> bool:
        """Return True if the child acknowledges an order in time.

        The time counts from its oldest order without acknowledgement. Raise ``WireDown`` when the child ends.
        """
        # An unread answer to the last sign of life may be here. Then the child is not silent.
        self._take_waiting()
        left_s = within_s - (self._clock.now_ns() - self._unheard_ns) / NS
        return await self._until(lambda: self._acknowledged >= number, max(0.0, left_s))

    async def carried_out(self, number: int, within_s: float) -> Reports:
        """Return the reports of an order. Raise ``WireDown`` if they do not come in time."""

        def reports() -> Reports | None:
            return self._done.reports if self._done is not None and self._done.number == number else None

        await self._until(lambda: reports() is not None, within_s)
        result = reports()
        if result is None:
            raise self._silent(within_s)
        return result

    def is_alive(self, now_ns: int, busy_s: float) -> bool:
        """Return True if the child has answered all orders, and request the next sign of life.

        A child that carries out an order need not answer for ``busy_s``.
        """
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
            return False  # another task notices its end
        return True

    def hang_up(self) -> None:
        """End the wait for answers. Call it before the socket is closed."""
        trio.lowlevel.notify_closing(self.process.socket)

    def abandon(self) -> None:
        """Kill the child without waiting for its end."""
        self.hang_up()
        self.process.kill()
        self.process.part()
        self.process.socket.close()

    async def _until(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Handle answers until ``condition()`` is true. Return True if that came in time.

        Raise ``WireDown`` when the child ends or reports trouble.
        """
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
        """Send a message without waiting. Raise ``OSError`` if it cannot leave at once."""
        data = msgspec.msgpack.encode(message)
        self._socket.send(len(data).to_bytes(_HEADER, "little") + data)

    async def receive(self) -> bytes:
        """Return the next message, or nothing if the other end is gone."""
        while (data := self.waiting()) is None:
            try:
                await trio.lowlevel.wait_readable(self._socket)
            except trio.ClosedResourceError:  # this end has hung up
                return b""
        return data

    def waiting(self) -> bytes | None:
        """Return the next message. It is empty when the other end is gone, and None if no message has come yet."""
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
    """Return the name of the class in ``module:class``."""
    return place.rpartition(":")[2]
