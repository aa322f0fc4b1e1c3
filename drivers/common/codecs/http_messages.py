"""Encode and decode HTTP/1.1, as client and as server, for robots that are reached through an HTTP service.

Pure, over h11. Four sizes are bounded: the head of a message, its body, the number of its chunks, and the amount of
received data that one call decodes. A client refuses everything that it has not requested: a response without a
request, a compressed body, a redirect. After malformed bytes, neither side decodes anything more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping
from typing import NamedTuple

import h11

from .malformed import MalformedFrame

MAX_HEAD = 65_536
"""Most bytes of a head, or of the head of one chunk."""
MAX_BODY = 1 << 20
"""Most bytes of a body. A client that expects more, such as a picture in base64, sets its own limit."""
MAX_CHUNKS = 2048
"""Most chunks of one body."""
MAX_INTERIM = 4
"""Most interim answers, such as 100 Continue, before the answer itself."""
EVENTS = 64
"""Most parts of messages that one turn takes in. h11 needs some 0.02 ms for each."""

_BODILESS = (204, 304)

REASONS = {200: "OK", 400: "Bad Request", 404: "Not Found", 405: "Method Not Allowed", 500: "Internal Server Error"}


class Request(NamedTuple):
    """A received request. ``raw`` holds the received bytes of the whole request."""

    method: str
    target: str
    headers: Mapping[str, str]  # header names are in lower case
    body: bytes
    raw: bytes


class Response(NamedTuple):
    """A received HTTP response."""

    status: int
    headers: Mapping[str, str]  # header names are in lower case
    body: bytes


def encode_response(status: int, body: bytes, content_type: str = "application/json") -> bytes:
    """Encode an HTTP response, after which the connection stays open."""
    reason = REASONS.get(status, "Unknown")
    head = f"HTTP/1.1 {status} {reason}\r\nContent-Type: {content_type}\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode("ascii") + body


class _Incoming:
    """A message that is being received, with the parts of it that have arrived so far."""

    def __init__(self, http: h11.Connection, max_body: int) -> None:
        self._http = http
        self._max_body = max_body
        self._body = bytearray()
        self._chunks = self._interim = self._size = 0
        self.first: h11.Request | h11.Response | None = None
        self.headers: dict[str, str] = {}

    def receive(self, data: bytes) -> None:
        self._size += len(data)
        self._http.receive_data(data)

    def advance(self, parts: int) -> tuple[bool, bool, int]:
        """Decode at most ``parts`` parts (h11 events) of the received data.

        Returns:
            Three values: whether the message is complete, whether more bytes are needed, and how many of the
            ``parts`` may still be decoded.

        Raises:
            MalformedFrame: The data is no HTTP, or the message exceeds a bound.
        """
        while parts > 0:
            parts -= 1
            try:
                event = self._http.next_event()
            except h11.RemoteProtocolError as error:
                raise MalformedFrame(f"HTTP: {error}") from None
            match event:
                case h11.NEED_DATA:
                    # This bound also covers the heads of the chunks, which count neither as head nor as body of the
                    # message.
                    if self._size > MAX_HEAD + 2 * self._max_body:
                        raise MalformedFrame(f"HTTP: a message of more than {MAX_HEAD + 2 * self._max_body} bytes")
                    return False, True, parts
                case h11.EndOfMessage():
                    return True, False, parts
                case h11.InformationalResponse():
                    self._interim += 1
                    if self._interim > MAX_INTERIM:
                        raise MalformedFrame(f"HTTP: more than {MAX_INTERIM} interim answers")
                case h11.Request() | h11.Response():
                    self._begin(event)
                case h11.Data():
                    self._take(event)
                case _:
                    raise MalformedFrame("HTTP: it ends within a message")
        return False, False, 0

    @property
    def body(self) -> bytes:
        return bytes(self._body)

    @property
    def rest(self) -> bytes:
        """The received bytes that follow this message."""
        return bytes(self._http.trailing_data[0])

    def _begin(self, event: h11.Request | h11.Response) -> None:
        self.first = event
        for name, value in event.headers:
            self.headers[name.decode("ascii")] = value.decode("latin-1")
        length = self.headers.get("content-length")
        if length is not None and "transfer-encoding" in self.headers:
            raise MalformedFrame("HTTP: a body with a length and with chunks")
        if length is not None and int(length) > self._max_body:
            raise MalformedFrame(f"HTTP: a body of {length} bytes, more than {self._max_body}")
        if isinstance(event, h11.Response):
            self._check_response(event)

    def _check_response(self, response: h11.Response) -> None:
        """Raise ``MalformedFrame`` for a response that is compressed, redirects, or does not give its length."""
        encoding = self.headers.get("content-encoding", "identity")
        if encoding.lower() != "identity":
            raise MalformedFrame(f"HTTP: the answer is compressed ({encoding[:40]}), which was not asked for")
        if 300 <= response.status_code < 400:
            place = self.headers.get("location", "nowhere")
            raise MalformedFrame(f"HTTP: it redirects to {place[:80]!r} (status {response.status_code})")
        has_end = response.status_code in _BODILESS or {"content-length", "transfer-encoding"} & self.headers.keys()
        if not has_end:
            raise MalformedFrame("HTTP: an answer that ends with its connection")

    def _take(self, event: h11.Data) -> None:
        self._body += event.data
        self._chunks += event.chunk_start
        if len(self._body) > self._max_body:
            raise MalformedFrame(f"HTTP: a body of more than {self._max_body} bytes")
        if self._chunks > MAX_CHUNKS:
            raise MalformedFrame(f"HTTP: a body of more than {MAX_CHUNKS} chunks")


class ClientEnd:
    """The client side of an HTTP connection. It may send a request before earlier ones are answered
    (pipelining)."""

    def __init__(self, host: str, max_body: int = MAX_BODY) -> None:
        """Prepare the client side of one connection.

        Args:
            host: Value of the ``Host`` header, with the port.
            max_body: Most bytes of a response's body.
        """
        self._host = host
        self._max_body = max_body
        self._answers: deque[_Incoming] = deque()
        self._unread = b""
        self._has_parts = False  # True if parts of the first response were received but not decoded yet
        self._failure = ""

    @property
    def has_unread(self) -> bool:
        """True if ``feed`` has kept received data that its next call will decode."""
        return self._has_parts or bool(self._unread)

    def request(self, method: str, target: str, body: bytes = b"", content_type: str = "application/json") -> bytes:
        """Encode a request, after which the connection stays open.

        Raises:
            ValueError: The method or the target is not valid.
        """
        http = h11.Connection(h11.CLIENT, max_incomplete_event_size=MAX_HEAD)
        headers = [("Host", self._host), ("Accept", "*/*"), ("Accept-Encoding", "identity")]
        if method != "GET":
            headers += [("Content-Type", content_type), ("Content-Length", str(len(body)))]
        try:
            head = http.send(h11.Request(method=method, target=target, headers=headers))
            http.send(h11.Data(data=body))
            http.send(h11.EndOfMessage())
        except (h11.LocalProtocolError, UnicodeEncodeError) as error:
            raise ValueError(f"{method} {target[:80]!r}: {error}") from None
        self._answers.append(_Incoming(http, self._max_body))
        return (head or b"") + body

    def feed(self, data: bytes) -> list[Response]:
        """Decode received data, up to a fixed amount (``EVENTS`` parts) per call.

        If ``has_unread`` is True afterwards, call again with empty ``data`` to decode more.

        Returns:
            The complete responses, in the order of the requests.

        Raises:
            MalformedFrame: The data is malformed. Nothing that follows on this connection can be decoded.
        """
        if self._failure:
            raise MalformedFrame(f"bytes after the end ({self._failure})")
        try:
            return list(self._feed(data))
        except MalformedFrame as malformed:
            self._failure = str(malformed)
            raise

    def _feed(self, data: bytes) -> Iterator[Response]:
        self._unread += data
        remaining = EVENTS
        while remaining > 0 and self.has_unread:
            if not self._answers:
                raise MalformedFrame("HTTP: an answer to no request")
            answer = self._answers[0]
            if self._unread:
                answer.receive(self._unread)
                self._unread = b""
            is_whole, needs_more, remaining = answer.advance(remaining)
            self._has_parts = not is_whole and not needs_more
            if is_whole:
                self._unread = answer.rest
                self._answers.popleft()
                assert isinstance(answer.first, h11.Response)
                yield Response(answer.first.status_code, answer.headers, answer.body)


class ServerEnd:
    """The server side of an HTTP connection."""

    def __init__(self, max_body: int = MAX_BODY) -> None:
        self._max_body = max_body
        self._begin()

    def feed(self, data: bytes) -> Iterator[Request]:
        """Decode received data, and yield each request as soon as it is complete.

        Raises:
            MalformedFrame: The data is malformed. Nothing that follows on this connection can be decoded.
        """
        while data:
            self._raw += data
            self._request.receive(data)
            is_whole, needs_more = False, False
            while not is_whole and not needs_more:
                is_whole, needs_more, _ = self._request.advance(EVENTS)
            if needs_more:
                return
            first, data = self._request.first, self._request.rest
            assert isinstance(first, h11.Request)
            request = Request(
                first.method.decode("ascii"),
                first.target.decode("ascii"),
                self._request.headers,
                self._request.body,
                bytes(self._raw[: len(self._raw) - len(data)]),
            )
            self._begin()
            yield request

    def _begin(self) -> None:
        http = h11.Connection(h11.SERVER, max_incomplete_event_size=MAX_HEAD)
        self._request = _Incoming(http, self._max_body)
        self._raw = bytearray()
