"""``late_answers FROM TO FLAG``: a proxy to a service that delays its answers by 0.3 s while file FLAG exists.

FROM and TO are ``host:port``, or paths of unix sockets. Requests are forwarded at once. The proxy prints the
address at which it listens.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import trio

LATE_S = 0.3
CHUNK = 65536
GONE = (trio.BrokenResourceError, trio.ClosedResourceError)


def late_s(flag: Path) -> float:
    return LATE_S if flag.exists() else 0.0


async def connect(there: str) -> trio.SocketStream:
    if there.startswith("/"):
        return await trio.open_unix_socket(there)
    host, _, port = there.rpartition(":")
    return await trio.open_tcp_stream(host, int(port))


async def listen(here: str) -> trio.SocketListener:
    if here.startswith("/"):
        socket = trio.socket.socket(trio.socket.AF_UNIX)
        await socket.bind(here)
        socket.listen()
        return trio.SocketListener(socket)
    host, _, port = here.rpartition(":")
    (listener,) = await trio.open_tcp_listeners(int(port), host=host)
    return listener


async def carry(client: trio.SocketStream, there: str, flag: Path) -> None:
    """Forward one connection, until either end is closed."""
    service = await connect(there)
    kept, come = trio.open_memory_channel[tuple[float, bytes | bytearray]](10_000)

    async def to_service() -> None:
        async for data in client:
            await service.send_all(data)

    async def hear() -> None:
        async for data in service:
            await kept.send((trio.current_time() + late_s(flag), data))

    async def to_client() -> None:
        async for due_s, data in come:
            await trio.sleep_until(due_s)
            await client.send_all(data)

    async def until_gone(way: Callable[[], Awaitable[None]]) -> None:
        with contextlib.suppress(*GONE):
            await way()
        nursery.cancel_scope.cancel()

    async with client, service, trio.open_nursery() as nursery:
        for way in (to_service, hear, to_client):
            nursery.start_soon(until_gone, way)


async def serve(here: str, there: str, flag: Path) -> None:
    listener = await listen(here)
    name = listener.socket.getsockname()
    print(name if isinstance(name, str) else f"{name[0]}:{name[1]}", flush=True)

    async def serve_one(client: trio.SocketStream) -> None:
        await carry(client, there, flag)

    await trio.serve_listeners(serve_one, [listener])


if __name__ == "__main__":
    trio.run(serve, sys.argv[1], sys.argv[2], Path(sys.argv[3]))
