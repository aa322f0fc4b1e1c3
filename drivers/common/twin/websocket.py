"""The WebSocket server of a simulated robot. It uses a port alone, or shares the port with an HTTP
service."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Awaitable, Callable

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.codecs.websocket_messages import (
    MAX_HEAD,
    MAX_MESSAGE,
    Closed,
    Opened,
    Received,
    ServerEnd,
)

from .line import Channel
from .server import Conversation, TwinSession
from .tcp import ClientGone, Connection, Handler

NOT_FOUND = 404

_HEAD_END = b"\r\n\r\n"


class WebSocketClient:
    """A client after its upgrade to WebSocket was accepted."""

    def __init__(self, connection: Connection, end: ServerEnd, opened: Opened) -> None:
        self._end = end
        self._received: deque[Received] = deque()
        self._read_ns = time.monotonic_ns()
        self.connection = connection
        self.target = opened.target
        self.headers = opened.headers

    async def receive(self) -> tuple[int, str | bytes]:
        """Wait for the next message. Return the time at which it was read, and the message. Pings are answered
        meanwhile. Raise ``ClientGone``."""
        while True:
            while self._received:
                match self._received.popleft():
                    case str() | bytes() as message:
                        return self._read_ns, message
                    case Closed():
                        raise ClientGone
            data = b""
            if not self._end.has_unread:
                self._read_ns, data = await self.connection.receive()
            await self.connection.frost.thawed()
            try:
                self._received.extend(self._end.feed(data))
            except MalformedFrame:
                # A real server also disconnects a client that sends a malformed frame.
                raise ClientGone from None
            if replies := self._end.replies():
                self.connection.send(replies)

    def log_received(self, t_ns: int, kind: str, message: str | bytes, safe_state: str | None = None) -> None:
        """Log a message that the client has sent, without its WebSocket frame."""
        self.connection.log.write(t_ns, "host", [(kind, _bytes(message))], safe_state)

    def send_logged(self, kind: str, message: str | bytes) -> None:
        """Send a message of the robot, and log it. Raise ``ClientGone`` after the end of the connection."""
        self.connection.log.write(time.monotonic_ns(), "robot", [(kind, _bytes(message))])
        self.send(message)

    def send(self, message: str | bytes) -> None:
        """Send a message without logging it. Use it for messages that are sent many times a second. Raise
        ``ClientGone``."""
        try:
            frame = self._end.message(message)
        except MalformedFrame:
            raise ClientGone from None
        self.connection.send(frame)


WebSocketHandler = Callable[[WebSocketClient], Awaitable[None]]
"""Serves one client until ``ClientGone``, which it does not catch."""

Choose = Callable[[str], WebSocketHandler | None]
"""Returns the handler for the path of an upgrade (without the query); None if there is no handler."""


def serving_websocket(choose: Choose, max_message: int = MAX_MESSAGE) -> Handler:
    """Return a handler for a port with WebSockets only. Frames that arrive together with the upgrade request are
    accepted, as the server tornado does."""

    async def handle(connection: Connection) -> None:
        await _serve(connection, b"", choose, ServerEnd(max_message))

    return handle


def serving_both(new_session: Callable[[], TwinSession], choose: Choose, max_message: int = MAX_MESSAGE) -> Handler:
    """Return a handler for a port with an HTTP service and WebSockets.

    The first request of a connection decides between HTTP and WebSocket. Frames that arrive together with the
    upgrade request are dropped, as the server uvicorn does.

    Args:
        new_session: Makes the session of an HTTP client.
        choose: Returns the handler of a WebSocket, by the path of its upgrade request.
        max_message: Largest message in bytes.
    """

    async def handle(connection: Connection) -> None:
        first, t_ns = b"", 0
        while _HEAD_END not in first and len(first) <= MAX_HEAD:
            t_ns, data = await connection.receive()
            first += data
        head = first.partition(_HEAD_END)[0].lower()
        if b"\r\nupgrade: websocket" in head:
            await _serve(connection, first, choose, ServerEnd(max_message, keeps_early=False))
        else:
            begun = _Begun(connection, t_ns, first)
            await Conversation(new_session(), begun, connection.log, connection.frost).serve()

    return handle


async def _serve(connection: Connection, data: bytes, choose: Choose, end: ServerEnd) -> None:
    while True:
        try:
            events = list(end.feed(data)) if data else []
        except MalformedFrame:
            raise ClientGone from None
        match events:
            case [Opened() as opened]:
                break
            case []:
                _, data = await connection.receive()
            case _:
                raise ClientGone
    handler = choose(opened.target.partition("?")[0])
    if handler is None:
        connection.send(end.reject(NOT_FOUND))
        # Wait until the client has read the refusal and closes the connection.
        while True:
            await connection.receive()
    connection.send(end.accept())
    await handler(WebSocketClient(connection, end, opened))


class _Begun(Channel):
    """A connection from which the first bytes were already read. ``receive`` returns them first."""

    def __init__(self, connection: Connection, t_ns: int, first: bytes) -> None:
        self._connection = connection
        self._first: tuple[int, bytes] | None = (t_ns, first)

    def bits_per_s(self) -> int | None:
        return self._connection.bits_per_s()

    def quiet_for(self, seconds: float) -> bool:
        return self._connection.quiet_for(seconds)

    async def receive(self) -> tuple[int, bytes]:
        first, self._first = self._first, None
        return first if first is not None else await self._connection.receive()

    def send(self, data: bytes) -> None:
        self._connection.send(data)


def _bytes(message: str | bytes) -> bytes:
    return message.encode() if isinstance(message, str) else message
