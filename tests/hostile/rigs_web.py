"""Rigs of robots behind HTTP/1 and WebSockets: EarthRover, Yahboom, Reachy."""

from __future__ import annotations

import re
from collections.abc import Mapping

from . import services
from .bench import Rig
from .peer import Change

_HTTP = b"HTTP/1.1 200 OK\r\n"
_HTTP_FLOODS = {
    "answers to nothing": _HTTP + b"Content-Length: 0\r\n\r\n",
    "chunks": b"1\r\nx\r\n",
    "interim answers": b"HTTP/1.1 100 Continue\r\n\r\n",
}
_HTTP_BOMBS = {
    "endless chunks": _HTTP + b"Transfer-Encoding: chunked\r\n\r\n" + b"1\r\nx\r\n" * 20_000,
    "a compressed body": _HTTP + b"Content-Encoding: zstd\r\nContent-Length: 16000\r\n\r\n",
    "a body of 4 GB": _HTTP + b"Content-Length: 4294967296\r\n\r\n",
    "a redirect": b"HTTP/1.1 307 Moved\r\nLocation: http://192.0.2.9/\r\nContent-Length: 0\r\n\r\n",
}
_WEBSOCKET_FLOODS = {
    "pings": b"\x89\x00",
    "pongs": b"\x8a\x00",
    "empty messages": b"\x81\x00",
    "fragments": b"\x00\x00",
}
_WEBSOCKET_BOMBS = {"a message of 4 GB": b"\x82\x7f" + (1 << 32).to_bytes(8, "big")}


def _digits(before: bytes, digit: bytes) -> Change:
    """Return a change that replaces all digits of a number or uuid by one digit.

    Args:
        before: Expression for the text in front of the number. Lengths stay the same.
    """
    number = re.compile(before + rb'(\s*:\s*"?)([0-9a-f][0-9a-f.-]*)')

    def replaced(match: re.Match[bytes]) -> bytes:
        whole = match.group()
        return whole[: -len(match[2])] + re.sub(rb"[0-9a-f]", digit, match[2])

    return lambda data: number.sub(replaced, data)


def _constant(before: bytes) -> Change:
    """Return a change that replaces a number by 1, with spaces in front, so that lengths stay the same.

    A number of which only the digits change would still grow when it gets one digit more.
    """
    number = re.compile(before + rb"(\s*:\s*)([0-9.]+)")
    return lambda data: number.sub(
        lambda match: data[match.start() : match.start(2)] + b"1".rjust(len(match[2])), data
    )


def _one_too_many(data: bytes) -> bytes:
    """Return the answer with an unrequested one in front. From then on each request gets the answer to an older
    one."""
    return _HTTP + b"Content-Length: 2\r\n\r\n{}" + data if data.startswith(b"HTTP/1.1 ") else data


_ACCEPT: Mapping[str, Change] = {
    "accept": lambda data: re.sub(rb"(?i)(sec-websocket-accept: )....", rb"\1AAAA", data),
}
"""Changes of upgrades. Connections that were accepted before go on."""


RIGS: Mapping[str, Rig] = {
    "earthrover": Rig(
        services.earthrover,
        lambda position: {"linear": 0.2},
        floods=_HTTP_FLOODS,
        bombs=_HTTP_BOMBS,
        wrong_ids={"timestamp": _digits(rb'"timestamp"', b"1"), "one too many": _one_too_many},
    ),
    "yahboom_m3pro": Rig(
        services.yahboom,
        lambda position: {"linear.x": 0.2},
        floods=_WEBSOCKET_FLOODS,
        bombs=_WEBSOCKET_BOMBS,
        wrong_ids={
            "id": _digits(rb'"id"', b"9"),
            "stamp": _constant(rb'"(?:nano)?sec"'),
            "topic": lambda data: data.replace(b"/odom", b"/mood"),
            **_ACCEPT,
        },
        understood=("accept",),
    ),
    "reachy_mini": Rig(
        services.reachy,
        lambda position: {"head_yaw": 5.0},
        floods={**_WEBSOCKET_FLOODS, **_HTTP_FLOODS},
        bombs={**_WEBSOCKET_BOMBS, **_HTTP_BOMBS},
        wrong_ids={"uuid": _digits(rb'"uuid"', b"9"), "one too many": _one_too_many, **_ACCEPT},
        understood=("accept", "uuid"),  # a stop's confirmation contains neither of them
        login="its daemon drops what comes before it has answered the upgrade, as uvicorn does",
    ),
}
