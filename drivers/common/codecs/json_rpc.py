"""Encode and decode JSON-RPC 2.0, with one JSON object per line (NDJSON). Pure: no socket, no clock."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import msgspec

from .malformed import MalformedFrame

MAX_LINE = 1 << 20
"""Most bytes of a line, unless the receiver sets another limit."""

PARSE_ERROR = -32700
INVALID_REQUEST = -32600
METHOD_NOT_FOUND = -32601
INVALID_PARAMS = -32602

_VERSION = "2.0"
_JSON = msgspec.json.Decoder()

Id = int | str | None


class Call(NamedTuple):
    """A received request, or a notification (a request that gets no answer)."""

    method: str
    params: Mapping[str, Any]
    id: Id
    is_notification: bool


class Result(NamedTuple):
    """A received answer to a request that succeeded."""

    id: Id
    value: Any


class Failure(NamedTuple):
    """A received answer to a request that failed."""

    id: Id
    code: int
    message: str


Message = Call | Result | Failure


def encode_notification(method: str, params: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": _VERSION, "method": method, "params": params})


def encode_request(number: int, method: str, params: Mapping[str, Any]) -> bytes:
    return _line({"jsonrpc": _VERSION, "id": number, "method": method, "params": params})


def encode_result(number: Id, value: object) -> bytes:
    return _line({"jsonrpc": _VERSION, "id": number, "result": value})


def encode_failure(number: Id, code: int, message: str) -> bytes:
    return _line({"jsonrpc": _VERSION, "id": number, "error": {"code": code, "message": message}})


class LineDecoder:
    """Split the received bytes of one peer into lines. The bytes may arrive in pieces of any size."""

    def __init__(self, longest: int = MAX_LINE) -> None:
        self._longest = longest
        self._rest = bytearray()

    def feed(self, data: bytes) -> Iterator[bytes]:
        """Yield the complete lines, without line ends and without empty lines.

        Raises:
            MalformedFrame: A line is too long. The start of the next line is unknown, so the connection must be
                closed.
        """
        self._rest += data
        while (end := self._rest.find(b"\n")) >= 0:
            line = bytes(self._rest[:end])
            del self._rest[: end + 1]
            self._check(len(line))
            if line.strip():
                yield line
        self._check(len(self._rest))

    def _check(self, length: int) -> None:
        if length > self._longest:
            raise MalformedFrame(f"a line of more than {self._longest} bytes")


def decode(line: bytes) -> Message:
    """Return the JSON-RPC 2.0 message in a line. Raise ``MalformedFrame`` for any other content."""
    try:
        content = _JSON.decode(line)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError):
        raise MalformedFrame("a line that is no JSON") from None
    if not isinstance(content, dict) or content.get("jsonrpc") != _VERSION:
        raise MalformedFrame("no message of JSON-RPC 2.0")
    number = content.get("id")
    if isinstance(number, bool) or not isinstance(number, int | str | None):
        raise MalformedFrame("an id that is none")
    if "method" in content:
        return _call(content, number)
    if "error" in content:
        return _failure(content["error"], number)
    if "result" in content:
        return Result(number, content["result"])
    raise MalformedFrame("neither a call nor an answer")


def _call(content: dict[str, Any], number: Id) -> Call:
    method, params = content["method"], content.get("params")
    params = {} if params is None else params
    if not isinstance(method, str) or not isinstance(params, dict):
        raise MalformedFrame("a call without a method, or whose parameters have no names")
    return Call(method, params, number, "id" not in content)


def _failure(error: object, number: Id) -> Failure:
    code = error.get("code") if isinstance(error, dict) else None
    message = error.get("message") if isinstance(error, dict) else None
    if isinstance(code, bool) or not isinstance(code, int) or not isinstance(message, str):
        raise MalformedFrame("an error without code and message")
    return Failure(number, code, message)


def _line(message: Mapping[str, Any]) -> bytes:
    return msgspec.json.encode(message) + b"\n"
