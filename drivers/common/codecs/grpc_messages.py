"""gRPC over HTTP/2, for both ends. Pure: bytes in, events and bytes out; no socket, no clock.

h2 does the HTTP/2. gRPC adds five bytes before each message, and a status in the trailers. Source:
"gRPC over HTTP2" of the gRPC documentation. Messages are never compressed.
"""

from __future__ import annotations

import enum
import sys
from collections.abc import Iterator, Sequence
from typing import NamedTuple
from urllib.parse import quote, unquote

import h2.config
import h2.connection
import h2.errors
import h2.events
import h2.exceptions
import h2.settings

from .malformed import MalformedFrame

MAX_MESSAGE = 1 << 20
"""Most bytes of one message. A longer one ends the connection."""

WINDOW = 1 << 20
"""Bytes that the peer may send on a stream, and on the connection, before they are read."""

_PREFIX = 5
_FRAME_HEAD = 9
_MAX_FRAME = 16_384
"""Longest frame that an end accepts by default."""
_PREFACE = 24
"""Bytes that a client sends before its first frame."""
_SERVER_BACKLOG = 1 << 20
"""Most bytes that wait for a client. A client that reads more slowly loses the connection."""

Header = tuple[str, str]


class Status(enum.IntEnum):
    """The result of a call."""

    OK = 0
    CANCELLED = 1
    UNKNOWN = 2
    INVALID_ARGUMENT = 3
    DEADLINE_EXCEEDED = 4
    NOT_FOUND = 5
    ALREADY_EXISTS = 6
    PERMISSION_DENIED = 7
    RESOURCE_EXHAUSTED = 8
    FAILED_PRECONDITION = 9
    ABORTED = 10
    OUT_OF_RANGE = 11
    UNIMPLEMENTED = 12
    INTERNAL = 13
    UNAVAILABLE = 14
    DATA_LOSS = 15
    UNAUTHENTICATED = 16


class Called(NamedTuple):
    """A client has begun a call."""

    stream: int
    path: str


class Heard(NamedTuple):
    """One message of a call has arrived."""

    stream: int
    message: bytes


class HalfClosed(NamedTuple):
    """The client has sent its last message on this call."""

    stream: int


class Ended(NamedTuple):
    """The call is over. The server has ended it, or one end has given it up."""

    stream: int
    status: Status
    text: str = ""


class Left(NamedTuple):
    """The peer ends the connection."""

    why: str


Event = Called | Heard | HalfClosed | Ended | Left


class MessageDecoder:
    """Find messages in the data of one stream, which comes in any pieces."""

    def __init__(self, max_message: int = MAX_MESSAGE) -> None:
        self._max = max_message
        self._pending = bytearray()  # removes from the front and appends without a copy

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield each complete message. Raise ``MalformedFrame`` for one that is too long or compressed."""
        self._pending += data
        while len(self._pending) >= _PREFIX:
            size = int.from_bytes(self._pending[1:_PREFIX], "big")
            if self._pending[0]:
                raise MalformedFrame("gRPC: a compressed message, and nobody asked for one")
            if size > self._max:
                raise MalformedFrame(f"gRPC: a message of {size} bytes")
            if len(self._pending) < _PREFIX + size:
                return
            message = bytes(self._pending[_PREFIX : _PREFIX + size])
            del self._pending[: _PREFIX + size]
            yield message


def framed(message: bytes) -> bytes:
    """Return a message with gRPC's five bytes before it."""
    return b"\0" + len(message).to_bytes(4, "big") + message


class _FrameSizes:
    """Check the size of each HTTP/2 frame at its beginning, and count the frames.

    h2 itself would wait for the end of a frame that is far too long. It needs up to 0.05 ms for a frame
    without content, and one read may hold hundreds.
    """

    def __init__(self, skip: int) -> None:
        """Start before ``skip`` bytes that are no frame."""
        self._skip = skip
        self._head = b""

    def feed(self, data: bytes, frames: int) -> tuple[int, int]:
        """Measure the beginning of ``data`` that ends within at most ``frames`` frames.

        Returns:
            Its length in bytes, and the number of frames that begin in it.

        Raises:
            MalformedFrame: A frame is too long.
        """
        at = begun = 0
        while at < len(data):
            if not self._skip and not self._head and begun == frames:
                break
            if self._skip:
                step = min(self._skip, len(data) - at)
                self._skip -= step
            else:
                step = min(_FRAME_HEAD - len(self._head), len(data) - at)
                self._head += data[at : at + step]
                if len(self._head) == _FRAME_HEAD:
                    begun += 1
                    self._skip, self._head = int.from_bytes(self._head[:3], "big"), b""
                    if self._skip > _MAX_FRAME:
                        raise MalformedFrame(f"HTTP/2: a frame of {self._skip} bytes")
            at += step
        return at, begun


class _End:
    """The common part of client and server."""

    def __init__(self, client: bool, max_message: int) -> None:
        config = h2.config.H2Configuration(client_side=client, header_encoding="utf-8")
        self._http = h2.connection.H2Connection(config)
        self._max_message = max_message
        self._sizes = _FrameSizes(0 if client else _PREFACE)
        self._unread = b""
        self._decoders: dict[int, MessageDecoder] = {}
        codes = h2.settings.SettingCodes
        self._http.local_settings = h2.settings.Settings(
            client=client,
            initial_values={
                codes.INITIAL_WINDOW_SIZE: WINDOW,
                codes.MAX_HEADER_LIST_SIZE: 1 << 16,
                **({codes.ENABLE_PUSH: 0} if client else {codes.MAX_CONCURRENT_STREAMS: 100}),
            },
        )
        self._http.initiate_connection()
        self._http.increment_flow_control_window(WINDOW - 65_535)
        self.settled = False
        """True once the peer has sent its settings, which shows that it speaks HTTP/2."""

    @property
    def has_unread(self) -> bool:
        """True if ``feed`` has kept bytes for the next call."""
        return bool(self._unread)

    def feed(self, data: bytes) -> list[Event]:
        """Return the events in the received bytes.

        Raises:
            MalformedFrame: Nothing later on this connection can be decoded.
        """
        events, _ = self.feed_some(data, sys.maxsize)
        return events

    def feed_some(self, data: bytes, frames: int) -> tuple[list[Event], int]:
        """As ``feed``, but for at most so many frames. The rest is kept for the next call.

        Returns:
            The events, and the number of frames that were begun.
        """
        unread = self._unread + data
        size, begun = self._sizes.feed(unread, frames)
        read, self._unread = unread[:size], unread[size:]
        try:
            return [told for event in self._http.receive_data(read) for told in self._told(event)], begun
        except h2.exceptions.ProtocolError as error:
            raise MalformedFrame(f"HTTP/2: {error or type(error).__name__}") from None
        except (ValueError, UnicodeError, KeyError, IndexError) as error:
            raise MalformedFrame(f"HTTP/2: {type(error).__name__}") from None

    def outgoing(self) -> bytes:
        """Return the bytes to send now."""
        return self._http.data_to_send()

    def reset(self, stream: int) -> None:
        """Give up a call. Does nothing if it is over."""
        self._forget(stream)
        try:
            self._http.reset_stream(stream, h2.errors.ErrorCodes.CANCEL)
        except h2.exceptions.ProtocolError:
            return

    def _told(self, event: h2.events.Event) -> Iterator[Event]:
        match event:
            case h2.events.RemoteSettingsChanged():
                self.settled = True
            case h2.events.DataReceived(stream_id=stream, data=data, flow_controlled_length=size):
                if size:
                    self._http.acknowledge_received_data(size, stream)
                if stream in self._decoders:
                    for message in self._decoders[stream].feed(data):
                        yield Heard(stream, message)
            case h2.events.StreamReset(stream_id=stream, error_code=code):
                if self._forget(stream):
                    yield Ended(stream, Status.CANCELLED, f"the peer gave it up (HTTP/2 error {int(code)})")
            case h2.events.ConnectionTerminated(error_code=code):
                yield Left(f"HTTP/2 error {int(code)}" if code else "it said goodbye")

    def _begin(self, stream: int) -> None:
        self._decoders[stream] = MessageDecoder(self._max_message)

    def _forget(self, stream: int) -> bool:
        return self._decoders.pop(stream, None) is not None


class ClientEnd(_End):
    """The client's end of one connection."""

    def __init__(self, authority: str, scheme: str = "http", max_message: int = MAX_MESSAGE) -> None:
        super().__init__(True, max_message)
        self._authority = authority
        self._scheme = scheme

    def call(self, path: str, metadata: Sequence[Header] = ()) -> int:
        """Begin a call.

        Args:
            path: ``/package.Service/Method``.
            metadata: More header fields.

        Returns:
            Its stream.

        Raises:
            MalformedFrame: The peer accepts no more calls.
        """
        headers = [
            (":method", "POST"),
            (":scheme", self._scheme),
            (":path", path),
            (":authority", self._authority),
            ("te", "trailers"),
            ("content-type", "application/grpc"),
            ("user-agent", "strands-actors"),
            *metadata,
        ]
        try:
            stream = self._http.get_next_available_stream_id()
            self._http.send_headers(stream, headers)
        except h2.exceptions.ProtocolError as error:
            raise MalformedFrame(f"HTTP/2: {error}") from None
        self._begin(stream)
        return stream

    def send(self, stream: int, message: bytes, last: bool = False) -> None:
        """Send one complete message.

        Args:
            stream: The stream of the call.
            message: The encoded message.
            last: True ends our side of the call.

        Raises:
            MalformedFrame: The peer's window has no room for it, because the peer does not read.
        """
        data = framed(message)
        try:
            room = self._http.local_flow_control_window(stream)
            if len(data) > min(room, self._http.max_outbound_frame_size):
                raise MalformedFrame(f"HTTP/2: the peer has room for {room} bytes, not for {len(data)}")
            self._http.send_data(stream, data, end_stream=last)
        except h2.exceptions.ProtocolError as error:
            raise MalformedFrame(f"HTTP/2: {error}") from None

    def _told(self, event: h2.events.Event) -> Iterator[Event]:
        match event:
            case h2.events.ResponseReceived(stream_id=stream, headers=headers, stream_ended=ended):
                fields = _pairs(headers)
                if fields.get(":status") != "200":
                    yield from self._over(stream, Status.UNAVAILABLE, f"HTTP status {fields.get(':status')}")
                elif ended is not None:
                    yield from self._trailed(stream, fields)
            case h2.events.TrailersReceived(stream_id=stream, headers=headers):
                yield from self._trailed(stream, _pairs(headers))
            case h2.events.StreamEnded(stream_id=stream):
                yield from self._over(stream, Status.UNKNOWN, "it ended without a status")
            case _:
                yield from super()._told(event)

    def _trailed(self, stream: int, fields: dict[str, str]) -> Iterator[Event]:
        number = fields.get("grpc-status", "")
        known = number.isdecimal() and int(number) in tuple(Status)
        status = Status(int(number)) if known else Status.UNKNOWN
        yield from self._over(stream, status, unquote(fields.get("grpc-message", "")))

    def _over(self, stream: int, status: Status, text: str) -> Iterator[Event]:
        if self._forget(stream):
            yield Ended(stream, status, text)


class ServerEnd(_End):
    """The server's end of one connection. Data waits here while the client's window has no room."""

    def __init__(self, max_message: int = MAX_MESSAGE) -> None:
        super().__init__(False, max_message)
        self._answered: set[int] = set()
        self._waiting: dict[int, bytes] = {}
        self._trailers: dict[int, list[Header]] = {}

    def has_room(self, stream: int) -> bool:
        """Return True if the stream is open and no data waits on it."""
        return stream in self._decoders and not self._waiting.get(stream)

    def send(self, stream: int, message: bytes) -> None:
        """Answer with one message. Does nothing if the call is over.

        Raises:
            MalformedFrame: Too much data waits already.
        """
        if stream not in self._decoders:
            return
        self._answer(stream)
        waiting = self._waiting.get(stream, b"") + framed(message)
        if len(waiting) > _SERVER_BACKLOG:
            raise MalformedFrame("HTTP/2: the client does not read")
        self._waiting[stream] = waiting
        self._flush(stream)

    def end(self, stream: int, status: Status = Status.OK, text: str = "") -> None:
        """End a call, after the data that waits on it. Does nothing if it is over."""
        if stream not in self._decoders:
            return
        self._answer(stream)
        details = [("grpc-message", quote(text))] if text else []
        self._trailers[stream] = [("grpc-status", str(int(status))), *details]
        self._flush(stream)

    def reset(self, stream: int) -> None:
        super().reset(stream)
        self._drop(stream)

    def _told(self, event: h2.events.Event) -> Iterator[Event]:
        match event:
            case h2.events.RequestReceived(stream_id=stream, headers=headers):
                self._begin(stream)
                yield Called(stream, _pairs(headers).get(":path", ""))
            case h2.events.StreamEnded(stream_id=stream):
                if stream in self._decoders:
                    yield HalfClosed(stream)
            case h2.events.StreamReset(stream_id=stream):
                self._drop(stream)
                yield from super()._told(event)
            case h2.events.WindowUpdated(stream_id=stream):
                for each in [stream] if stream else list(self._waiting):
                    self._flush(each)
            case _:
                yield from super()._told(event)

    def _answer(self, stream: int) -> None:
        if stream not in self._answered:
            self._answered.add(stream)
            self._http.send_headers(stream, [(":status", "200"), ("content-type", "application/grpc")])

    def _flush(self, stream: int) -> None:
        if stream not in self._decoders:
            return
        waiting = self._waiting.get(stream, b"")
        while waiting:
            room = min(self._http.local_flow_control_window(stream), self._http.max_outbound_frame_size)
            if room <= 0:
                break
            self._http.send_data(stream, waiting[:room])
            waiting = waiting[room:]
        self._waiting[stream] = waiting
        if not waiting and stream in self._trailers:
            self._http.send_headers(stream, self._trailers[stream], end_stream=True)
            self._forget(stream)
            self._drop(stream)

    def _drop(self, stream: int) -> None:
        self._answered.discard(stream)
        self._waiting.pop(stream, None)
        self._trailers.pop(stream, None)


def _pairs(headers: object) -> dict[str, str]:
    """Return header fields by name. The last of several with one name wins."""
    assert isinstance(headers, list)
    return {_text(name): _text(value) for name, value in headers}


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
