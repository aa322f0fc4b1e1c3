"""A UDP socket as datagrams: writes that leave or fail, reads that wait under trio.

A connected socket takes datagrams of its peer alone; the kernel drops those of others. A datagram that nobody
listens for comes back as ``ECONNREFUSED`` on the next call, which is how a robot that was switched off is noticed
before its silence is.
"""

from __future__ import annotations

import socket
from typing import Protocol

import trio

from strands_actors.runtime.contract import WireDown

LARGEST = 65535


class DatagramPort(Protocol):
    """What a protocol needs of its socket. Everything raises ``WireDown`` once it cannot be used."""

    def write(self, data: bytes) -> None:
        """Send one datagram now, or raise."""
        ...

    async def read(self) -> bytes:
        """Return the next datagram."""
        ...

    def read_waiting(self) -> bytes | None:
        """Return a datagram that is already there, else None. Never waits."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class UdpPort:
    """A ``DatagramPort`` over a connected socket. Closes it."""

    def __init__(self, sock: socket.socket, name: str) -> None:
        sock.setblocking(False)
        self._sock = sock
        self.name = name

    def write(self, data: bytes) -> None:
        try:
            self._sock.send(data)
        except BlockingIOError:
            raise WireDown(f"{self.name}: output is blocked. Check the network, then reconnect") from None
        except OSError as error:
            raise self._gone(error) from None

    async def read(self) -> bytes:
        while True:
            data = self.read_waiting()
            if data is not None:
                return data
            try:
                await trio.lowlevel.wait_readable(self._sock)
            except (OSError, ValueError, trio.ClosedResourceError) as error:
                raise self._gone(error) from None

    def read_waiting(self) -> bytes | None:
        try:
            return self._sock.recv(LARGEST)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._gone(error) from None

    def fileno(self) -> int:
        return self._sock.fileno()

    def close(self) -> None:
        self._sock.close()

    def _gone(self, error: Exception) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown(f"{self.name}: the socket is closed. Reconnect")
        why = str(error.args[-1]) if error.args else type(error).__name__
        return WireDown(f"{self.name}: not reachable ({why}). Check its address, cable and power, then reconnect")


def open_udp(host: str, port: int, from_host: str = "", from_port: int = 0) -> UdpPort:
    """Open a socket that talks to ``host:port`` alone; ``from_host``, ``from_port``: our own end, any when empty.
    Raise ``WireDown``. Nothing is sent."""
    name = f"{host}:{port}"
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        sock = socket.socket(family, kind, protocol)
    except (OSError, UnicodeError) as error:
        raise WireDown(f"{name}: no such address ({error}). Check port=") from None
    try:
        if from_host or from_port:
            sock.bind((from_host, from_port))
        sock.connect(address)
        return UdpPort(sock, name)
    except OSError as error:
        sock.close()
        raise WireDown(f"{name}: cannot be opened ({error.strerror}). Check port=, and who else has it") from None
