"""A TCP connection as bytes: writes that are complete or fail, reads that wait under trio.

It is closed with a reset, by the system too when its process is killed: what has not been taken yet
is thrown away. After an orderly close it would go on being delivered for minutes, a setpoint to a
robot whose cable was put back. The system also gives a connection up when its peer has taken nothing
for ``UNTAKEN_S``: where another process has a duplicate of the socket, a death does not close it
(``tcp_stall``).
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
"""Within a local network; the first repetition of a lost packet would come after 1 s."""

UNTAKEN_S = 2.0
"""Longer than any wire here waits for its robot before it gives the link up."""

READ_SIZE = 4096
"""Bytes that one read takes."""


class ByteStream(Protocol):
    """What a protocol needs of its connection. Everything raises ``WireDown`` once it is gone."""

    def write(self, data: bytes) -> None:
        """Hand over all of ``data`` at once, or raise: a frame that waits is a frame that leaves
        late."""
        ...

    async def read(self) -> bytes:
        """At least one byte, as soon as there is one."""
        ...

    def close(self) -> None: ...


class OrderlyStream(ByteStream, Protocol):
    """A ``ByteStream`` on which a stop may be the last thing that is written."""

    def close_in_order(self) -> None:
        """As ``close``, but what was written is still delivered."""
        ...


class TcpPort:
    """A ``ByteStream`` over a connected socket. Closes it."""

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
                await trio.lowlevel.wait_readable(self._sock)  # first: a peer that never stops talking yields, too
            except (OSError, ValueError) as error:
                raise self._gone(error) from None
            data = self.read_waiting()
            if data is not None:
                return data

    def read_waiting(self) -> bytes | None:
        """Return bytes that are already there, else None. Never waits. Raise ``WireDown``."""
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
        """To be given to another process. While that has it, ``close`` does not end the
        connection."""
        return self._sock.fileno()

    def reset_if_stalled(self) -> bool:
        """Reset the connection for every process that has it open, where it does not get rid of what
        was written to it: nothing of that is delivered any more. For who stops a robot by another
        connection. Return whether it was reset."""
        if self._sock.fileno() < 0 or not tcp_stall.is_stalled(self._sock):
            return False
        with contextlib.suppress(OSError):  # it is gone already
            tcp_stall.reset(self._sock)
        return True

    @property
    def own_host(self) -> str:
        """Return our address on the way to the peer. Raise ``WireDown``."""
        try:
            return str(self._sock.getsockname()[0])
        except OSError as error:
            raise self._gone(error) from None

    @property
    def peer_host(self) -> str:
        """Return the peer's address as a number. Raise ``WireDown``."""
        try:
            return str(self._sock.getpeername()[0])
        except OSError as error:
            raise self._gone(error) from None

    def close(self) -> None:
        self._sock.close()

    def close_in_order(self) -> None:
        """As ``close``, but what has not been taken yet is still delivered: for a stop."""
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
    """The host refuses the connection: no program has that port open."""


async def open_tcp(host: str, port: int) -> TcpPort:
    """Connect within ``CONNECT_S`` to the first of the host's addresses that takes it. Raise
    ``WireDown``; ``NobodyListens`` where the last of them refuses."""
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
    """Have the system end a connection whose peer takes nothing for so long; 0: as it usually does,
    after minutes. Linux alone can."""
    option = getattr(socket, "TCP_USER_TIMEOUT", None)
    if option is not None and sock.family != socket.AF_UNIX:
        sock.setsockopt(socket.IPPROTO_TCP, option, round(seconds * 1e3))


def _words(error: Exception) -> str:
    return str(error.args[-1]) if error.args else type(error).__name__
