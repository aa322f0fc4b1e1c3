"""One end of a WebSocket, bytes in and bytes out, over wsproto. Pure: no socket, no clock.

No extension is offered or accepted, so nothing is compressed. Messages are bounded in bytes and in
fragments, and each turn takes in a bounded amount. After malformed bytes an end decodes nothing more, but a
client can still make a stop.
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
    """The server has accepted the upgrade. Messages may be sent."""


class Rejected(NamedTuple):
    """The server has answered the upgrade with an HTTP status instead."""

    status: int


class Opened(NamedTuple):
    """A client asks for an upgrade. Answer with ``accept`` or ``reject``. Header names are in lower case."""

    target: str
    headers: dict[str, str]


class Ponged(NamedTuple):
    """The peer has answered a ping, so it has read everything that was sent before the ping."""

    payload: bytes


class Closed(NamedTuple):
    """The peer has closed the connection. Nothing follows."""

    code: int
    reason: str


Heard = str | bytes | Accepted | Rejected | Opened | Ponged | Closed


class _End:
    _answers_close = True

    def __init__(self, kind: ConnectionType, max_message: int) -> None:
        self._connection = WSConnection(kind)
        self._max_message = max_message
        self._parts: list[str] | list[bytes] = []
        self._length = self._fragments = 0
        self._ping: Ping | None = None  # the newest one without an answer
        self._close = b""
        self._ended = False
        self._has_unread = False

    @property
    def has_unread(self) -> bool:
        """True if ``feed`` has left data for the next turn."""
        return self._has_unread

    def feed(self, data: bytes, frames: int = FRAMES) -> Iterator[Heard]:
        """Yield the received events, as much as one turn may take. Afterwards send ``replies``.

        Args:
            data: Received bytes. While ``has_unread``, feed empty bytes.
            frames: Most frames of this turn.

        Raises:
            MalformedFrame: Nothing later on this connection can be decoded.
        """
        if self._ended:
            raise MalformedFrame("bytes after the end")
        count = 0
        try:
            if data:
                self._connection.receive_data(data)
            for event in islice(self._connection.events(), frames):
                count += 1
                heard = self._take(event)
                if heard is not None:
                    yield heard
            self._has_unread = count == frames and not self._ended
        except MalformedFrame:
            self._ended = True
            raise
        except (ProtocolError, ValueError) as error:  # ValueError comes from a header that is no text.
            self._ended = True
            raise MalformedFrame(str(error) or type(error).__name__) from None

    def replies(self) -> bytes:
        """Return the answers to the newest ping and to a close since the last call. RFC 6455 requires no
        answer to earlier pings."""
        ping, close, self._ping, self._close = self._ping, self._close, None, b""
        if ping is None or self._connection.state is not ConnectionState.OPEN:
            return close
        return self._send(ping.response()) + close

    def message(self, message: str | bytes) -> bytes:
        """Return the frame of a text or binary message. Raise ``MalformedFrame`` if it cannot be sent
        now."""
        if len(message) > self._max_message:
            raise MalformedFrame(f"message of {len(message)}, more than {self._max_message}")
        return self._send(TextMessage(data=message) if isinstance(message, str) else BytesMessage(data=message))

    def ping(self, payload: bytes) -> bytes:
        """Return the frame of a ping. Raise ``MalformedFrame`` if it cannot be sent now."""
        if len(payload) > MAX_CONTROL:
            raise MalformedFrame(f"ping of {len(payload)} bytes, more than {MAX_CONTROL}")
        return self._send(Ping(payload=payload))

    def close(self, code: int = NORMAL_CLOSURE) -> bytes:
        """Return the frame of a close; empty if there is nothing to close."""
        if self._connection.state not in (ConnectionState.OPEN, ConnectionState.REMOTE_CLOSING):
            return b""
        return self._send(CloseConnection(code=code))

    def _send(self, event: Event) -> bytes:
        try:
            return bytes(self._connection.send(event))
        except ProtocolError as error:
            raise MalformedFrame(f"not open: {error}") from None

    def _take(self, event: Event) -> Heard | None:
        match event:
            case TextMessage() | BytesMessage():
                return self._message(event)
            case Ping():
                self._ping = event
                return None
            case Pong():
                return Ponged(bytes(event.payload))
            case CloseConnection():
                if self._connection.state is ConnectionState.OPEN:  # wsproto reports a parse error like this.
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
    """The client's end. ``request`` is the upgrade to send.

    It does not answer a close. A single garbled byte may look like a close, and no stop would count after
    the answer. The service sees the end of the connection instead.
    """

    _answers_close = False

    def __init__(self, host: str, target: str, headers: Headers = (), max_message: int = MAX_MESSAGE) -> None:
        """Make the upgrade. ``host`` includes the port, as in the ``Host`` header."""
        super().__init__(ConnectionType.CLIENT, max_message)
        self.request = self._send(Request(host=host, target=target, extra_headers=list(headers)))
        self._stops = FrameProtocol(client=True, extensions=[])

    def stop(self, messages: Sequence[str]) -> bytes:
        """Return the frames of a stop. They depend on no received data, so they can be sent before the
        answer to the upgrade, and after malformed bytes."""
        return b"".join(bytes(self._stops.send_data(message, fin=True)) for message in messages)


class ServerEnd(_End):
    """The server's end. Its first event is ``Opened``."""

    def __init__(self, max_message: int = MAX_MESSAGE, keeps_early: bool = True) -> None:
        """Make an end.

        Args:
            max_message: Most bytes of one message.
            keeps_early: True if the server keeps frames that arrive together with the upgrade request. tornado
                (rosbridge) keeps them, uvicorn drops them.
        """
        super().__init__(ConnectionType.SERVER, max_message)
        self._head = b""  # the upgrade, until it is complete
        self._early: bytes | None = b""  # frames from before ``accept``; None after it
        self._keeps_early = keeps_early

    def feed(self, data: bytes, frames: int = FRAMES) -> Iterator[Heard]:
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
        """Return the answer that accepts the upgrade. Feed empty bytes once afterwards, since messages may
        have come before it."""
        answer = self._send(AcceptConnection())
        if self._early:
            self._connection.receive_data(self._early)
            self._has_unread = True
        self._early = None
        return answer

    def reject(self, status: int) -> bytes:
        """Return the answer that refuses the upgrade."""
        self._ended = True
        return self._send(RejectConnection(status_code=status))
