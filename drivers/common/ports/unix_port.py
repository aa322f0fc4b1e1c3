"""Connect to a unix socket: a ``tcp_port.ByteStream`` at a path.

Data that was written before a close still arrives, because the peer's system has already received it. So a frozen
peer carries out a waiting command when it continues, even if the sender has ended.
"""

from __future__ import annotations

import socket

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from .tcp_port import TcpPort

CONNECT_S = 0.5
"""Timeout of a connect. A frozen peer with a full queue of connections keeps the connect waiting."""

LONGEST_PATH = 100
"""Most bytes of a path to a unix socket, with a reserve. The system's limit is 108, on macOS 104."""


async def open_unix(path: str) -> TcpPort:
    """Connect to the unix socket at ``path``, within ``CONNECT_S``.

    Raises:
        WireDown: The connect failed.
    """
    if len(path.encode()) > LONGEST_PATH:
        raise WireDown(f"{path}: a unix socket's path has {LONGEST_PATH} bytes at most. Choose a shorter one")
    reason = f"no answer within {CONNECT_S:g} s"
    with trio.move_on_after(CONNECT_S):
        try:
            with trio.socket.socket(trio.socket.AF_UNIX, trio.socket.SOCK_STREAM) as sock:
                await sock.connect(path)
                # ``sock`` no longer owns the descriptor, so the end of the block does not close the connection.
                plain = socket.socket(fileno=sock.detach())
            plain.setblocking(False)
            return TcpPort(plain, path)
        except OSError as error:
            RESERVE.lacked(error)
            reason = (error.strerror or type(error).__name__).lower()
    raise WireDown(f"{path}: cannot connect ({reason}). Check that the service runs, and port=")
