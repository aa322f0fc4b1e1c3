"""A UDP socket as datagrams: writes that leave or fail, reads that wait under trio.

A connected socket takes datagrams of its peer alone; the kernel drops those of others. A datagram that nobody
listens for comes back as ``ECONNREFUSED`` on the next call, which is how a robot that was switched off is noticed
before its silence is.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
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


async def await_udp(port: int, host: str, is_peer: Callable[[bytes], bool]) -> UdpPort:
    """Wait at UDP ``port`` for a peer that speaks first, then talk to it alone.

    ``host``: its address, anybody's when empty; ``is_peer`` tells by a datagram whether it is one. What has come so
    far is dropped. Raise ``WireDown``.
    """
    peer, here = await _both_ends(host)
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.setblocking(False)
        sock.bind((here, port))
        while True:
            await trio.lowlevel.wait_readable(sock)
            try:
                data, address = sock.recvfrom(LARGEST)
            except BlockingIOError:
                continue
            if peer in ("", address[0]) and is_peer(data):
                sock.connect(address)
                found = UdpPort(sock, f"{address[0]}:{address[1]}")
                while found.read_waiting() is not None:
                    pass  # who spoke before the kernel knew the peer may be anybody
                return found
    except OSError as error:
        sock.close()
        raise WireDown(f"UDP port {port} cannot be used ({error.strerror}). Check who else has it") from None
    except BaseException:
        sock.close()
        raise


async def _both_ends(host: str) -> tuple[str, str]:
    """Return the numeric address of ``host`` and our own on the way to it; both empty when ``host`` is. Nothing is
    sent. Raise ``WireDown``."""
    if not host:
        return "", ""
    try:
        found = await trio.socket.getaddrinfo(host, 1, family=socket.AF_INET, type=socket.SOCK_DGRAM)
        address = found[0][4]
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.connect(address)
            return str(address[0]), str(sock.getsockname()[0])
    except (OSError, UnicodeError) as error:
        raise WireDown(f"{host}: no such address ({error}). Check port=") from None


def adopt_udp(fd: int, name: str) -> UdpPort:
    """Take over an open descriptor of a connected socket."""
    return UdpPort(socket.socket(fileno=fd), name)
