"""A WebSocket client for a wire process or a stop channel: wsproto over ``tcp_port``, with a deadline on
every wait.

One object is one connection. ``send`` hands a message to the system at once or raises. No message waits to
be sent, or is sent again on a later connection. Check a permit immediately before ``send``, which does not
wait. A connection is closed with a reset, which throws away all data that has not arrived. The peer may still
process data in its own buffer.

A stop needs no answer. ``begin_websocket`` sends it in one write with the upgrade. ``send_stop`` sends it at
any moment, even before the upgrade is answered and after bytes that were no WebSocket. So a connection that
cannot be decoded any more is kept until it is closed.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Awaitable, Callable, Sequence

import trio

from strands_actors.contract.wire import WireDown

from ..codecs.malformed import MalformedFrame
from ..codecs.websocket_messages import MAX_MESSAGE, Accepted, ClientEnd, Closed, Headers, Heard, Ponged, Rejected
from .receive_budget import ReceiveBudget
from .tcp_port import READ_SIZE, OrderlyStream, open_tcp

OpenStream = Callable[[str, int], Awaitable[OrderlyStream]]

BUSY_TURNS = 256
"""Turns in a row that may end with more data waiting. By then a megabyte of normal backlog, after a link was
held up, is read."""


class WebSocket:
    """A connection with its upgrade sent. One task calls ``receive``; any task may call ``send``."""

    def __init__(self, name: str, stream: OrderlyStream, end: ClientEnd, target: str, until_s: float) -> None:
        """Wrap a stream. ``begin_websocket`` and ``open_websocket`` call this.

        Args:
            name: The name of the peer for messages.
            stream: The connection.
            end: The codec.
            target: The path of the upgrade.
            until_s: Deadline of the answer to the upgrade, in trio's time.
        """
        self.name = name
        self._stream = stream
        self._end = end
        self._target = target
        self._until_s = until_s
        self._budget = ReceiveBudget(name, busy_turns=BUSY_TURNS)
        self._heard: deque[Heard] = deque()  # of the last read; the next read waits until it is empty
        self._is_accepted = self._is_stopped = self._is_closed = False
        self._is_behind = False  # the last read left more data waiting
        self._pinged = self._ponged = 0
        self._news = trio.Event()
        self._reader: trio.CancelScope | None = None
        self._why = ""  # why nothing is received any more

    @property
    def is_open(self) -> bool:
        """True if messages can be sent and received."""
        return self._is_accepted and not self._why

    @property
    def is_pending(self) -> bool:
        """True if the upgrade may still be answered in time."""
        return not self._is_accepted and not self._why and trio.current_time() < self._until_s

    def send(self, message: str | bytes) -> None:
        """Send a text or binary message now.

        Raises:
            WireDown: It did not leave whole. The connection is closed.
            ValueError: It is too long.
        """
        self._check_open()
        try:
            frame = self._end.message(message)
        except MalformedFrame as malformed:
            raise ValueError(f"{self.name}: {malformed}") from None
        self._write(frame)

    def begin(self, *stop: str) -> None:
        """Send the upgrade, together with the messages of a stop. Raises ``WireDown``."""
        self._is_stopped = bool(stop)
        self._write(self._end.request + self._end.stop(stop))

    def send_stop(self, *messages: str) -> None:
        """Send a stop now, with or without any answer of the service.

        Raises:
            WireDown: The connection is closed, or the stop did not leave whole.
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
        """Return the next message, and answer pings meanwhile. No message is lost if it is cancelled.

        Raises:
            WireDown: The connection is closed or lost.
        """
        while True:
            while self._heard:
                match self._heard.popleft():
                    case str() | bytes() as message:
                        return message
                    case Ponged(payload) if payload.isdigit() and int(payload) <= self._pinged:
                        self._ponged = max(self._ponged, int(payload))
                        self._wake()
                    case Closed(code, reason):
                        raise self._deafen(f"the service closed it: {code} {reason}".rstrip())
            await self._hear()

    async def receive_within(self, within_s: float) -> str | bytes:
        """As ``receive``. Raise ``WireDown`` if no message comes in time; the connection stays open."""
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
        """Return when the service has answered a ping, and so has read everything that was sent before.
        Another task has to receive meanwhile.

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
        """Reset the connection and throw away all data that has not arrived. Another call does nothing.

        A stop still arrives if it was sent on a connection that could not be decoded.
        """
        self._close("closed by us", in_order=self._is_stopped and not self.is_open)

    def close_in_order(self) -> None:
        """As ``close``, but sent data still arrives, followed by a close frame. Meant for a stop."""
        if self.is_open:
            try:
                self._stream.write(self._end.close())
            except WireDown as down:
                self._close(str(down))
        self._close("closed by us", in_order=True)

    async def _hear(self) -> None:
        """Receive once, as much as one turn may take. Raise ``WireDown``."""
        data = b""
        if self._end.has_unread:
            await trio.lowlevel.checkpoint()
            self._check()
        else:
            data = await self._read()
            self._is_behind = len(data) == READ_SIZE
        try:
            self._heard.extend(self._end.feed(data))
        except MalformedFrame as malformed:
            raise self._deafen(str(malformed)) from None
        self._keep_up(self._end.has_unread or self._is_behind)
        if replies := self._end.replies():
            self._write(replies)
        if not self._is_accepted and self._heard:
            match self._heard.popleft():
                case Accepted():
                    self._is_accepted = True
                case Rejected(status):
                    raise self._deafen(f"it answers status {status}")
                case _:
                    raise self._deafen("it answers something else")

    def _keep_up(self, has_more: bool) -> None:
        """Raise ``WireDown`` if the service has sent more than can be read, for many turns."""
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
            with trio.CancelScope() as self._reader:  # ``close`` cancels it; nothing else ends the wait.
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
        if self._why:
            raise self._closed_error()

    def _check_open(self) -> None:
        self._check()
        if not self._is_accepted:
            raise WireDown(f"{self.name}: {self._target}: the upgrade is not answered yet")

    def _deafen(self, why: str) -> WireDown:
        """End receiving. A stop can still be sent. Return the error to raise."""
        if not self._why:
            self._why = why if self._is_accepted else f"{self._target}: no WebSocket there ({why})"
            self._heard.clear()
            self._wake()
        return WireDown(f"{self.name}: {self._why}. Check the service and its network, then reconnect")

    def _close(self, why: str, in_order: bool = False) -> WireDown:
        """Close the connection. Return the error to raise."""
        error = self._deafen(why)
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
        return WireDown(f"{self.name}: the WebSocket is closed ({self._why}). Reconnect")

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
    """Connect, and send the upgrade and the messages of ``stop`` in one write.

    The answer is not awaited (``WebSocket.accepted``). Services may drop a message that comes before
    their answer, as uvicorn does, so send it again.

    Args:
        host: Name or address of the service.
        port: Its port.
        target: The path of the upgrade.
        within_s: Time for everything.
        stop: Messages to send with the upgrade.
        headers: More header fields.
        max_message: Most bytes of one message.
        open_stream: Makes the connection. The default is plain TCP.

    Raises:
        WireDown: It failed, or took longer.
    """
    name = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    end = ClientEnd(name, target, headers, max_message)
    until_s = trio.current_time() + within_s
    with trio.move_on_after(within_s):
        begun = WebSocket(name, await open_stream(host, port), end, target, until_s)
        begun.begin(*stop)
        return begun
    raise _not_there(name, target, within_s)


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
    """Connect and upgrade. The arguments are those of ``begin_websocket``.

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
    raise _not_there(opened.name, target, within_s)


def _not_there(name: str, target: str, within_s: float) -> WireDown:
    return WireDown(f"{name}: {target}: no WebSocket within {within_s * 1e3:.0f} ms. Check the service")
