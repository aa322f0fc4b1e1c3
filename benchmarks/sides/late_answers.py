"""``late_answers FROM TO FLAG``: forward connections to a service. While the file FLAG exists, the proxy delays the
service's answers by 0.3 s.

The proxy listens at FROM and connects to TO. Both are ``host:port``, or the path of a unix socket. Requests are
forwarded at once. The proxy prints the address at which it listens.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path

import trio

LATE_S = 0.3
CHUNK = 65536
CLOSED = (trio.BrokenResourceError, trio.ClosedResourceError)


def late_s(flag: Path) -> float:
    return LATE_S if flag.exists() else 0.0


async def connect(address: str) -> trio.SocketStream:
    if address.startswith("/"):
        return await trio.open_unix_socket(address)
    host, _, port = address.rpartition(":")
    return await trio.open_tcp_stream(host, int(port))


async def listen(address: str) -> trio.SocketListener:
    if address.startswith("/"):
        socket = trio.socket.socket(trio.socket.AF_UNIX)
        await socket.bind(address)
        socket.listen()
        return trio.SocketListener(socket)
    host, _, port = address.rpartition(":")
    (listener,) = await trio.open_tcp_listeners(int(port), host=host)
    return listener


async def carry(client: trio.SocketStream, service_address: str, flag: Path) -> None:
    """Forward the data of one connection in both directions, until one of the two ends is closed."""
    service = await connect(service_address)
    sender, receiver = trio.open_memory_channel[tuple[float, bytes | bytearray]](10_000)

    async def to_service() -> None:
        async for data in client:
            await service.send_all(data)

    async def hear() -> None:
        async for data in service:
            await sender.send((trio.current_time() + late_s(flag), data))

    async def to_client() -> None:
        async for due_s, data in receiver:
            await trio.sleep_until(due_s)
            await client.send_all(data)

    async def until_closed(forward: Callable[[], Awaitable[None]]) -> None:
        with contextlib.suppress(*CLOSED):
            await forward()
        nursery.cancel_scope.cancel()

    async with client, service, trio.open_nursery() as nursery:
        for forward in (to_service, hear, to_client):
            nursery.start_soon(until_closed, forward)


async def serve(address: str, service_address: str, flag: Path) -> None:
    listener = await listen(address)
    name = listener.socket.getsockname()
    print(name if isinstance(name, str) else f"{name[0]}:{name[1]}", flush=True)

    async def serve_one(client: trio.SocketStream) -> None:
        await carry(client, service_address, flag)

    await trio.serve_listeners(serve_one, [listener])


if __name__ == "__main__":
    trio.run(serve, sys.argv[1], sys.argv[2], Path(sys.argv[3]))
