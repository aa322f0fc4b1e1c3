"""A UDP socket that reads and writes datagrams. A write is sent or raises; a read waits under trio.

``UdpPort`` sends to a known peer, ``UdpListener`` waits for a peer that sends first.

A connected socket receives datagrams of its peer only; the kernel drops all others. If no program listens at the
peer's port, the next call fails with ``ECONNREFUSED``. So a program that has ended on the robot is noticed before a
timeout.
"""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Protocol

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

LARGEST = 65535
MOST_STRANGERS = 64
"""Most datagrams of other senders that one read drops."""


class DatagramPort(Protocol):
    """The methods of a UDP socket that a protocol needs. Every call raises ``WireDown`` if the socket cannot be
    used."""

    def write(self, data: bytes) -> None:
        """Send one datagram now, or raise."""
        ...

    async def read(self) -> bytes:
        """Wait for the next datagram, and return it."""
        ...

    def read_waiting(self) -> bytes | None:
        """Return a datagram that has arrived; None if there is none. Never waits."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class UdpPort:
    """A ``DatagramPort`` on a socket that is connected to one peer. It owns the socket."""

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
            raise self._wire_down(error) from None

    async def read(self) -> bytes:
        # Let other tasks run, even if datagrams arrive without a pause.
        await trio.lowlevel.checkpoint()
        while True:
            data = self.read_waiting()
            if data is not None:
                return data
            try:
                await trio.lowlevel.wait_readable(self._sock)
            except (OSError, ValueError, trio.ClosedResourceError) as error:
                raise self._wire_down(error) from None

    def read_waiting(self) -> bytes | None:
        try:
            return self._sock.recv(LARGEST)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._wire_down(error) from None

    def fileno(self) -> int:
        return self._sock.fileno()

    def close(self) -> None:
        self._sock.close()

    def _wire_down(self, error: Exception) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown(f"{self.name}: the socket is closed. Reconnect")
        reason = str(error.args[-1]) if error.args else type(error).__name__
        return WireDown(
            f"{self.name}: not reachable ({reason}). Check its address, cable and power, then reconnect"
        )


def open_udp(host: str, port: int, from_host: str = "", from_port: int = 0) -> UdpPort:
    """Open a socket that exchanges datagrams with ``host:port`` only. Nothing is sent yet.

    Args:
        host: Name or address of the peer.
        port: The peer's port.
        from_host: The local address. The default is any.
        from_port: The local port. The default is any.

    Raises:
        WireDown: There is no such address, or the socket cannot be opened.
    """
    name = f"{host}:{port}"
    try:
        family, socket_type, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        sock = socket.socket(family, socket_type, protocol)
    except (OSError, UnicodeError) as error:
        RESERVE.lacked(error)
        raise WireDown(f"{name}: no such address ({error}). Check port=") from None
    try:
        if from_host or from_port:
            sock.bind((from_host, from_port))
        sock.connect(address)
        return UdpPort(sock, name)
    except OSError as error:
        sock.close()
        raise WireDown(
            f"{name}: cannot be opened ({error.strerror}). Check port=, and which program uses it"
        ) from None


class UdpListener:
    """A ``DatagramPort`` whose peer sends first. It owns its socket.

    The socket is not connected to the peer. So after the peer is lost, the same socket can wait for it again.

    Args:
        sock: A bound socket.
        host: The peer's numeric address. An empty text accepts any sender.
    """

    def __init__(self, sock: socket.socket, host: str = "") -> None:
        sock.setblocking(False)
        self._sock = sock
        self._host = host
        self._peer: tuple[str, int] | None = None

    @property
    def name(self) -> str:
        """The address of the peer; the local address as long as no peer is known."""
        host, port = self._peer or self._sock.getsockname()
        return f"{host}:{port}"

    async def meet(self, is_peer: Callable[[bytes], bool]) -> None:
        """Wait for a peer. From then on only its datagrams are received; until then ``write`` sends to the previous
        peer.

        Args:
            is_peer: Return True if a datagram comes from a valid peer.

        Raises:
            WireDown: The socket cannot be used.
        """
        while True:
            await trio.lowlevel.checkpoint()
            received = self._receive()
            if received is None:
                await self._wait()
            elif self._host in ("", received[1][0]) and is_peer(received[0]):
                self._peer = received[1]
                return

    def write(self, data: bytes) -> None:
        if self._peer is None:
            raise WireDown(f"{self.name}: no datagram has arrived yet, so the robot's address is unknown")
        try:
            self._sock.sendto(data, self._peer)
        except BlockingIOError:
            raise WireDown(f"{self.name}: output is blocked. Check the network, then reconnect") from None
        except OSError as error:
            raise self._wire_down(error) from None

    async def read(self) -> bytes:
        # Let other tasks run, even if datagrams arrive without a pause.
        await trio.lowlevel.checkpoint()
        while (data := self.read_waiting()) is None:
            await self._wait()
        return data

    def read_waiting(self) -> bytes | None:
        for _ in range(MOST_STRANGERS):
            received = self._receive()
            if received is None or received[1] == self._peer:
                return None if received is None else received[0]
        return None

    def fileno(self) -> int:
        return self._sock.fileno()

    def close(self) -> None:
        self._sock.close()

    def _receive(self) -> tuple[bytes, tuple[str, int]] | None:
        try:
            return self._sock.recvfrom(LARGEST)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._wire_down(error) from None

    async def _wait(self) -> None:
        try:
            await trio.lowlevel.wait_readable(self._sock)
        except (OSError, ValueError, trio.ClosedResourceError) as error:
            raise self._wire_down(error) from None

    def _wire_down(self, error: Exception) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown("the UDP socket is closed. Reconnect")
        return WireDown(f"{self.name}: the UDP port cannot be used ({error.args[-1]}). Check the network")


async def listen_udp(port: int, host: str = "") -> UdpListener:
    """Bind a socket for a peer that sends first. Nothing is sent.

    Args:
        port: The local port.
        host: The only accepted sender. The socket is bound to the local address on the route to it. An empty text
            accepts any sender, on all local addresses.

    Raises:
        WireDown: The socket cannot be opened, or there is no such host.
    """
    peer = own_host = ""
    try:
        if host:
            addresses = await trio.socket.getaddrinfo(host, 1, family=socket.AF_INET, type=socket.SOCK_DGRAM)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.connect(addresses[0][4])
                peer, own_host = str(probe.getpeername()[0]), str(probe.getsockname()[0])
    except (OSError, UnicodeError) as error:
        RESERVE.lacked(error)
        raise WireDown(f"{host}: no such address ({error}). Check port=") from None
    try:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        RESERVE.lacked(error)
        raise WireDown(f"UDP port {port} cannot be opened ({error.strerror}). Close other programs") from None
    try:
        sock.bind((own_host, port))
    except OSError as error:
        sock.close()
        raise WireDown(f"UDP port {port} cannot be opened ({error.strerror}). Another program may use it") from None
    return UdpListener(sock, peer)
