"""Serve the simulated base on UDP: one protobuf frame in each datagram, without magic and length.

The vendor's examples use UDP for cyclic data, on the port after that of TCP. Some use the number of TCP's own port.
"""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Callable
from typing import Protocol

import trio

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import Exchange, WireLog
from strands_actors.drivers.common.twin.server import Frost
from strands_actors.drivers.kinova import protocol as p

LONGEST = 65_535
MOST_CLIENTS = 64
"""Clients that are remembered. A new one replaces the one that came first."""

Address = tuple[str, int]
Send = Callable[[p.Frame], None]


class Client(Protocol):
    """One client, as the simulated base handles it."""

    def exchange(self, frame: p.Frame, encode: Callable[[p.Frame], bytes]) -> Exchange: ...


class Datagrams:
    def __init__(self, new_client: Callable[[Send], Client], log: WireLog) -> None:
        """Args:
        new_client: Returns a new client, for a function that sends a notification to it.
        log: The log of the robot's protocol.
        """
        self._new_client = new_client
        self._log = log
        self._sockets: list[socket.socket] = []
        self._plugged = trio.Event()
        self._clients: dict[tuple[int, Address], Client] = {}

    def plug(self, host: str, port: int) -> None:
        """Open the ports. One that another program uses is left out, because TCP works without it."""
        if self._sockets:
            return
        for number in (port, port + 1):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            sock.setblocking(False)
            try:
                sock.bind((host, number))
            except (OSError, OverflowError):
                sock.close()
            else:
                self._sockets.append(sock)
        self._plugged.set()

    def unplug(self) -> None:
        """Close the ports, like a pulled network cable."""
        # Tasks wait for the present event, so it stays if the cable is already unplugged.
        if self._plugged.is_set():
            self._plugged = trio.Event()
        for sock in self._sockets:
            with contextlib.suppress(RuntimeError):  # raised outside of the event loop, where no task waits
                trio.lowlevel.notify_closing(sock)
            sock.close()
        self._sockets = []
        self._clients.clear()

    async def serve(self, frost: Frost) -> None:
        """Answer requests until cancelled. The robot answers none while it is frozen."""
        while True:
            await self._plugged.wait()
            sockets, plugged = list(self._sockets), self._plugged
            async with trio.open_nursery() as nursery:
                for sock in sockets:
                    nursery.start_soon(self._attend, sock, frost)
            if plugged is self._plugged:
                await trio.sleep_forever()  # No port could be opened.

    async def _attend(self, sock: socket.socket, frost: Frost) -> None:
        """Answer the requests on one port until it is closed."""
        while sock.fileno() >= 0:
            try:
                await trio.lowlevel.wait_readable(sock)
                await frost.thawed()
                data, address = sock.recvfrom(LONGEST)
            except (BlockingIOError, ConnectionError):
                continue
            except (OSError, ValueError, trio.ClosedResourceError):
                return
            with contextlib.suppress(MalformedFrame):
                self._answer(sock, address, p.decode(data))

    def _answer(self, sock: socket.socket, address: Address, request: p.Frame) -> None:
        client = self._client(sock, address)
        exchange = client.exchange(request, p.Frame.encode_body)
        self._log.write(time.monotonic_ns(), "host", [(exchange.kind, exchange.request)])
        for reply in exchange.replies:
            self._send(sock, address, reply.kind, reply.data)

    def _client(self, sock: socket.socket, address: Address) -> Client:
        key = sock.fileno(), address
        if key not in self._clients:
            if len(self._clients) >= MOST_CLIENTS:
                del self._clients[next(iter(self._clients))]
            self._clients[key] = self._new_client(
                lambda frame: self._send(sock, address, "notification", frame.encode_body())
            )
        return self._clients[key]

    def _send(self, sock: socket.socket, address: Address, kind: str, data: bytes) -> None:
        self._log.write(time.monotonic_ns(), "robot", [(kind, data)])
        # A lost datagram is no error.
        with contextlib.suppress(OSError, ValueError):
            sock.sendto(data, address)
