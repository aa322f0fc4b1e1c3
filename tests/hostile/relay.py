"""A process between a robot's program and its twin, on TCP, which can turn hostile.

It listens on an address of its own, at the ports of the twin, and hands on what either side says.
From the line ``begin KIND FIRST HEX`` on its standard input on, what the twin says is changed, on
every connection: ``garbled`` (random bytes in its place), ``half`` (nothing more), ``flood``
(``FIRST`` once, if any, then ``HEX`` again and again, as fast as it is taken, and the twin's own words
among it). ``begin ok`` ends that, and every connection.
"""

from __future__ import annotations

import os
import subprocess
import sys
from types import TracebackType

import trio

from strands_actors.drivers.common.twin.tcp import own_host

CHUNK = 1 << 16
LONGEST_LINE = 4096
"""Of its standard input: it is read in one piece."""


class Relay:
    """The process, from outside: ``with Relay(twin.port, extra_ports) as relay``."""

    def __init__(self, target: str, ports: tuple[int, ...] = ()) -> None:
        self._host, _, port = target.rpartition(":")
        self._ports = tuple(dict.fromkeys((int(port), *ports)))

    def __enter__(self) -> Relay:
        self.host = own_host()
        arguments = [sys.executable, "-m", __name__, self.host, self._host, *map(str, self._ports)]
        self._process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert self._process.stdout.readline() == "ready\n"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()

    @property
    def port(self) -> str:
        return f"{self.host}:{self._ports[0]}"

    def begin(self, kind: str, flood: bytes = b"", first: bytes = b"") -> None:
        line = f"begin {kind} {first.hex() or '-'} {flood.hex() or '-'}\n"
        assert self._process.stdin is not None and len(line) < LONGEST_LINE
        self._process.stdin.write(line)
        self._process.stdin.flush()


class _Hostility:
    def __init__(self) -> None:
        self.kind = "ok"
        self.first = self.flood = b""
        self.connections: set[trio.CancelScope] = set()


async def _serve(own: str, target: str, ports: list[int]) -> None:
    hostile = _Hostility()
    async with trio.open_nursery() as nursery:
        for port in ports:
            listeners = await trio.open_tcp_listeners(port, host=own)
            nursery.start_soon(_accept, listeners[0], target, port, hostile)
        print("ready", flush=True)
        async with trio.lowlevel.FdStream(os.dup(0)) as lines:
            async for data in lines:
                _, hostile.kind, *texts = data.decode().split()
                hostile.first, flood = (b"" if text == "-" else bytes.fromhex(text) for text in texts)
                hostile.flood = flood * max(1, CHUNK // max(1, len(flood)))
                for scope in hostile.connections if hostile.kind == "ok" else ():
                    scope.cancel()
        nursery.cancel_scope.cancel()


async def _accept(listener: trio.SocketListener, target: str, port: int, hostile: _Hostility) -> None:
    async def attend(host: trio.SocketStream) -> None:
        scope = trio.CancelScope()
        hostile.connections.add(scope)
        try:
            with scope:
                await relay(host)
        finally:
            hostile.connections.discard(scope)

    async def relay(host: trio.SocketStream) -> None:
        try:
            twin = await trio.open_tcp_stream(target, port)
            async with host, twin, trio.open_nursery() as nursery:
                nursery.start_soon(_tell, twin, host, hostile)
                async for data in host:
                    await twin.send_all(data)
                nursery.cancel_scope.cancel()
        except* (OSError, trio.BrokenResourceError, trio.ClosedResourceError):
            pass

    await trio.serve_listeners(attend, [listener])


async def _tell(twin: trio.SocketStream, host: trio.SocketStream, hostile: _Hostility) -> None:
    """Hand on what the twin says, or something else."""
    has_begun = False
    while True:
        data = b""
        with trio.move_on_after(0.02 if hostile.kind != "flood" else 0.0):
            data = await twin.receive_some(CHUNK)
            if not data:
                return
        match hostile.kind:
            case "garbled":
                await host.send_all(os.urandom(len(data) or 100))
            case "half":
                pass
            case "flood":
                await host.send_all(hostile.flood if has_begun else hostile.first + hostile.flood)
                has_begun = True
                if data:
                    await host.send_all(data)
            case _ if data:
                await host.send_all(data)


if __name__ == "__main__":
    trio.run(_serve, sys.argv[1], sys.argv[2], [int(port) for port in sys.argv[3:]])
