"""The simulated drone's side of its link, one class for each kind of link: packets in, packets out. A packet
without a receiver is lost."""

from __future__ import annotations

import socket
from contextlib import suppress
from typing import Protocol

import trio

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.twin import PtyLine
from strands_actors.drivers.crazyflie import cpx
from strands_actors.drivers.crazyflie.protocol import LONGEST

SYNC_S = 0.1


class End(Protocol):
    @property
    def address(self) -> str: ...
    def plug(self) -> None: ...
    def unplug(self) -> None: ...
    def close(self) -> None: ...

    async def receive(self) -> bytes:
        """Return the next packet. Wait while the link is unplugged."""
        ...

    def send(self, packet: bytes) -> None: ...


class UdpEnd:
    """CRTP over UDP: one packet in each datagram. Answers go to the last sender."""

    def __init__(self, host: str, port: int) -> None:
        self._place = host, port
        self._sock: socket.socket | None = None
        self._plugged = trio.Event()
        self.peer: tuple[str, int] | None = None
        self.plug()

    @property
    def address(self) -> str:
        return f"{self._place[0]}:{self._place[1]}"

    def plug(self) -> None:
        if self._sock is None:
            self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._sock.setblocking(False)
            self._sock.bind(self._place)
            self._place = self._sock.getsockname()
            self._plugged.set()

    def unplug(self) -> None:
        if self._sock is not None:
            self._plugged = trio.Event()
            # When the simulation ends, no event loop runs any more.
            with suppress(RuntimeError):
                trio.lowlevel.notify_closing(self._sock)
            self._sock.close()
            self._sock = None

    def close(self) -> None:
        self.unplug()

    async def receive(self) -> bytes:
        while True:
            await self._plugged.wait()
            sock = self._sock
            # The link was cut again before this task ran.
            if sock is None:
                continue
            with suppress(OSError, ValueError, trio.ClosedResourceError):
                await trio.lowlevel.wait_readable(sock)
                data, self.peer = sock.recvfrom(LONGEST + 1)
                return data

    def send(self, packet: bytes) -> None:
        if self._sock is not None and self.peer is not None:
            with suppress(OSError):
                self._sock.sendto(packet, self.peer)


class TcpEnd:
    """CPX on TCP, for one client at a time: a new client replaces the last one."""

    def __init__(self, host: str, port: int) -> None:
        self._place = host, port
        self._listener: socket.socket | None = None
        self._client: socket.socket | None = None
        self._plugged = trio.Event()
        self._waiting: list[bytes] = []
        self._decoder = cpx.TcpDecoder()
        self.plug()

    @property
    def address(self) -> str:
        return f"tcp://{self._place[0]}:{self._place[1]}"

    def plug(self) -> None:
        if self._listener is None:
            self._listener = socket.create_server(self._place)
            self._listener.setblocking(False)
            self._place = self._listener.getsockname()
            self._plugged.set()

    def unplug(self) -> None:
        self._plugged = trio.Event()
        for sock in (self._client, self._listener):
            if sock is not None:
                with suppress(RuntimeError):
                    trio.lowlevel.notify_closing(sock)
                sock.close()
        self._client = self._listener = None

    def close(self) -> None:
        self.unplug()

    async def receive(self) -> bytes:
        while True:
            await trio.lowlevel.checkpoint()
            if self._waiting:
                return self._waiting.pop(0)
            await self._plugged.wait()
            with suppress(OSError, ValueError, trio.ClosedResourceError):
                async with trio.open_nursery() as nursery:
                    for sock in (self._listener, self._client):
                        if sock is not None:
                            nursery.start_soon(_wake, sock, nursery.cancel_scope)
                self._accept()
                self._read()

    def _accept(self) -> None:
        with suppress(BlockingIOError):
            if self._listener is not None:
                client, _ = self._listener.accept()
                client.setblocking(False)
                if self._client is not None:
                    self._client.close()
                self._client, self._decoder = client, cpx.TcpDecoder()

    def _read(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.recv(4096)
            packets = self._decoder.feed(data) if data else None
        except BlockingIOError:
            return
        except (OSError, MalformedFrame):
            packets = None
        if packets is None:
            self._client.close()
            self._client = None
            return
        self._waiting += _crtp(packets)

    def send(self, packet: bytes) -> None:
        if self._client is not None:
            with suppress(OSError):
                self._client.send(cpx.tcp_frame(cpx.packet(cpx.Function.CRTP, packet, to_robot=False)))


class SerialEnd:
    """CPX on a serial line. Every received frame is acknowledged at once."""

    def __init__(self) -> None:
        self._line = PtyLine()
        self._decoder = cpx.UartDecoder()
        self._waiting: list[bytes] = []
        self._synchronised = False
        self.plug()

    @property
    def address(self) -> str:
        return f"serial://{self._line.address}"

    def plug(self) -> None:
        self._line.plug()

    def unplug(self) -> None:
        self._synchronised = False
        self._line.unplug()

    def close(self) -> None:
        self._line.close()

    async def receive(self) -> bytes:
        while not self._waiting:
            with trio.move_on_after(SYNC_S) as silence:
                _, data = await self._line.receive()
                packets = self._decoder.feed(data)
                self._synchronised = self._synchronised or b"" in packets
                full = [packet for packet in packets if packet]
                for _ in full:
                    self._line.send(cpx.READY)
                self._waiting += _crtp(full)
            if silence.cancelled_caught and not self._synchronised:
                self._line.send(cpx.READY)
        return self._waiting.pop(0)

    def send(self, packet: bytes) -> None:
        if self._synchronised:
            self._line.send(cpx.uart_frame(cpx.packet(cpx.Function.CRTP, packet, to_robot=False)))


async def _wake(sock: socket.socket, scope: trio.CancelScope) -> None:
    await trio.lowlevel.wait_readable(sock)
    scope.cancel()


def _crtp(packets: list[bytes]) -> list[bytes]:
    """Return the CRTP packets for the firmware that are inside CPX packets. All other packets are dropped."""
    carried = []
    for packet in packets:
        with suppress(MalformedFrame):
            function, data = cpx.parse(packet)
            if function == cpx.Function.CRTP:
                carried.append(data)
    return carried
