"""A WebSocket client for the processes that command or stop a robot: wsproto over ``tcp_port``, with a deadline on
every wait.

One object is one connection. ``send`` hands a message to the operating system at once, or raises. No message is
queued, or repeated on a later connection. Check the permission to send a command immediately before ``send``, which
does not wait. The connection is closed with a reset, which drops all data that has not arrived. The peer may still
process data that it has received.

A stop needs no answer. ``begin_websocket`` sends it together with the upgrade request. ``send_stop`` sends it at
any moment: before the upgrade is answered, and even after malformed data was received. So a connection with
malformed data is kept until it is closed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Sequence

import trio

from strands_actors.contract.wire import WireDown

from ..codecs.malformed import MalformedFrame
from ..codecs.websocket_messages import (
    MAX_MESSAGE,
    Accepted,
    ClientEnd,
    Closed,
    Headers,
    Ponged,
    Received,
    Rejected,
)
from .receive_budget import ReceiveBudget
from .tcp_port import READ_SIZE, OrderlyStream, open_tcp

OpenStream = Callable[[str, int], Awaitable[OrderlyStream]]

BUSY_TURNS = 256
"""Turns in a row that may end with more data waiting. By then a megabyte of normal backlog, after a link was
held up, is read."""


class WebSocket:
    """A WebSocket connection. The upgrade request was sent. One task calls ``receive``; any task may call
    ``send``."""

    def __init__(self, name: str, stream: OrderlyStream, end: ClientEnd, target: str, until_s: float) -> None:
        """Wrap a stream. ``begin_websocket`` and ``open_websocket`` call this.

        Args:
            name: The name of the peer for messages.
            stream: The connection.
            end: The codec.
            target: The path of the upgrade request.
            until_s: Deadline for the answer to the upgrade, in trio's time.
        """
        self.name = name
        self._stream = stream
        self._end = end
        self._target = target
        self._until_s = until_s
        self._budget = ReceiveBudget(name, busy_turns=BUSY_TURNS)
        self._received: deque[Received] = (
            deque()
        )  # messages of the last read; the next read waits until all were handled
        self._is_accepted = self._is_stopped = self._is_closed = False
        self._is_behind = False  # True if more data waited after the last read
        self._pinged = self._ponged = 0
        self._news = trio.Event()
        self._reader: trio.CancelScope | None = None
        self._close_reason = ""  # why nothing more is received; empty while receiving

    @property
    def is_open(self) -> bool:
        """True if messages can be sent and received."""
        return self._is_accepted and not self._close_reason

    @property
    def is_pending(self) -> bool:
        """True if the upgrade was not answered yet, and its deadline has not passed."""
        return not self._is_accepted and not self._close_reason and trio.current_time() < self._until_s

    def send(self, message: str | bytes) -> None:
        """Send a text or binary message now.

        Raises:
            WireDown: The message could not be sent completely. The connection is closed.
            ValueError: The message is too long.
        """
        self._check_open()
        try:
            frame = self._end.message(message)
        except MalformedFrame as malformed:
            raise ValueError(f"{self.name}: {malformed}") from None
        self._write(frame)

    def begin(self, *stop: str) -> None:
        """Send the upgrade request, together with the messages of a stop. Raises ``WireDown``."""
        self._is_stopped = bool(stop)
        self._write(self._end.request + self._end.stop(stop))

    def send_stop(self, *messages: str) -> None:
        """Send a stop now, even if the service has not answered the upgrade.

        Raises:
            WireDown: The connection is closed, or the stop could not be sent completely.
        """
        if self._is_closed:
            raise self._closed_error()
        self._is_stopped = True
        self._write(self._end.stop(messages))

    async def accepted(self, within_s: float) -> bool:
        """Wait for the answer to the upgrade. Return whether it came in time.

        Raises:
            WireDown: The service has refused the upgrade.
        """
        with trio.move_on_after(within_s):
            while not self._is_accepted:
                await self._hear()
        return self._is_accepted

    async def receive(self) -> str | bytes:
        """Wait for the next message, and return it. Pings are answered meanwhile. If the call is cancelled, no
        message is lost.

        Raises:
            WireDown: The connection is closed or lost.
        """
        while True:
            while self._received:
                match self._received.popleft():
                    case str() | bytes() as message:
                        return message
                    case Ponged(payload) if payload.isdigit() and int(payload) <= self._pinged:
                        self._ponged = max(self._ponged, int(payload))
                        self._wake()
                    case Closed(code, reason):
                        raise self._deafen(f"the service closed it: {code} {reason}".rstrip())
            await self._hear()

    async def receive_within(self, within_s: float) -> str | bytes:
        """Return the next message, as ``receive``. If it does not come in time, raise ``WireDown``; the connection
        stays open."""
        with trio.move_on_after(within_s):
            return await self.receive()
        raise WireDown(f"{self.name}: no message within {within_s * 1e3:.0f} ms. Check the service and its network")

    def ping(self) -> int:
        """Send a ping now. Return its number for ``ponged``. Raises ``WireDown``."""
        self._check_open()
        self._pinged += 1
        self._write(self._end.ping(str(self._pinged).encode()))
        return self._pinged

    async def ponged(self, number: int, within_s: float) -> None:
        """Wait until the service has answered a ping. Then it has read everything that was sent before the ping.
        Another task must call ``receive`` meanwhile.

        Raises:
            WireDown: The answer did not come in time.
        """
        with trio.move_on_after(within_s):
            while self._ponged < number:
                self._check()
                await self._news.wait()
            return
        raise WireDown(f"{self.name}: no pong within {within_s * 1e3:.0f} ms. Check the service and its network")

    def close(self) -> None:
        """Reset the connection, and drop all data that has not arrived. A second call does nothing.

        If a stop was sent on a connection with malformed data, the stop still arrives.
        """
        self._close("closed by us", in_order=self._is_stopped and not self.is_open)

    def close_in_order(self) -> None:
        """Send a close frame and close the connection, but let the sent data still arrive. Use it after a stop."""
        if self.is_open:
            try:
                self._stream.write(self._end.close())
            except WireDown as down:
                self._close(str(down))
        self._close("closed by us", in_order=True)

    async def _hear(self) -> None:
        """Receive data once, and decode a bounded number of frames. Raise ``WireDown``."""
        data = b""
        if self._end.has_unread:
            await trio.lowlevel.checkpoint()
            self._check()
        else:
            data = await self._read()
            self._is_behind = len(data) == READ_SIZE
        try:
            self._received.extend(self._end.feed(data))
        except MalformedFrame as malformed:
            raise self._deafen(str(malformed)) from None
        self._keep_up(self._end.has_unread or self._is_behind)
        if replies := self._end.replies():
            self._write(replies)
        if not self._is_accepted and self._received:
            match self._received.popleft():
                case Accepted():
                    self._is_accepted = True
                case Rejected(status):
                    raise self._deafen(f"it answers status {status}")
                case _:
                    raise self._deafen("it answers something else")

    def _keep_up(self, has_more: bool) -> None:
        """Note whether this turn of the receiving loop left data unread (``has_more``). Raise ``WireDown`` after
        too many such turns in a row."""
        try:
            if has_more:
                self._budget.fell_behind()
            else:
                self._budget.caught_up()
        except WireDown:
            self._deafen("it sends more than can be read")
            raise

    async def _read(self) -> bytes:
        self._check()
        data = b""
        try:
            # Closing the stream would not wake this task up, so ``close`` cancels this scope.
            with trio.CancelScope() as self._reader:
                data = await self._stream.read()
        except WireDown as down:
            raise self._close(str(down)) from None
        finally:
            self._reader = None
        self._check()
        return data

    def _write(self, data: bytes) -> None:
        try:
            self._stream.write(data)
        except WireDown as down:
            raise self._close(str(down)) from None

    def _check(self) -> None:
        if self._close_reason:
            raise self._closed_error()

    def _check_open(self) -> None:
        self._check()
        if not self._is_accepted:
            raise WireDown(f"{self.name}: {self._target}: the service has not answered the upgrade yet")

    def _deafen(self, reason: str) -> WireDown:
        """Stop receiving, although a stop can still be sent. Return the error to raise."""
        if not self._close_reason:
            self._close_reason = reason if self._is_accepted else f"{self._target}: no WebSocket there ({reason})"
            self._received.clear()
            self._wake()
        return WireDown(f"{self.name}: {self._close_reason}. Check the service and its network, then reconnect")

    def _close(self, reason: str, in_order: bool = False) -> WireDown:
        """Close the connection. Return the error to raise."""
        error = self._deafen(reason)
        if not self._is_closed:
            self._is_closed = True
            if self._reader is not None:
                self._reader.cancel()
            if in_order:
                self._stream.close_in_order()
            else:
                self._stream.close()
        return error

    def _closed_error(self) -> WireDown:
        return WireDown(f"{self.name}: the WebSocket is closed ({self._close_reason}). Reconnect")

    def _wake(self) -> None:
        news, self._news = self._news, trio.Event()
        news.set()


async def begin_websocket(
    host: str,
    port: int,
    target: str = "/",
    *,
    within_s: float,
    stop: Sequence[str] = (),
    headers: Headers = (),
    max_message: int = MAX_MESSAGE,
    open_stream: OpenStream = open_tcp,
) -> WebSocket:
    """Connect, and send the upgrade request and the messages of ``stop`` in one write.

    The answer to the upgrade is not awaited (see ``WebSocket.accepted``). Some services, such as uvicorn, drop
    messages that arrive before their answer. So send the stop again after the answer.

    Args:
        host: Name or address of the service.
        port: The service's port.
        target: The path of the upgrade request.
        within_s: Longest time of the whole connect.
        stop: Messages to send with the upgrade request.
        headers: More header fields.
        max_message: Most bytes of one message.
        open_stream: Makes the connection. The default is plain TCP.

    Raises:
        WireDown: The connect failed, or took longer.
    """
    name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    end = ClientEnd(name, target, headers, max_message)
    until_s = trio.current_time() + within_s
    with trio.move_on_after(within_s):
        begun = WebSocket(name, await open_stream(host, port), end, target, until_s)
        begun.begin(*stop)
        return begun
    raise _no_websocket(name, target, within_s)


async def open_websocket(
    host: str,
    port: int,
    target: str = "/",
    *,
    within_s: float,
    headers: Headers = (),
    max_message: int = MAX_MESSAGE,
    open_stream: OpenStream = open_tcp,
) -> WebSocket:
    """Connect, and wait until the upgrade is accepted. The arguments are those of ``begin_websocket``.

    Raises:
        WireDown: It failed, or took longer than ``within_s``.
    """
    until_s = trio.current_time() + within_s
    opened = await begin_websocket(
        host,
        port,
        target,
        within_s=within_s,
        headers=headers,
        max_message=max_message,
        open_stream=open_stream,
    )
    try:
        if await opened.accepted(until_s - trio.current_time()):
            return opened
    except BaseException:
        opened.close()
        raise
    opened.close()
    raise _no_websocket(opened.name, target, within_s)


def _no_websocket(name: str, target: str, within_s: float) -> WireDown:
    return WireDown(f"{name}: {target}: no WebSocket within {within_s * 1e3:.0f} ms. Check the service")
