"""A UDP socket as datagrams. A write leaves or fails; a read waits under trio.

``UdpPort`` talks to a known peer, ``UdpListener`` to a peer that speaks first.

A connected socket receives datagrams of its peer only; the kernel drops all others. If no program
listens at the peer's port, the next call fails with ``ECONNREFUSED``. That shows a robot that was switched
off sooner than its silence does.
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
    """The socket that a protocol needs. Every call raises ``WireDown`` once the socket cannot be used."""

    def write(self, data: bytes) -> None:
        """Send one datagram now, or raise."""
        ...

    async def read(self) -> bytes:
        """Return the next datagram."""
        ...

    def read_waiting(self) -> bytes | None:
        """Return a datagram that has arrived; None if there is none. Never waits."""
        ...

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class UdpPort:
    """A ``DatagramPort`` over a connected socket. It owns the socket."""

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
        await trio.lowlevel.checkpoint()  # A flood of datagrams must not starve other tasks.
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
    """Open a socket that talks to ``host:port`` only. Nothing is sent.

    Args:
        host: Name or address of the peer.
        port: Its port.
        from_host: Our own address. The default is any.
        from_port: Our own port. The default is any.

    Raises:
        WireDown: There is no such address, or the socket cannot be opened.
    """
    name = f"{host}:{port}"
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        sock = socket.socket(family, kind, protocol)
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
        raise WireDown(f"{name}: cannot be opened ({error.strerror}). Check port=, and who else has it") from None


class UdpListener:
    """A ``DatagramPort`` whose peer speaks first. It owns its socket.

    The socket is not connected, so it can be kept when the peer is lost and awaited again.

    Args:
        sock: A bound socket.
        host: The peer's numeric address. Empty accepts any sender.
    """

    def __init__(self, sock: socket.socket, host: str = "") -> None:
        sock.setblocking(False)
        self._sock = sock
        self._host = host
        self._peer: tuple[str, int] | None = None

    @property
    def name(self) -> str:
        """The address of the peer; before there is one, our own."""
        host, port = self._peer or self._sock.getsockname()
        return f"{host}:{port}"

    async def meet(self, is_peer: Callable[[bytes], bool]) -> None:
        """Wait for a peer, and receive only its datagrams from then on. Until then ``write`` sends to the
        previous peer.

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
            raise WireDown(f"{self.name}: nobody has spoken yet")
        try:
            self._sock.sendto(data, self._peer)
        except BlockingIOError:
            raise WireDown(f"{self.name}: output is blocked. Check the network, then reconnect") from None
        except OSError as error:
            raise self._gone(error) from None

    async def read(self) -> bytes:
        await trio.lowlevel.checkpoint()  # A flood of datagrams must not starve other tasks.
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
            raise self._gone(error) from None

    async def _wait(self) -> None:
        try:
            await trio.lowlevel.wait_readable(self._sock)
        except (OSError, ValueError, trio.ClosedResourceError) as error:
            raise self._gone(error) from None

    def _gone(self, error: Exception) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown("the UDP socket is closed. Reconnect")
        return WireDown(f"{self.name}: the UDP port cannot be used ({error.args[-1]}). Check the network")


async def listen_udp(port: int, host: str = "") -> UdpListener:
    """Bind a socket for a peer that speaks first. Nothing is sent.

    Args:
        port: Our port.
        host: The only accepted sender; the socket is bound to our address on the route to it. Empty
            accepts any sender, at all our addresses.

    Raises:
        WireDown: The socket cannot be opened, or there is no such host.
    """
    peer = here = ""
    try:
        if host:
            found = await trio.socket.getaddrinfo(host, 1, family=socket.AF_INET, type=socket.SOCK_DGRAM)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.connect(found[0][4])
                peer, here = str(probe.getpeername()[0]), str(probe.getsockname()[0])
    except (OSError, UnicodeError) as error:
        RESERVE.lacked(error)
        raise WireDown(f"{host}: no such address ({error}). Check port=") from None
    try:
        sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    except OSError as error:
        RESERVE.lacked(error)
        raise WireDown(f"UDP port {port} cannot be opened ({error.strerror}). Close other programs") from None
    try:
        sock.bind((here, port))
    except OSError as error:
        sock.close()
        raise WireDown(f"UDP port {port} cannot be opened ({error.strerror}). Check who else has it") from None
    return UdpListener(sock, peer)
