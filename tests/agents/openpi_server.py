"""A policy server that speaks as openpi's do: metadata first, then arrays in msgpack, a traceback as its error."""

from __future__ import annotations

import contextlib
import struct
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import msgspec
from websockets.sync.server import ServerConnection

from .serving import served

Infer = Callable[[dict[str, Any]], Any]


def array(rows: Sequence[Sequence[float]], dtype: str = "<f4") -> dict[bytes, Any]:
    """Return rows of numbers in the form of openpi's ``msgpack_numpy``."""
    values = [value for row in rows for value in row]
    data = struct.pack(f"<{len(values)}{'d' if dtype == '<f8' else 'f'}", *values)
    return {b"__ndarray__": True, b"data": data, b"dtype": dtype, b"shape": [len(rows), len(rows[0])]}


def numbers(value: Mapping[bytes, Any]) -> list[float]:
    """Return the numbers of a float32 array that a client has sent."""
    assert (value[b"__ndarray__"], value[b"dtype"]) == (True, "<f4")
    return list(struct.unpack(f"<{value[b'shape'][0]}f", value[b"data"]))


@contextlib.contextmanager
def openpi_server(
    infer: Infer, metadata: Mapping[str, Any] | None = None
) -> Iterator[tuple[int, list[dict[str, Any]]]]:
    """Yield its port and the received requests. ``infer`` returns the value of ``actions``, or raw bytes."""
    received: list[dict[str, Any]] = []

    def handle(connection: ServerConnection) -> None:
        connection.send(msgspec.msgpack.encode(dict(metadata or {})))
        for message in connection:
            assert isinstance(message, bytes)
            received.append(msgspec.msgpack.decode(message))
            try:
                actions = infer(received[-1])
            except Exception:
                connection.send(traceback.format_exc())
                connection.close(1011)
                return
            answer = {"actions": actions, "server_timing": {"infer_ms": 1.0}}
            connection.send(actions if isinstance(actions, bytes) else msgspec.msgpack.encode(answer))

    with served(handle) as port:
        yield port, received
