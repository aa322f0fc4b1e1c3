"""A TCP connection that reads and writes bytes. A write is complete or raises; a read waits under trio.

The connection is closed with a reset, which drops all data that the peer has not acknowledged. The system does the
same when the process is killed. After an orderly close, the system would try for minutes to deliver the data. A
setpoint could then reach a robot when its cable is plugged in again. The system also resets the connection if the
peer has acknowledged nothing for ``UNTAKEN_S``. If another process has a duplicate of the socket, the end of one
process does not close it (see ``tcp_stall``).
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from typing import Protocol

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.channels.names import look_up
from strands_actors.kernel.processes.reserve import RESERVE

from . import tcp_stall

CONNECT_S = 0.5
"""Timeout of a connect within a local network. TCP repeats a lost packet only after 1 s."""

UNTAKEN_S = 2.0
"""Longer than any wire here waits for its robot before it gives the link up."""

READ_SIZE = 4096
"""Most bytes that one read takes."""


class ByteStream(Protocol):
    """The methods of a connection that a protocol needs. Every call raises ``WireDown`` once the connection is
    lost."""

    def write(self, data: bytes) -> None:
        """Send all of ``data`` now, or raise. No part of it is sent later, because a late frame may do harm."""
        ...

    async def read(self) -> bytes:
        """Wait until at least one byte has arrived, and return the received bytes."""
        ...

    def close(self) -> None: ...


class OrderlyStream(ByteStream, Protocol):
    """A ``ByteStream`` that can be closed in such a way that a stop command, written before, still arrives."""

    def close_in_order(self) -> None:
        """Close the connection, but let the written data still arrive."""
        ...


class TcpPort:
    """A ``ByteStream`` on a connected socket. It owns the socket."""

    def __init__(self, sock: socket.socket, name: str) -> None:
        self._sock = sock
        self.name = name

    def write(self, data: bytes) -> None:
        try:
            written = self._sock.send(data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            raise self._wire_down(error) from None
        if written != len(data):
            raise WireDown(
                f"{self.name}: output is blocked (sent {written} of {len(data)} bytes). "
                "Check that the robot is alive, then reconnect"
            )

    async def read(self) -> bytes:
        while True:
            try:
                # Wait first, so that other tasks run even if the peer sends without a pause.
                await trio.lowlevel.wait_readable(self._sock)
            except (OSError, ValueError) as error:
                raise self._wire_down(error) from None
            data = self.read_waiting()
            if data is not None:
                return data

    def read_waiting(self) -> bytes | None:
        """Return bytes that have arrived; None if there are no bytes. Never waits.

        Raises:
            WireDown: The connection is lost.
        """
        try:
            data = self._sock.recv(READ_SIZE)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._wire_down(error) from None
        if not data:
            raise self._wire_down(None)
        return data

    def fileno(self) -> int:
        """Return the descriptor, to pass to another process. As long as that process has it open, ``close`` does
        not end the connection."""
        return self._sock.fileno()

    def reset_if_stalled(self) -> bool:
        """Reset the connection if the peer does not acknowledge the sent data, so that no data is delivered later.

        The reset acts for every process that has the connection open. Call it before a stop is sent on another
        connection.

        Returns:
            True if the connection was reset.
        """
        if self._sock.fileno() < 0 or not tcp_stall.is_stalled(self._sock):
            return False
        self.reset()
        return True

    def reset(self) -> None:
        """Reset the connection for every process that has it open, and drop all data that was not sent. The
        descriptor stays open until ``close``."""
        # The reset fails only if the connection has already ended.
        with contextlib.suppress(OSError):
            tcp_stall.reset(self._sock)

    @property
    def own_host(self) -> str:
        """This computer's address on the route to the peer. Raises ``WireDown``."""
        try:
            return str(self._sock.getsockname()[0])
        except OSError as error:
            raise self._wire_down(error) from None

    @property
    def peer_host(self) -> str:
        """The peer's numeric IP address. Raises ``WireDown``."""
        try:
            return str(self._sock.getpeername()[0])
        except OSError as error:
            raise self._wire_down(error) from None

    def close(self) -> None:
        self._sock.close()

    def close_in_order(self) -> None:
        """Close the connection, but let data that the peer has not acknowledged yet still arrive. Use it after a
        stop."""
        if self._sock.fileno() >= 0:
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))
            _give_up_after(self._sock, 0.0)
        self._sock.close()

    def _wire_down(self, error: Exception | None) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown(f"{self.name}: the connection is closed. Reconnect")
        reason = _words(error) if error else "the robot closed it"
        return WireDown(f"{self.name}: the connection is gone ({reason}). Check cable and power, then reconnect")


class NobodyListens(WireDown):
    """The host refuses the connection, because no program listens at this port."""


async def open_tcp(host: str, port: int) -> TcpPort:
    """Connect to a host. If it has several addresses, use the first that accepts.

    Raises:
        WireDown: The connect failed, or took longer than ``CONNECT_S``.
        NobodyListens: The last address refused the connection.
    """
    name = f"{host}:{port}"
    error_type: type[WireDown] = WireDown
    reason = f"no answer within {CONNECT_S:g} s"
    with trio.move_on_after(CONNECT_S):
        try:
            addresses = await look_up(host, port)
        except (OSError, UnicodeError) as error:
            RESERVE.lacked(error)
            addresses, reason = [], _words(error)
        for family, socket_type, protocol, _, address in addresses:
            try:
                return TcpPort(await _connect(socket.socket(family, socket_type, protocol), address), name)
            except OSError as error:
                RESERVE.lacked(error)
                reason = _words(error)
                error_type = NobodyListens if isinstance(error, ConnectionRefusedError) else WireDown
    raise error_type(f"{name}: cannot connect ({reason}). Check port=, cable and power")


async def _connect(sock: socket.socket, address: object) -> socket.socket:
    try:
        sock.setblocking(False)
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
        _give_up_after(sock, UNTAKEN_S)
        with contextlib.suppress(BlockingIOError):
            sock.connect(address)  # type: ignore[arg-type]  # what getaddrinfo gave for this family
        await trio.lowlevel.wait_writable(sock)
        if number := sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            raise OSError(number, os.strerror(number))
    except BaseException:
        sock.close()
        raise
    return sock


def _give_up_after(sock: socket.socket, seconds: float) -> None:
    """Let the system end the connection if the peer acknowledges nothing for this time. With 0 the system's default
    of minutes applies. Only Linux supports it."""
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is not None and sock.family != socket.AF_UNIX:
        sock.setsockopt(socket.IPPROTO_TCP, option, round(seconds * 1e3))


def _words(error: Exception) -> str:
    return str(error.args[-1]) if error.args else type(error).__name__
