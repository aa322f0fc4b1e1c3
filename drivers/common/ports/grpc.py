"""A gRPC client for a wire process or a stop channel: h2 over ``tcp_port``, with a deadline on every wait.

One object is one connection. A message leaves at once or raises. No message waits to be sent, or is sent
again on a later connection. Check a permit immediately before ``Call.send``, which does not wait.

A call is not withdrawn if its answer is not awaited. So a stop still counts when a frozen peer continues.
``Call.cancel`` withdraws a call.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import WireDown

from ..codecs.grpc_messages import MAX_MESSAGE, ClientEnd, Ended, Heard, Left, Status
from ..codecs.malformed import MalformedFrame
from .receive_budget import ReceiveBudget
from .tcp_port import ByteStream, open_tcp

KEPT = 256
"""Most messages of one call that wait to be taken. A new message replaces the oldest."""

FRAMES = 64
"""HTTP/2 frames that are read before other tasks run: 3 ms at most. A robot that sends a hundred states a
second sends a few in each turn."""


class Stream(ByteStream, Protocol):
    def read_waiting(self) -> bytes | None: ...
    def close_in_order(self) -> None: ...


OpenStream = Callable[[str, int], Awaitable[Stream]]


class CallFailed(WireDown):
    """The peer has answered with an error.

    Attributes:
        status: The status of the call.
    """

    def __init__(self, text: str, status: Status) -> None:
        super().__init__(text)
        self.status = status


class Call:
    """One call.

    Attributes:
        messages: Received messages that were not taken yet, newest last.
        status: The final status; None while the call is open.
        text: The peer's text about the status.
    """

    def __init__(self, connection: Connection, path: str, stream: int) -> None:
        self._connection = connection
        self.path = path
        self.stream = stream
        self.messages: deque[bytes] = deque(maxlen=KEPT)
        self.status: Status | None = None
        """The final status; None while the call is open."""
        self.text = ""

    @property
    def name(self) -> str:
        return self.path.rpartition("/")[2]

    def send(self, message: bytes, last: bool = False) -> None:
        """Send a message now.

        Args:
            message: The encoded message.
            last: True ends our side of the call.

        Raises:
            WireDown: It did not leave whole. The connection is closed.
        """
        self._connection.send(self, message, last)

    def cancel(self) -> None:
        """Withdraw the call. Does nothing after its end. Raises ``WireDown``."""
        self._connection.cancel(self)

    def failure(self) -> CallFailed:
        """Return the final status as an error."""
        status = self.status if self.status is not None else Status.UNKNOWN
        return CallFailed(f"{self.name}: {status.name}{f' ({self.text})' if self.text else ''}", status)


class Connection:
    """An open connection. Several tasks may wait on it at once."""

    def __init__(self, name: str, stream: Stream, end: ClientEnd) -> None:
        """Wrap a stream. ``open_grpc`` calls this."""
        self.name = name
        self._stream = stream
        self._end = end
        self._budget = ReceiveBudget(name)
        self._calls: dict[int, Call] = {}
        self._news = trio.Event()
        self._reader: trio.CancelScope | None = None
        self._why = ""  # why it is closed

    @property
    def is_open(self) -> bool:
        return not self._why

    def call(self, path: str) -> Call:
        """Begin a call. Its first bytes leave now. Raises ``WireDown``."""
        self._check()
        try:
            call = Call(self, path, self._end.call(path))
        except MalformedFrame as malformed:
            raise self._gone(str(malformed)) from None
        self._calls[call.stream] = call
        self._flush()
        return call

    def ask(self, path: str, message: bytes) -> Call:
        """Send a request now and return its call, for ``answer``. Raises ``WireDown``."""
        call = self.call(path)
        call.send(message, last=True)
        return call

    async def answer(self, call: Call, within_s: float) -> bytes | None:
        """Return the answer to ``ask``; None if it did not come in time.

        Raises:
            CallFailed: The peer has answered with an error.
            WireDown: The connection is gone.
        """
        await self.until(lambda: bool(call.messages) or call.status is not None, within_s)
        if call.messages:
            return call.messages.popleft()
        if call.status is not None:
            raise call.failure()
        return None

    async def unary(self, path: str, message: bytes, within_s: float) -> bytes:
        """Send a request and return its answer. If it does not come in time, the request is withdrawn.

        Raises:
            CallFailed: The peer has answered with an error.
            WireDown: The connection is gone, or there is no answer in time.
        """
        call = self.ask(path, message)
        answered = False
        try:
            answer = await self.answer(call, within_s)
            answered = answer is not None
            if answer is not None:
                return answer
        finally:
            if not answered and self.is_open:
                call.cancel()
        raise WireDown(f"{self.name}: {call.name}: no answer within {within_s * 1e3:.0f} ms. Check the robot")

    async def until(self, ready: Callable[[], bool], within_s: float) -> bool:
        """Receive until ``ready()`` is true. Return whether it was in time.

        Raises:
            WireDown: The connection is gone.
        """
        with trio.move_on_after(within_s):
            while not ready():
                self._check()
                if self._end.has_unread:
                    await trio.lowlevel.checkpoint()
                    self._take(b"")
                elif self._reader is None:
                    self._take(await self._read())
                else:
                    await self._news.wait()  # The task that reads takes in the data of all tasks.
        return ready()

    def take_waiting(self) -> None:
        """Receive waiting data, as much as one turn may take. Never waits. Raises ``WireDown``."""
        self._check()
        left = FRAMES
        while left > 0:
            data = self._unread_or_waiting()
            if data is None:
                self._budget.caught_up()
                return
            left -= max(1, self._take(data, left))  # A read that begins no frame counts as one.
        try:
            self._budget.fell_behind()
        except WireDown:
            self._gone("it sends more than can be read")
            raise

    def send(self, call: Call, message: bytes, last: bool) -> None:
        """As ``Call.send``."""
        self._check()
        try:
            self._end.send(call.stream, message, last)
        except MalformedFrame as malformed:
            raise self._gone(str(malformed)) from None
        self._flush()

    def cancel(self, call: Call) -> None:
        """As ``Call.cancel``."""
        if self._calls.pop(call.stream, None) is not None:
            call.status, call.text = Status.CANCELLED, "by us"
            self._end.reset(call.stream)
            self._flush()

    def close(self) -> None:
        """Reset the connection. Data that has not arrived is thrown away. Another call does nothing."""
        self._gone("closed by us")

    def close_in_order(self) -> None:
        """As ``close``, but sent data still arrives. Meant for a stop."""
        if not self._why:
            self._stream.close_in_order()
        self._gone("closed by us")

    async def _read(self) -> bytes:
        data = b""
        try:
            with trio.CancelScope() as self._reader:  # ``close`` cancels it; nothing else ends the wait.
                data = await self._stream.read()
        except WireDown as down:
            raise self._gone(str(down)) from None
        finally:
            self._reader = None
            self._wake()  # A task that waits for this one reads on.
        self._check()
        return data

    def _unread_or_waiting(self) -> bytes | None:
        if self._end.has_unread:
            return b""
        try:
            return self._stream.read_waiting()
        except WireDown as down:
            raise self._gone(str(down)) from None

    def _take(self, data: bytes, frames: int = FRAMES) -> int:
        """Take in at most so many frames of the received data. Return their number."""
        try:
            events, begun = self._end.feed_some(data, frames)
        except MalformedFrame as malformed:
            raise self._gone(str(malformed)) from None
        left = ""
        for event in events:
            match event:
                case Heard(stream, message) if stream in self._calls:
                    self._calls[stream].messages.append(message)
                case Ended(stream, status, text) if stream in self._calls:
                    call = self._calls.pop(stream)
                    call.status, call.text = status, text
                case Left(why):
                    left = why
        if left:
            raise self._gone(left)
        self._flush()  # answers that HTTP/2 itself requires
        self._wake()
        return begun

    def _flush(self) -> None:
        data = self._end.outgoing()
        if data:
            try:
                self._stream.write(data)
            except WireDown as down:
                raise self._gone(str(down)) from None

    def _check(self) -> None:
        if self._why:
            raise WireDown(f"{self.name}: the connection is closed ({self._why}). Reconnect")

    def _gone(self, why: str) -> WireDown:
        if not self._why:
            self._why = why
            if self._reader is not None:
                self._reader.cancel()
            self._stream.close()
            self._wake()
        return WireDown(f"{self.name}: {why}. Check the robot and its network, then reconnect")

    def _wake(self) -> None:
        news, self._news = self._news, trio.Event()
        news.set()


async def open_grpc(
    host: str,
    port: int,
    *,
    within_s: float,
    settle: bool = True,
    max_message: int = MAX_MESSAGE,
    open_stream: OpenStream = open_tcp,
) -> Connection:
    """Connect and read the peer's settings.

    Args:
        host: Name or address of the peer.
        port: Its port.
        within_s: Time for everything.
        settle: False waits for no settings. Use it for a stop, which also has to reach a peer that sends
            unreadable data.
        max_message: Most bytes of one message.
        open_stream: Makes the connection. The default is plain TCP.

    Raises:
        WireDown: It failed, or took longer.
    """
    name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    connection: Connection | None = None
    opened = False
    try:
        with trio.move_on_after(within_s):
            end = ClientEnd(name, max_message=max_message)
            connection = Connection(name, await open_stream(host, port), end)
            connection._flush()
            if settle:
                await connection.until(lambda: end.settled, within_s)
            opened = not settle or end.settled
    finally:
        if connection is not None and not opened:
            connection.close()
    if connection is None or not opened:
        raise WireDown(f"{name}: it does not speak gRPC within {within_s * 1e3:.0f} ms. Check port=, and the robot")
    return connection
