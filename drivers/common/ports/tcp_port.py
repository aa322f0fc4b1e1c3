"""A TCP connection as bytes. A write is complete or fails; a read waits under trio.

The connection is closed with a reset, which throws away data that the peer has not taken yet. The system
does the same when the process is killed. After an orderly close the data would be delivered for minutes:
a setpoint would reach a robot after its cable was plugged in again. The system also gives a connection up when
its peer has taken nothing for ``UNTAKEN_S``. If another process has a duplicate of the socket, the death
of one process does not close it (``tcp_stall``).
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
    """The connection that a protocol needs. Every call raises ``WireDown`` once the connection is gone."""

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once, or raise. Nothing is kept for later, since that frame would
        leave late."""
        ...

    async def read(self) -> bytes:
        """Return at least one byte, as soon as there is one."""
        ...

    def close(self) -> None: ...


class OrderlyStream(ByteStream, Protocol):
    """A ``ByteStream`` on which a stop may be the last write."""

    def close_in_order(self) -> None:
        """As ``close``, but written data is still delivered."""
        ...


class TcpPort:
    """A ``ByteStream`` over a connected socket. It owns the socket."""

    def __init__(self, sock: socket.socket, name: str) -> None:
        self._sock = sock
        self.name = name

    def write(self, data: bytes) -> None:
        try:
            written = self._sock.send(data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            raise self._gone(error) from None
        if written != len(data):
            raise WireDown(
                f"{self.name}: output is blocked ({written} of {len(data)} bytes left). "
                "Check that the robot is alive, then reconnect"
            )

    async def read(self) -> bytes:
        while True:
            try:
                # Wait first, so that a peer that sends without a pause does not starve other tasks.
                await trio.lowlevel.wait_readable(self._sock)
            except (OSError, ValueError) as error:
                raise self._gone(error) from None
            data = self.read_waiting()
            if data is not None:
                return data

    def read_waiting(self) -> bytes | None:
        """Return bytes that have arrived; None if there are no bytes. Never waits.

        Raises:
            WireDown: The connection is gone.
        """
        try:
            data = self._sock.recv(READ_SIZE)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._gone(error) from None
        if not data:
            raise self._gone(None)
        return data

    def fileno(self) -> int:
        """Return the descriptor, to pass to another process. While that process has it open, ``close``
        does not end the connection."""
        return self._sock.fileno()

    def reset_if_stalled(self) -> bool:
        """Reset the connection if its data does not get through, so that nothing is delivered later.

        The reset acts for every process that has the connection open. Call it before a stop on another
        connection.

        Returns:
            True if the connection was reset.
        """
        if self._sock.fileno() < 0 or not tcp_stall.is_stalled(self._sock):
            return False
        with contextlib.suppress(OSError):  # The connection is gone already.
            tcp_stall.reset(self._sock)
        return True

    @property
    def own_host(self) -> str:
        """Our address on the route to the peer. Raises ``WireDown``."""
        try:
            return str(self._sock.getsockname()[0])
        except OSError as error:
            raise self._gone(error) from None

    @property
    def peer_host(self) -> str:
        """The peer's numeric address. Raises ``WireDown``."""
        try:
            return str(self._sock.getpeername()[0])
        except OSError as error:
            raise self._gone(error) from None

    def close(self) -> None:
        self._sock.close()

    def close_in_order(self) -> None:
        """As ``close``, but data that the peer has not taken yet is still delivered. Meant for a stop."""
        if self._sock.fileno() >= 0:
            self._sock.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 0, 0))
            _give_up_after(self._sock, 0.0)
        self._sock.close()

    def _gone(self, error: Exception | None) -> WireDown:
        if self._sock.fileno() < 0:
            return WireDown(f"{self.name}: the connection is closed. Reconnect")
        why = _words(error) if error else "the robot closed it"
        return WireDown(f"{self.name}: the connection is gone ({why}). Check cable and power, then reconnect")


class NobodyListens(WireDown):
    """The host refuses the connection, because no program has that port open."""


async def open_tcp(host: str, port: int) -> TcpPort:
    """Connect to the first of the host's addresses that accepts.

    Raises:
        WireDown: It failed within ``CONNECT_S``.
        NobodyListens: The last address refused the connection.
    """
    name = f"{host}:{port}"
    kind_of_end: type[WireDown] = WireDown
    why = f"no answer within {CONNECT_S:g} s"
    with trio.move_on_after(CONNECT_S):
        try:
            found = await look_up(host, port)
        except (OSError, UnicodeError) as error:
            RESERVE.lacked(error)
            found, why = [], _words(error)
        for family, kind, protocol, _, address in found:
            try:
                return TcpPort(await _connect(socket.socket(family, kind, protocol), address), name)
            except OSError as error:
                RESERVE.lacked(error)
                why = _words(error)
                kind_of_end = NobodyListens if isinstance(error, ConnectionRefusedError) else WireDown
    raise kind_of_end(f"{name}: cannot connect ({why}). Check port=, cable and power")


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
    """Make the system end a connection whose peer takes nothing for so long. With 0 the system's own
    timeout of minutes applies. Only Linux can do it."""
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is not None and sock.family != socket.AF_UNIX:
        sock.setsockopt(socket.IPPROTO_TCP, option, round(seconds * 1e3))


def _words(error: Exception) -> str:
    return str(error.args[-1]) if error.args else type(error).__name__
