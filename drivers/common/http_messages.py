"""HTTP/1.1 messages as bytes, for robots behind a service: requests, responses, and one decoder for
either. Pure.

What such services need and no more: a body has a ``Content-Length`` or comes in chunks, everything
is bounded, and a message that leaves any doubt where it ends is malformed: its connection cannot be
used any further.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from .malformed import MalformedFrame

MAX_HEAD = 16_384
MAX_BODY = 4 << 20
"""Bytes; the longest is a picture in base64."""

_END = b"\r\n\r\n"
_LINE = b"\r\n"
_MAX_CHUNK_LINE = 1024
_BODILESS = (204, 304)

REASONS = {200: "OK", 400: "Bad Request", 404: "Not Found", 405: "Method Not Allowed", 500: "Internal Server Error"}


class Request(NamedTuple):
    """As it was heard. ``raw``: its bytes on the wire."""

    method: str
    target: str
    headers: Mapping[str, str]  # names in lower case
    body: bytes
    raw: bytes

    @property
    def closes(self) -> bool:
        """Return whether the client wants the connection closed after the response."""
        return self.headers.get("connection", "").lower() == "close"


class Response(NamedTuple):
    """As it was heard."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    @property
    def closes(self) -> bool:
        """Return whether the server closes the connection after it."""
        return self.headers.get("connection", "").lower() == "close"


def encode_request(method: str, target: str, host: str, body: bytes = b"", kind: str = "application/json") -> bytes:
    """Return a request that keeps its connection."""
    head = f"{method} {target} HTTP/1.1\r\nHost: {host}\r\nAccept: */*\r\n"
    if method != "GET":
        head += f"Content-Type: {kind}\r\nContent-Length: {len(body)}\r\n"
    return f"{head}\r\n".encode("ascii") + body


def encode_response(status: int, body: bytes, kind: str = "application/json") -> bytes:
    """Return a response that keeps its connection."""
    reason = REASONS.get(status, "Unknown")
    head = f"HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {len(body)}\r\n\r\n"
    return head.encode("ascii") + body


class _Decoder:
    """Bytes in any pieces."""

    def __init__(self) -> None:
        self._buffer = b""

    @property
    def has_part(self) -> bool:
        """Return whether a message has begun and not ended."""
        return bool(self._buffer)

    def _take(self, data: bytes) -> None:
        self._buffer += data
        if len(self._buffer) > MAX_HEAD + 2 * MAX_BODY:
            raise MalformedFrame(f"message of more than {MAX_HEAD + 2 * MAX_BODY} bytes")

    def _head(self) -> tuple[str, dict[str, str], int] | None:
        """Return the first line, the headers and where they end; None until they are there."""
        end = self._buffer.find(_END)
        if end < 0:
            if len(self._buffer) > MAX_HEAD:
                raise MalformedFrame(f"head of more than {MAX_HEAD} bytes")
            return None
        if end > MAX_HEAD:
            raise MalformedFrame(f"head of {end} bytes")
        try:
            first, *lines = self._buffer[:end].decode("ascii").split("\r\n")
        except UnicodeDecodeError:
            raise MalformedFrame("head is not ASCII") from None
        headers: dict[str, str] = {}
        for line in lines:
            name, colon, value = line.partition(":")
            if not colon or not name or name != name.strip():
                raise MalformedFrame(f"header line {line[:40]!r}")
            name = name.lower()
            if name in headers and name in ("content-length", "transfer-encoding"):
                raise MalformedFrame(f"{name} is given twice")
            headers[name] = value.strip()
        return first, headers, end + len(_END)

    def _body(self, headers: Mapping[str, str], start: int) -> tuple[bytes, int] | None:
        """Return the body and where the message ends; None until all of it is there."""
        if "transfer-encoding" in headers:
            if headers["transfer-encoding"].lower() != "chunked" or "content-length" in headers:
                raise MalformedFrame("transfer-encoding is not chunked alone")
            return self._chunks(start)
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdecimal()) or len(length) > 9 or int(length) > MAX_BODY:
            raise MalformedFrame(f"content-length is {length[:40]!r}")
        end = start + int(length)
        return (self._buffer[start:end], end) if len(self._buffer) >= end else None

    def _chunks(self, at: int) -> tuple[bytes, int] | None:
        parts: list[bytes] = []
        total = 0
        while True:
            line_end = self._buffer.find(_LINE, at)
            if line_end < 0:
                if len(self._buffer) - at > _MAX_CHUNK_LINE:
                    raise MalformedFrame("chunk without a size")
                return None
            size_text = self._buffer[at:line_end].partition(b";")[0].strip()
            if not size_text or len(size_text) > 7 or size_text.strip(b"0123456789abcdefABCDEF"):
                raise MalformedFrame(f"chunk size {size_text[:40]!r}")
            size, at = int(size_text, 16), line_end + len(_LINE)
            total += size
            if total > MAX_BODY:
                raise MalformedFrame(f"body of more than {MAX_BODY} bytes")
            if len(self._buffer) < at + size + len(_LINE):
                return None
            if self._buffer[at + size : at + size + len(_LINE)] != _LINE:
                raise MalformedFrame("chunk without an end, or trailers")
            parts.append(self._buffer[at : at + size])
            at += size + len(_LINE)
            if size == 0:
                return b"".join(parts), at


class RequestDecoder(_Decoder):
    """What a server hears on one connection."""

    def feed(self, data: bytes) -> Iterator[Request]:
        """Yield each request as soon as it is whole. Raise ``MalformedFrame``: nothing after it is
        understood."""
        self._take(data)
        while (head := self._head()) is not None:
            first, headers, start = head
            words = first.split(" ")
            if len(words) != 3 or words[2] not in ("HTTP/1.1", "HTTP/1.0") or not words[1].startswith("/"):
                raise MalformedFrame(f"request line {first[:40]!r}")
            body = self._body(headers, start)
            if body is None:
                return
            raw, self._buffer = self._buffer[: body[1]], self._buffer[body[1] :]
            yield Request(words[0], words[1], headers, body[0], raw)


class ResponseDecoder(_Decoder):
    """What a client hears on one connection."""

    def feed(self, data: bytes) -> Iterator[Response]:
        """Yield each response as soon as it is whole. Raise ``MalformedFrame``: what follows is not
        understood."""
        self._take(data)
        while (head := self._head()) is not None:
            first, headers, start = head
            version, _, rest = first.partition(" ")
            code = rest[:3]
            is_code = code.isascii() and code.isdecimal() and len(code) == 3
            if version not in ("HTTP/1.1", "HTTP/1.0") or not is_code:
                raise MalformedFrame(f"status line {first[:40]!r}")
            status = int(code)
            if (
                status not in _BODILESS
                and status >= 200
                and not {"content-length", "transfer-encoding"} & headers.keys()
            ):
                raise MalformedFrame("response that ends with its connection")
            bodiless = status in _BODILESS or status < 200
            body = (b"", start) if bodiless else self._body(headers, start)
            if body is None:
                return
            self._buffer = self._buffer[body[1] :]
            if status >= 200:  # 100 Continue announces another
                yield Response(status, headers, body[0])
