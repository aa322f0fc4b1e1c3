"""The messages between a process and its child processes that can stop a robot (``stop_process``).

Orders and answers go over a socket pair. The child acknowledges each order at once. When it has carried out the
order, it answers again, with a report on each motor.
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
    """An order to stop the robot. Without a ``safe_state`` it only requests a sign of life."""

    number: int
    safe_state: SafeState | None = None


class Answer(msgspec.Struct, frozen=True):
    """An answer of the child process to an order.

    Attributes:
        number: The number of the order. 0 in the first answer, which means that the child is ready.
        reports: A report on each motor after the stop. None if the answer only acknowledges the order, before the
            stop.
        trouble: Why the child cannot be used. Empty if it can.
    """

    number: int = 0
    reports: tuple[MotorReport, ...] | None = None
    trouble: str = ""


class StopChild:
    """The parent's side of the connection to one child process.

    An answer to an order also acknowledges earlier orders.
    """

    def __init__(self, process: ChildProcess, name: str, clock: Clock) -> None:
        self.process = process
        self._name = short_name(name)
        self._clock = clock
        self._frames = Frames(process.socket)
        self._is_ready = False
        # Numbers of the last order that was sent, and of the last one that was acknowledged.
        self._sent = self._acknowledged = 0
        # Time since which an order waits for its acknowledgement; 0 if no order waits.
        self._unacknowledged_ns = 0
        # Time at which the child got the order that it carries out; 0 while it is idle.
        self._carries_out_ns = 0
        # The answer with the reports of the last order that the child has carried out.
        self._done: Answer | None = None
        # True while a task waits for an answer. That task limits the waiting time itself.
        self._is_awaited = False

    @property
    def is_lost(self) -> bool:
        """True if the system reports that the child was killed, has ended, or is frozen (SIGSTOP)."""
        life = life_of(self.process.pid)
        return life.dying or life.stopped or not self.process.alive

    def send(self, safe_state: SafeState | None) -> int:
        """Send an order, and return its number.

        Without a safe state it requests a sign of life. Raise ``WireDown`` if the order cannot be sent.
        """
        try:
            self._frames.send(Order(self._sent + 1, safe_state))
        except OSError as error:
            raise WireDown(f"stop channel: cannot send to the process of {self._name} ({error.strerror})") from None
        self._sent += 1
        now_ns = self._clock.now_ns()
        self._unacknowledged_ns = self._unacknowledged_ns or now_ns
        if safe_state is not None:
            self._carries_out_ns = now_ns
        return self._sent

    async def ready(self, within_s: float) -> None:
        """Wait until the child can carry out orders. Raise ``WireDown`` if it is not ready in time."""
        if not await self._until(lambda: self._is_ready, within_s):
            raise self._silent(within_s)

    async def acknowledges(self, number: int, within_s: float) -> bool:
        """Return True if the child acknowledges an order within ``within_s``.

        The time begins with the oldest order that the child has not acknowledged. Raise ``WireDown`` if the child
        ends.
        """
        # An answer to the last request for a sign of life may have arrived without having been read yet. Then the
        # child is not silent.
        self._take_waiting()
        left_s = within_s - (self._clock.now_ns() - self._unacknowledged_ns) / NS
        return await self._until(lambda: self._acknowledged >= number, max(0.0, left_s))

    async def carried_out(self, number: int, within_s: float) -> Reports:
        """Return a report on each motor after an order was carried out.

        Raise ``WireDown`` if the reports do not arrive in time.
        """

        def reports() -> Reports | None:
            return self._done.reports if self._done is not None and self._done.number == number else None

        await self._until(lambda: reports() is not None, within_s)
        result = reports()
        if result is None:
            raise self._silent(within_s)
        return result

    def is_alive(self, now_ns: int, busy_s: float) -> bool:
        """Return True if the child has answered all orders. Then also request its next sign of life.

        While the child carries out an order, it may be silent for ``busy_s``.
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
            # The child has ended. Another task notices that, too, and replaces the child.
            return False
        return True

    def hang_up(self) -> None:
        """End the wait of a task for answers of the child. Call this before the socket is closed."""
        trio.lowlevel.notify_closing(self.process.socket)

    def abandon(self) -> None:
        """Kill the child without waiting for its end."""
        self.hang_up()
        self.process.kill()
        self.process.detach()
        self.process.socket.close()

    async def _until(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Handle answers of the child until ``condition()`` is true. Return False if ``within_s`` passes before.

        Raise ``WireDown`` if the child ends or reports trouble.
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
            raise WireDown(f"stop channel: the process of {self._name} has ended. Its error is printed above")
        answer = msgspec.msgpack.decode(data, type=Answer)
        if answer.trouble:
            raise WireDown(answer.trouble)
        self._is_ready = True
        self._acknowledged = max(self._acknowledged, answer.number)
        self._unacknowledged_ns = 0 if self._acknowledged == self._sent else self._clock.now_ns()
        if answer.reports is not None:
            self._done, self._carries_out_ns = answer, 0

    def _silent(self, within_s: float) -> WireDown:
        return WireDown(f"stop channel: the process of {self._name} did not answer within {within_s:g} s")


class Frames:
    """Send and receive messages on a stream socket.

    Each has four bytes with its length, and then its data (msgpack).
    """

    def __init__(self, sock: socket.socket) -> None:
        sock.setblocking(False)
        self._socket = sock
        self._received = b""

    def send(self, message: msgspec.Struct) -> None:
        """Send a message without waiting. Raise ``OSError`` if the socket cannot take it at once."""
        data = msgspec.msgpack.encode(message)
        self._socket.send(len(data).to_bytes(_HEADER, "little") + data)

    async def receive(self) -> bytes:
        """Return the next message. It is empty if the other process has closed the connection."""
        while (data := self.waiting()) is None:
            try:
                await trio.lowlevel.wait_readable(self._socket)
            # This process has closed its end of the connection.
            except trio.ClosedResourceError:
                return b""
        return data

    def waiting(self) -> bytes | None:
        """Return the next message without waiting.

        It is None if no message has arrived yet, and empty if the other process has closed the connection.
        """
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
