"""Encode and decode gRPC over HTTP/2, as client and as server.

Pure: bytes in, events and bytes out; no socket, no clock. The library h2 handles HTTP/2. gRPC adds five bytes
before each message, and a status in the trailers. Source: "gRPC over HTTP2" of the gRPC documentation. Messages are
never compressed.
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
    """The status code with which a gRPC call ends."""

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
    """Event at the server: a client has begun a gRPC call."""

    stream: int
    path: str


class MessageReceived(NamedTuple):
    """Event: one message of a gRPC call has arrived."""

    stream: int
    message: bytes


class HalfClosed(NamedTuple):
    """Event at the server: the client has sent its last message on this call."""

    stream: int


class Ended(NamedTuple):
    """Event: a gRPC call has ended. Either the server has ended it, or one of the two peers has cancelled it."""

    stream: int
    status: Status
    text: str = ""


class PeerLeft(NamedTuple):
    """Event: the peer has announced that it closes the connection (HTTP/2 GOAWAY)."""

    reason: str


Event = Called | MessageReceived | HalfClosed | Ended | PeerLeft


class MessageDecoder:
    """Split the data of one HTTP/2 stream into gRPC messages. The data may arrive in pieces of any size."""

    def __init__(self, max_message: int = MAX_MESSAGE) -> None:
        self._max = max_message
        # A bytearray can drop bytes at its front, and grow at its end, without copying the rest.
        self._pending = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield each complete message. Raise ``MalformedFrame`` if a message is too long or compressed."""
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
    """Return a message with gRPC's prefix of five bytes."""
    return b"\0" + len(message).to_bytes(4, "big") + message


class _FrameSizes:
    """Check the size of each HTTP/2 frame when its header arrives, and count the frames.

    h2 itself would first receive the whole frame, even one that is far too long. Counting bounds the time of one
    read: h2 needs up to 0.05 ms for each frame without content, and one read may hold hundreds of them.
    """

    def __init__(self, skip: int) -> None:
        """Start at the first byte of the connection. Its first ``skip`` bytes (the client's preface) are no
        frame."""
        self._skip = skip
        self._head = b""

    def feed(self, data: bytes, frames: int) -> tuple[int, int]:
        """Find how much of ``data`` may be decoded now, if at most ``frames`` frames may begin in it.

        Returns:
            The length of this part in bytes, and the number of frames that begin in it.

        Raises:
            MalformedFrame: A frame is too long.
        """
        offset = begun = 0
        while offset < len(data):
            if not self._skip and not self._head and begun == frames:
                break
            if self._skip:
                step = min(self._skip, len(data) - offset)
                self._skip -= step
            else:
                step = min(_FRAME_HEAD - len(self._head), len(data) - offset)
                self._head += data[offset : offset + step]
                if len(self._head) == _FRAME_HEAD:
                    begun += 1
                    self._skip, self._head = int.from_bytes(self._head[:3], "big"), b""
                    if self._skip > _MAX_FRAME:
                        raise MalformedFrame(f"HTTP/2: a frame of {self._skip} bytes")
            offset += step
        return offset, begun


class _End:
    """Base of ``ClientEnd`` and ``ServerEnd``, the two sides of a gRPC connection."""

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
        """True if ``feed_some`` has kept received bytes for its next call."""
        return bool(self._unread)

    def feed(self, data: bytes) -> list[Event]:
        """Decode the received bytes, and return the events in them.

        Raises:
            MalformedFrame: The bytes are malformed. Nothing that follows on this connection can be decoded.
        """
        events, _ = self.feed_some(data, sys.maxsize)
        return events

    def feed_some(self, data: bytes, frames: int) -> tuple[list[Event], int]:
        """Decode as ``feed`` does, but at most ``frames`` HTTP/2 frames. The other bytes are kept for the next
        call.

        Returns:
            The events, and the number of frames that began in the decoded bytes.
        """
        unread = self._unread + data
        size, begun = self._sizes.feed(unread, frames)
        read, self._unread = unread[:size], unread[size:]
        try:
            return [decoded for event in self._http.receive_data(read) for decoded in self._events_of(event)], begun
        except h2.exceptions.ProtocolError as error:
            raise MalformedFrame(f"HTTP/2: {error or type(error).__name__}") from None
        except (ValueError, UnicodeError, KeyError, IndexError) as error:
            raise MalformedFrame(f"HTTP/2: {type(error).__name__}") from None

    def outgoing(self) -> bytes:
        """Return the bytes that must be sent to the peer now."""
        return self._http.data_to_send()

    def reset(self, stream: int) -> None:
        """Cancel a call (HTTP/2 RST_STREAM). Does nothing if the call has ended."""
        self._forget(stream)
        try:
            self._http.reset_stream(stream, h2.errors.ErrorCodes.CANCEL)
        except h2.exceptions.ProtocolError:
            return

    def _events_of(self, event: h2.events.Event) -> Iterator[Event]:
        match event:
            case h2.events.RemoteSettingsChanged():
                self.settled = True
            case h2.events.DataReceived(stream_id=stream, data=data, flow_controlled_length=size):
                if size:
                    self._http.acknowledge_received_data(size, stream)
                if stream in self._decoders:
                    for message in self._decoders[stream].feed(data):
                        yield MessageReceived(stream, message)
            case h2.events.StreamReset(stream_id=stream, error_code=code):
                if self._forget(stream):
                    yield Ended(stream, Status.CANCELLED, f"the peer gave it up (HTTP/2 error {int(code)})")
            case h2.events.ConnectionTerminated(error_code=code):
                yield PeerLeft(f"HTTP/2 error {int(code)}" if code else "it said goodbye")

    def _begin(self, stream: int) -> None:
        self._decoders[stream] = MessageDecoder(self._max_message)

    def _forget(self, stream: int) -> bool:
        return self._decoders.pop(stream, None) is not None


class ClientEnd(_End):
    """The client side of one gRPC connection."""

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
            The stream id of the call.

        Raises:
            MalformedFrame: HTTP/2 allows no further call on this connection.
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
            last: True if no message of ours follows on this call.

        Raises:
            MalformedFrame: The peer's window has no room for the message, because the peer does not read.
        """
        data = framed(message)
        try:
            room = self._http.local_flow_control_window(stream)
            if len(data) > min(room, self._http.max_outbound_frame_size):
                raise MalformedFrame(f"HTTP/2: the peer has room for {room} bytes, not for {len(data)}")
            self._http.send_data(stream, data, end_stream=last)
        except h2.exceptions.ProtocolError as error:
            raise MalformedFrame(f"HTTP/2: {error}") from None

    def _events_of(self, event: h2.events.Event) -> Iterator[Event]:
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
                yield from super()._events_of(event)

    def _trailed(self, stream: int, fields: dict[str, str]) -> Iterator[Event]:
        number = fields.get("grpc-status", "")
        is_valid = number.isdecimal() and int(number) in tuple(Status)
        status = Status(int(number)) if is_valid else Status.UNKNOWN
        yield from self._over(stream, status, unquote(fields.get("grpc-message", "")))

    def _over(self, stream: int, status: Status, text: str) -> Iterator[Event]:
        if self._forget(stream):
            yield Ended(stream, status, text)


class ServerEnd(_End):
    """The server side of one gRPC connection. It keeps data while the client's HTTP/2 window has no room for
    more."""

    def __init__(self, max_message: int = MAX_MESSAGE) -> None:
        super().__init__(False, max_message)
        self._answered: set[int] = set()
        self._waiting: dict[int, bytes] = {}
        self._trailers: dict[int, list[Header]] = {}

    def has_room(self, stream: int) -> bool:
        """Return True if the stream is open and all data sent on it so far fitted into the client's window."""
        return stream in self._decoders and not self._waiting.get(stream)

    def send(self, stream: int, message: bytes) -> None:
        """Send one message to the client of a call. Does nothing if the call has ended.

        Raises:
            MalformedFrame: Too much data already waits for this client to read.
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
        """End a call once its waiting data has been sent. Does nothing if the call has ended."""
        if stream not in self._decoders:
            return
        self._answer(stream)
        details = [("grpc-message", quote(text))] if text else []
        self._trailers[stream] = [("grpc-status", str(int(status))), *details]
        self._flush(stream)

    def reset(self, stream: int) -> None:
        super().reset(stream)
        self._drop(stream)

    def _events_of(self, event: h2.events.Event) -> Iterator[Event]:
        match event:
            case h2.events.RequestReceived(stream_id=stream, headers=headers):
                self._begin(stream)
                yield Called(stream, _pairs(headers).get(":path", ""))
            case h2.events.StreamEnded(stream_id=stream):
                if stream in self._decoders:
                    yield HalfClosed(stream)
            case h2.events.StreamReset(stream_id=stream):
                self._drop(stream)
                yield from super()._events_of(event)
            case h2.events.WindowUpdated(stream_id=stream):
                for each in [stream] if stream else list(self._waiting):
                    self._flush(each)
            case _:
                yield from super()._events_of(event)

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
    """Return a dict of the header fields. If a name occurs several times, its last value is kept."""
    assert isinstance(headers, list)
    return {_text(name): _text(value) for name, value in headers}


def _text(value: str | bytes) -> str:
    return value.decode("utf-8", "replace") if isinstance(value, bytes) else value
