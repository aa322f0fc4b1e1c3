"""A process between a robot's program and its twin that can turn hostile, on TCP, unix sockets and datagrams.

It listens on an address of its own, at the twin's ports, and forwards both directions. If the twin's address is
a path, so is the relay's.

After the line ``begin KIND FIRST HEX`` on its standard input, it changes the twin's output on every connection.
``garbled`` sends random bytes in its place. ``half`` sends nothing more. ``flood`` sends ``FIRST`` once, if
given, then repeats ``HEX`` as fast as the host reads, with the twin's own bytes in between. ``begin ok`` ends
the fault, and every connection.

Datagrams use one port number for both ends and the relay. The host is at ``HOST``, the twin at the address from
which it sends. On DDS each participant announces its address. The relay replaces both announcements by its own
address, so that neither end knows the other's. A flood then starts with the header of the twin's own datagram.
"""

from __future__ import annotations

import contextlib
import enum
import os
import socket
import subprocess
import sys
from collections.abc import Mapping
from types import TracebackType

import trio

from strands_actors.drivers.common.twin.tcp import own_host

CHUNK = 1 << 16
LONGEST_LINE = 4096
"""Bytes of a line on standard input, which is read in one piece."""
HOST = "127.0.0.1"
GREETING = 16
"""Bytes of the first message from a Franka's host."""
FLOODED = 20
"""Datagrams of a flood for each datagram of the twin."""
DDS_FLOODED = 4
"""As ``FLOODED``, for DDS: a robot sends 500 a second and each may be answered. A longer queue here would lose
datagrams, which would be another fault."""
DDS_PORTS = range(7410, 7430)
"""Ports of domain 0, enough for ten participants at one address."""
RTPS_HEADER = 20
"""Bytes of a datagram that name its participant."""


class Datagrams(enum.StrEnum):
    NONE = "none"
    SAME_PORT = "same port"  # the twin's port number
    GREETING = "greeting"  # the port in the last two bytes of the first message on TCP
    DDS = "dds"  # every port of ``DDS_PORTS``


class Relay:
    """Run the relay process: ``with Relay(twin.port, extra_ports) as relay``. ``host`` is its address or its
    path."""

    def __init__(
        self, target: str, ports: tuple[int, ...] = (), datagrams: Datagrams = Datagrams.NONE, host: str = ""
    ) -> None:
        self._is_path = target.startswith("/")
        self._host, _, port = (target, "", "0") if self._is_path else target.rpartition(":")
        more = DDS_PORTS if datagrams is Datagrams.DDS else ports
        self._ports = tuple(dict.fromkeys((int(port), *more)))
        self._datagrams = datagrams
        self.host = host or own_host()

    def __enter__(self) -> Relay:
        arguments = [sys.executable, "-m", __name__, self.host, self._host, self._datagrams, *map(str, self._ports)]
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
        return self.host if self._is_path else f"{self.host}:{self._ports[0]}"

    def begin(self, kind: str, flood: bytes = b"", first: bytes = b"") -> None:
        line = f"begin {kind} {first.hex() or '-'} {flood.hex() or '-'}\n"
        assert self._process.stdin is not None and len(line) < LONGEST_LINE
        self._process.stdin.write(line)
        self._process.stdin.flush()


class _Hostility:
    def __init__(self) -> None:
        self.kind = "ok"
        self.first = self.flood = b""
        self.word = b""  # the flood's content in one datagram
        self.connections: set[trio.CancelScope] = set()


async def _serve(own: str, target: str, datagrams: str, ports: list[int]) -> None:
    hostile = _Hostility()
    async with trio.open_nursery() as nursery:
        if datagrams == Datagrams.DDS:
            await nursery.start(_relay_dds, own, target, ports, hostile)
        for port in ports if datagrams != Datagrams.DDS else ():
            if datagrams == Datagrams.SAME_PORT:
                await nursery.start(_relay_datagrams, own, target, port, hostile)
                continue
            listener = await _listener(own, port)
            names_port = datagrams == Datagrams.GREETING
            nursery.start_soon(_accept, listener, own, target, port, hostile, names_port)
        print("ready", flush=True)
        async with trio.lowlevel.FdStream(os.dup(0)) as lines:
            async for data in lines:
                _, hostile.kind, *texts = data.decode().split()
                hostile.first, hostile.word = (b"" if text == "-" else bytes.fromhex(text) for text in texts)
                flood = hostile.word
                hostile.flood = flood * max(1, CHUNK // max(1, len(flood)))
                for scope in hostile.connections if hostile.kind == "ok" else ():
                    scope.cancel()
        nursery.cancel_scope.cancel()


async def _listener(own: str, port: int) -> trio.SocketListener:
    """Listen at an address, or at a path if the port is 0."""
    if port:
        return (await trio.open_tcp_listeners(port, host=own))[0]
    sock = trio.socket.socket(trio.socket.AF_UNIX)
    await sock.bind(own)
    sock.listen()
    return trio.SocketListener(sock)


async def _connect(target: str, port: int, own: str) -> trio.SocketStream:
    """Connect to the twin, from the relay's own address if there is one."""
    if port:
        return await trio.open_tcp_stream(target, port, local_address=own)
    sock = trio.socket.socket(trio.socket.AF_UNIX)
    await sock.connect(target)
    return trio.SocketStream(sock)


async def _relay_dds(
    own: str,
    target: str,
    ports: list[int],
    hostile: _Hostility,
    task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Forward datagrams until cancelled. Each leaves from the relay's port that has the sender's port number,
    and goes to the port at which it arrived."""
    async with trio.open_nursery() as nursery:
        sockets = {port: trio.socket.socket(type=trio.socket.SOCK_DGRAM) for port in ports}
        for port, sock in sockets.items():
            await sock.bind((own, port))
        for port in ports:
            nursery.start_soon(_relay_dds_port, sockets, port, own, target, hostile)
        task_status.started()


async def _relay_dds_port(
    sockets: Mapping[int, trio.socket.SocketType], port: int, own: str, target: str, hostile: _Hostility
) -> None:
    while True:
        data, (host, sender_port, *_) = await sockets[port].recvfrom(CHUNK)
        if (by := sockets.get(sender_port)) is None:
            continue
        data = data.replace(_locator(host), _locator(own))
        if host != target:
            await _send(by, data, (target, port))
            continue
        flood = data[:RTPS_HEADER] + hostile.word[RTPS_HEADER:]
        for piece in _said(data, flood, hostile.kind, DDS_FLOODED):
            await _send(by, piece, (HOST, port))


def _locator(host: str) -> bytes:
    """Return an IPv4 address in the encoding of DDS."""
    return bytes(12) + socket.inet_aton(host)


def _said(data: bytes, flood: bytes, kind: str, flooded: int = FLOODED) -> list[bytes]:
    """Return the datagrams to send in place of one of the twin's."""
    match kind:
        case "garbled":
            return [os.urandom(len(data))]
        case "half":
            return []
        case "flood":
            return [*[flood] * flooded, data]
    return [data]


async def _relay_datagrams(
    own: str,
    target: str,
    port: int,
    hostile: _Hostility,
    task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED,
) -> None:
    """Forward datagrams until cancelled."""
    twin = target, port
    with trio.socket.socket(type=trio.socket.SOCK_DGRAM) as sock:
        await sock.bind((own, port))
        task_status.started()
        while True:
            data, sender = await sock.recvfrom(CHUNK)
            if sender[0] != target:
                await _send(sock, data, twin)
                continue
            twin = sender
            for piece in _said(data, hostile.word, hostile.kind):
                await _send(sock, piece, (HOST, port))


async def _send(sock: trio.socket.SocketType, data: bytes, to: tuple[str, int]) -> None:
    with contextlib.suppress(OSError):  # no receiver is there
        await sock.sendto(data, to)


async def _accept(
    listener: trio.SocketListener, own: str, target: str, port: int, hostile: _Hostility, names_port: bool
) -> None:
    """Accept the host's connections. With ``names_port`` the host's first message names its port for datagrams."""

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
            twin = await _connect(target, port, own)
            async with host, twin, trio.open_nursery() as nursery:
                nursery.start_soon(_tell, twin, host, hostile)
                greeted = not names_port
                async for data in host:
                    if not greeted:
                        greeted = True
                        udp_port = int.from_bytes(data[GREETING - 2 : GREETING], "little")
                        await nursery.start(_relay_datagrams, own, target, udp_port, hostile)
                    await twin.send_all(data)
                nursery.cancel_scope.cancel()
        except* (OSError, trio.BrokenResourceError, trio.ClosedResourceError):
            pass

    await trio.serve_listeners(attend, [listener])


async def _tell(twin: trio.SocketStream, host: trio.SocketStream, hostile: _Hostility) -> None:
    """Forward the twin's bytes, or the changed bytes, to the host."""
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
    trio.run(_serve, *sys.argv[1:4], [int(port) for port in sys.argv[4:]])
