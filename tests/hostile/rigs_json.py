"""Rig of a robot behind JSON-RPC on a unix socket: Microduck."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping

import trio

from strands_actors.drivers.common.codecs.json_rpc import encode_failure, encode_notification, encode_result
from strands_actors.drivers.common.ports.tcp_port import OrderlyStream
from strands_actors.drivers.microduck import link as microduck_link
from strands_actors.drivers.microduck import protocol as p
from strands_actors.drivers.microduck.driver import Microduck
from strands_actors.drivers.microduck.twin import DuckTwin, serving

from .bench import Bench, Rig
from .peer import HostilePeer
from .services import Service


def _microduck(peer: HostilePeer) -> Bench:
    twin = DuckTwin("microduck", trio.current_time, enabled=True)
    service = Service(peer, serving(twin))

    async def open_unix(path: str) -> OrderlyStream:
        return await service.open_stream(path, 0)

    @contextlib.asynccontextmanager
    async def living() -> AsyncIterator[None]:
        """Let the module of the link open streams in memory."""
        before, microduck_link.open_unix = microduck_link.open_unix, open_unix  # type: ignore[assignment]
        try:
            async with service.living():
                yield
        finally:
            microduck_link.open_unix = before

    driver = Microduck("microduck", "/no/such/socket", {})
    return Bench(driver, lambda: service.log.entries, living, twin)


RIGS: Mapping[str, Rig] = {
    "microduck": Rig(
        _microduck,
        lambda position: {"vx": 0.1},
        quick=("garbled", "flood", "bomb"),
        floods={
            "lines that are no JSON": b"0\n",
            "unasked answers": encode_result(7, {"accepted": True}),
            "errors": encode_failure(None, -32700, "what?"),
            "empty states": encode_notification(p.STATE, {}),
            "empty lines": b"\n",
        },
        bombs={"a line without an end": b'{"jsonrpc":"2.0","result":"', "nested lists": b"[" * 60_000},
        wrong_ids={"id": lambda data: data.replace(b'"id":', b'"id":9')},
    ),
}
