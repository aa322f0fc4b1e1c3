"""A gRPC client for the processes that command or stop a robot: h2 over ``tcp_port``, with a deadline on every
wait.

One object is one connection. A message is sent at once, or the call raises. No message is queued, or repeated on a
later connection. Check the permission to send a command immediately before ``Call.send``, which does not wait.

If a call's answer is not awaited, the call is not cancelled. So a stop takes effect even if a frozen robot
continues later. ``Call.cancel`` cancels a call.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import WireDown

from ..codecs.grpc_messages import MAX_MESSAGE, ClientEnd, Ended, MessageReceived, PeerLeft, Status
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
    """The peer has answered a call with an error.

    Attributes:
        status: The status of the call.
    """

    def __init__(self, text: str, status: Status) -> None:
        super().__init__(text)
        self.status = status


class Call:
    """One gRPC call.

    Attributes:
        messages: Received messages that the caller has not read yet, newest last.
        status: The final status; None while the call is open.
        text: The peer's explanation of the status.
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
            last: True if no message of ours follows on this call.

        Raises:
            WireDown: The message could not be sent completely. The connection is closed.
        """
        self._connection.send(self, message, last)

    def cancel(self) -> None:
        """Cancel the call. Does nothing after its end. Raises ``WireDown``."""
        self._connection.cancel(self)

    def failure(self) -> CallFailed:
        """Return an exception with the call's final status."""
        status = self.status if self.status is not None else Status.UNKNOWN
        return CallFailed(f"{self.name}: {status.name}{f' ({self.text})' if self.text else ''}", status)


class Connection:
    """An open gRPC connection. Several tasks may wait for its answers at once."""

    def __init__(self, name: str, stream: Stream, end: ClientEnd) -> None:
        """Wrap a stream. ``open_grpc`` calls this."""
        self.name = name
        self._stream = stream
        self._end = end
        self._budget = ReceiveBudget(name)
        self._calls: dict[int, Call] = {}
        self._news = trio.Event()
        self._reader: trio.CancelScope | None = None
        self._close_reason = ""  # why the connection is closed; empty while it is open

    @property
    def is_open(self) -> bool:
        return not self._close_reason

    def call(self, path: str) -> Call:
        """Begin a call, and send the header fields of its request now. Raises ``WireDown``."""
        self._check()
        try:
            call = Call(self, path, self._end.call(path))
        except MalformedFrame as malformed:
            raise self._close(str(malformed)) from None
        self._calls[call.stream] = call
        self._flush()
        return call

    def ask(self, path: str, message: bytes) -> Call:
        """Send a request now. Return its call, with which ``answer`` waits for the response. Raises
        ``WireDown``."""
        call = self.call(path)
        call.send(message, last=True)
        return call

    async def answer(self, call: Call, within_s: float) -> bytes | None:
        """Return the response to a request that ``ask`` has sent; None if it does not come in time.

        Raises:
            CallFailed: The peer has answered with an error.
            WireDown: The connection is lost.
        """
        await self.until(lambda: bool(call.messages) or call.status is not None, within_s)
        if call.messages:
            return call.messages.popleft()
        if call.status is not None:
            raise call.failure()
        return None

    async def unary(self, path: str, message: bytes, within_s: float) -> bytes:
        """Send a request and return its response. If it does not come in time, the call is cancelled.

        Raises:
            CallFailed: The peer has answered with an error.
            WireDown: The connection is lost, or there is no response in time.
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
        """Receive data until ``ready()`` is true. Return False if that takes longer than ``within_s``.

        Raises:
            WireDown: The connection is lost.
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
                    # Another task reads from the connection, and also receives the data for this task.
                    await self._news.wait()
        return ready()

    def take_waiting(self) -> None:
        """Decode the data that has arrived, but at most ``FRAMES`` frames. Never waits. Raises ``WireDown``."""
        self._check()
        remaining = FRAMES
        while remaining > 0:
            data = self._unread_or_waiting()
            if data is None:
                self._budget.caught_up()
                return
            # Data in which no frame begins counts as one frame, so that this loop ends.
            remaining -= max(1, self._take(data, remaining))
        try:
            self._budget.fell_behind()
        except WireDown:
            self._close("it sends more than can be read")
            raise

    def send(self, call: Call, message: bytes, last: bool) -> None:
        """As ``Call.send``."""
        self._check()
        try:
            self._end.send(call.stream, message, last)
        except MalformedFrame as malformed:
            raise self._close(str(malformed)) from None
        self._flush()

    def cancel(self, call: Call) -> None:
        """As ``Call.cancel``."""
        if self._calls.pop(call.stream, None) is not None:
            call.status, call.text = Status.CANCELLED, "by us"
            self._end.reset(call.stream)
            self._flush()

    def close(self) -> None:
        """Reset the connection. Data that has not arrived at the peer is lost. A second call does nothing."""
        self._close("closed by us")

    def close_in_order(self) -> None:
        """Close the connection, but let the sent data still arrive. Use it after a stop."""
        if not self._close_reason:
            self._stream.close_in_order()
        self._close("closed by us")

    async def _read(self) -> bytes:
        data = b""
        try:
            # Closing the stream would not wake this task up, so ``close`` cancels this scope.
            with trio.CancelScope() as self._reader:
                data = await self._stream.read()
        except WireDown as down:
            raise self._close(str(down)) from None
        finally:
            self._reader = None
            # Wake the waiting tasks up, because one of them must read next.
            self._wake()
        self._check()
        return data

    def _unread_or_waiting(self) -> bytes | None:
        if self._end.has_unread:
            return b""
        try:
            return self._stream.read_waiting()
        except WireDown as down:
            raise self._close(str(down)) from None

    def _take(self, data: bytes, frames: int = FRAMES) -> int:
        """Decode at most ``frames`` frames of the received data. Return the number of frames that began in it."""
        try:
            events, begun = self._end.feed_some(data, frames)
        except MalformedFrame as malformed:
            raise self._close(str(malformed)) from None
        close_reason = ""
        for event in events:
            match event:
                case MessageReceived(stream, message) if stream in self._calls:
                    self._calls[stream].messages.append(message)
                case Ended(stream, status, text) if stream in self._calls:
                    call = self._calls.pop(stream)
                    call.status, call.text = status, text
                case PeerLeft(reason):
                    close_reason = reason
        if close_reason:
            raise self._close(close_reason)
        # HTTP/2 itself requires some answers, for example to a ping.
        self._flush()
        self._wake()
        return begun

    def _flush(self) -> None:
        data = self._end.outgoing()
        if data:
            try:
                self._stream.write(data)
            except WireDown as down:
                raise self._close(str(down)) from None

    def _check(self) -> None:
        if self._close_reason:
            raise WireDown(f"{self.name}: the connection is closed ({self._close_reason}). Reconnect")

    def _close(self, reason: str) -> WireDown:
        if not self._close_reason:
            self._close_reason = reason
            if self._reader is not None:
                self._reader.cancel()
            self._stream.close()
            self._wake()
        return WireDown(f"{self.name}: {reason}. Check the robot and its network, then reconnect")

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
    """Connect to a gRPC server, and read its HTTP/2 settings.

    Args:
        host: Name or address of the server.
        port: The server's port.
        within_s: Longest time of the whole connect.
        settle: If False, do not wait for the settings. Use this for a stop, which must also reach a server that
            sends malformed data.
        max_message: Most bytes of one message.
        open_stream: Makes the connection. The default is plain TCP.

    Raises:
        WireDown: The connect failed, or took longer.
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
        raise WireDown(
            f"{name}: no gRPC service answers within {within_s * 1e3:.0f} ms. Check port=, and the robot"
        )
    return connection
