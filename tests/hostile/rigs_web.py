"""Robots behind HTTP/1 and WebSockets: EarthRover, Yahboom, Reachy."""

from __future__ import annotations

from collections.abc import Mapping

from . import services
from .bench import Rig

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


RIGS: Mapping[str, Rig] = {
    "earthrover": Rig(
        services.earthrover,
        lambda position: {"linear": 0.2},
        floods=_HTTP_FLOODS,
        bombs=_HTTP_BOMBS,
    ),
    "yahboom_m3pro": Rig(
        services.yahboom,
        lambda position: {"linear.x": 0.2},
        floods=_WEBSOCKET_FLOODS,
        bombs=_WEBSOCKET_BOMBS,
    ),
    "reachy_mini": Rig(
        services.reachy,
        lambda position: {"head_yaw": 5.0},
        floods={**_WEBSOCKET_FLOODS, **_HTTP_FLOODS},
        bombs={**_WEBSOCKET_BOMBS, **_HTTP_BOMBS},
        login="its daemon drops what comes before it has answered the upgrade, as uvicorn does",
    ),
}
