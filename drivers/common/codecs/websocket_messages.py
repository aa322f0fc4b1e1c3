"""Encode and decode WebSocket frames, as client and as server, over wsproto. Pure: no socket, no clock.

No extension is offered or accepted, so nothing is compressed. Messages are bounded in bytes and in fragments, and
each call of ``feed`` decodes a bounded number of frames. After malformed bytes neither side decodes anything more,
but a client can still encode a stop command.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import islice
from typing import NamedTuple

from wsproto import ConnectionType, WSConnection
from wsproto.connection import ConnectionState
from wsproto.events import (
    AcceptConnection,
    BytesMessage,
    CloseConnection,
    Event,
    Ping,
    Pong,
    RejectConnection,
    Request,
    TextMessage,
)
from wsproto.frame_protocol import FrameProtocol
from wsproto.utilities import ProtocolError

from .malformed import MalformedFrame

MAX_MESSAGE = 1 << 20
"""Most bytes of a message, or characters of a text. A lidar scan as JSON is 20 kB."""

MAX_FRAGMENTS = 1024
"""Most frames of one message."""

FRAMES = 32
"""Most frames that one turn takes in: 1 ms at most."""

MAX_CONTROL = 125
"""Most bytes of a ping, by RFC 6455."""

MAX_HEAD = 16_384
"""Most bytes of an upgrade."""

MAX_EARLY = 65_536
"""Most bytes that a client may send before its upgrade is answered."""

_HEAD_END = b"\r\n\r\n"

NORMAL_CLOSURE = 1000

Headers = Sequence[tuple[bytes, bytes]]


class Accepted(NamedTuple):
    """Event at the client: the server has accepted the upgrade to WebSocket. Messages may be sent."""


class Rejected(NamedTuple):
    """Event at the client: the server has refused the upgrade to WebSocket, with this HTTP status."""

    status: int


class Opened(NamedTuple):
    """Event at the server: a client requests the upgrade to WebSocket. Reply with ``accept`` or ``reject``.

    Header names are in lower case.
    """

    target: str
    headers: dict[str, str]


class Ponged(NamedTuple):
    """Event: the peer has answered a ping, so it has read everything that was sent before the ping."""

    payload: bytes


class Closed(NamedTuple):
    """Event: the peer has closed the connection. No event follows."""

    code: int
    reason: str


Received = str | bytes | Accepted | Rejected | Opened | Ponged | Closed


class _End:
    _answers_close = True

    def __init__(self, connection_type: ConnectionType, max_message: int) -> None:
        self._connection = WSConnection(connection_type)
        self._max_message = max_message
        self._parts: list[str] | list[bytes] = []
        self._length = self._fragments = 0
        self._ping: Ping | None = None  # the newest received ping that was not answered yet
        self._close = b""
        self._ended = False
        self._has_unread = False

    @property
    def has_unread(self) -> bool:
        """True if ``feed`` has kept received data that its next call will decode."""
        return self._has_unread

    def feed(self, data: bytes, frames: int = FRAMES) -> Iterator[Received]:
        """Decode received bytes, and yield the events in them. Afterwards send the bytes of ``replies``.

        If ``has_unread`` is True afterwards, call again with empty ``data`` to decode more.

        Args:
            data: Received bytes.
            frames: Most frames that this call decodes.

        Raises:
            MalformedFrame: The bytes are malformed. Nothing that follows on this connection can be decoded.
        """
        if self._ended:
            raise MalformedFrame("bytes after the end")
        count = 0
        try:
            if data:
                self._connection.receive_data(data)
            for event in islice(self._connection.events(), frames):
                count += 1
                received = self._take(event)
                if received is not None:
                    yield received
            self._has_unread = count == frames and not self._ended
        except MalformedFrame:
            self._ended = True
            raise
        # ValueError is raised for a header that is not ASCII text.
        except (ProtocolError, ValueError) as error:
            self._ended = True
            raise MalformedFrame(str(error) or type(error).__name__) from None

    def replies(self) -> bytes:
        """Return the bytes that answer the newest ping and a close frame, if they arrived since the last call.

        RFC 6455 requires no answer to earlier pings.
        """
        ping, close, self._ping, self._close = self._ping, self._close, None, b""
        if ping is None or self._connection.state is not ConnectionState.OPEN:
            return close
        return self._send(ping.response()) + close

    def message(self, message: str | bytes) -> bytes:
        """Return the frame of a text or binary message. Raise ``MalformedFrame`` if it is too long or the
        connection is not open."""
        if len(message) > self._max_message:
            raise MalformedFrame(f"message of {len(message)}, more than {self._max_message}")
        return self._send(TextMessage(data=message) if isinstance(message, str) else BytesMessage(data=message))

    def ping(self, payload: bytes) -> bytes:
        """Return the frame of a ping. Raise ``MalformedFrame`` if it is too long or the connection is not open."""
        if len(payload) > MAX_CONTROL:
            raise MalformedFrame(f"ping of {len(payload)} bytes, more than {MAX_CONTROL}")
        return self._send(Ping(payload=payload))

    def close(self, code: int = NORMAL_CLOSURE) -> bytes:
        """Return a close frame; empty if the connection is not open or is already closed."""
        if self._connection.state not in (ConnectionState.OPEN, ConnectionState.REMOTE_CLOSING):
            return b""
        return self._send(CloseConnection(code=code))

    def _send(self, event: Event) -> bytes:
        try:
            return bytes(self._connection.send(event))
        except ProtocolError as error:
            raise MalformedFrame(f"not open: {error}") from None

    def _take(self, event: Event) -> Received | None:
        match event:
            case TextMessage() | BytesMessage():
                return self._message(event)
            case Ping():
                self._ping = event
                return None
            case Pong():
                return Ponged(bytes(event.payload))
            case CloseConnection():
                # wsproto reports a frame that it cannot parse as a CloseConnection in the state OPEN.
                if self._connection.state is ConnectionState.OPEN:
                    raise MalformedFrame(event.reason or "no WebSocket frame")
                if self._answers_close and self._connection.state is ConnectionState.REMOTE_CLOSING:
                    self._close = self._send(event.response())
                self._ended = True
                return Closed(int(event.code), event.reason or "")
            case AcceptConnection():
                return Accepted()
            case RejectConnection():
                self._ended = True
                return Rejected(event.status_code)
            case Request():
                names = ((name.decode("ascii"), value.decode("latin-1")) for name, value in event.extra_headers)
                return Opened(event.target, dict(names))
            case _:
                return None

    def _message(self, event: TextMessage | BytesMessage) -> str | bytes | None:
        self._length += len(event.data)
        self._fragments += event.frame_finished
        if self._fragments > MAX_FRAGMENTS:
            raise MalformedFrame(f"message of more than {MAX_FRAGMENTS} fragments")
        if self._length > self._max_message:
            raise MalformedFrame(f"message of more than {self._max_message}")
        part = event.data if isinstance(event.data, str) else bytes(event.data)
        if part:
            self._parts.append(part)  # type: ignore[arg-type]  # wsproto keeps the kinds apart
        if not event.message_finished:
            return None
        empty: str | bytes = "" if isinstance(part, str) else b""
        whole = empty.join(self._parts)  # type: ignore[arg-type]
        self._parts, self._length, self._fragments = [], 0, 0
        return whole


class ClientEnd(_End):
    """The client side of a WebSocket. ``request`` holds the bytes of the upgrade request.

    It does not answer a close frame: a single damaged byte may look like one, and after the answer the service
    would ignore a stop command. Instead, the service notices when the TCP connection ends.
    """

    _answers_close = False

    def __init__(self, host: str, target: str, headers: Headers = (), max_message: int = MAX_MESSAGE) -> None:
        """Encode the upgrade request. ``host`` includes the port, as in the ``Host`` header."""
        super().__init__(ConnectionType.CLIENT, max_message)
        self.request = self._send(Request(host=host, target=target, extra_headers=list(headers)))
        self._stops = FrameProtocol(client=True, extensions=[])

    def stop(self, messages: Sequence[str]) -> bytes:
        """Return the WebSocket frames of ``messages``, which are a stop command for the robot.

        They depend on no received data, so they can be sent before the upgrade is answered, and after malformed
        bytes.
        """
        return b"".join(bytes(self._stops.send_data(message, fin=True)) for message in messages)


class ServerEnd(_End):
    """The server side of a WebSocket. Its first event is ``Opened``."""

    def __init__(self, max_message: int = MAX_MESSAGE, keeps_early: bool = True) -> None:
        """Prepare the server side of one connection.

        Args:
            max_message: Most bytes of one message.
            keeps_early: True if the server keeps frames that arrive together with the upgrade request. tornado
                (rosbridge) keeps them, uvicorn drops them.
        """
        super().__init__(ConnectionType.SERVER, max_message)
        self._head = b""  # the bytes of the upgrade request, until it is complete
        self._early: bytes | None = b""  # frames that arrived before ``accept`` was called; None from then on
        self._keeps_early = keeps_early

    def feed(self, data: bytes, frames: int = FRAMES) -> Iterator[Received]:
        if self._early is None:
            yield from super().feed(data, frames)
        elif _HEAD_END in self._head:
            self._early += data
            if len(self._early) > MAX_EARLY:
                raise MalformedFrame(f"more than {MAX_EARLY} bytes before the answer to the upgrade")
        else:
            self._head += data
            head, end, early = self._head.partition(_HEAD_END)
            if len(head) > MAX_HEAD:
                raise MalformedFrame(f"head of more than {MAX_HEAD} bytes")
            if end:
                self._early = early if self._keeps_early else b""
                yield from super().feed(head + end, frames)

    def accept(self) -> bytes:
        """Return the response that accepts the upgrade.

        Call ``feed`` once with empty bytes afterwards, because messages may have arrived before the upgrade was
        accepted.
        """
        answer = self._send(AcceptConnection())
        if self._early:
            self._connection.receive_data(self._early)
            self._has_unread = True
        self._early = None
        return answer

    def reject(self, status: int) -> bytes:
        """Return the response that refuses the upgrade."""
        self._ended = True
        return self._send(RejectConnection(status_code=status))
