"""A unix socket as bytes: ``tcp_port.ByteStream`` to a path.

What was written before it is closed is still delivered: the peer's system has taken it. So a
command that waits in a peer that is frozen is carried out when that goes on, whoever is gone by
then.
"""

from __future__ import annotations

import socket

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.kernel.processes.reserve import RESERVE

from .tcp_port import TcpPort

CONNECT_S = 0.5
"""A peer whose queue of connections is full keeps us waiting: it is frozen."""

LONGEST_PATH = 100
"""Bytes of a path to a unix socket, with room: the system's limit is 108, 104 on macOS."""


async def open_unix(path: str) -> TcpPort:
    """Connect within ``CONNECT_S``. Raise ``WireDown``."""
    if len(path.encode()) > LONGEST_PATH:
        raise WireDown(f"{path}: a unix socket's path has {LONGEST_PATH} bytes at most. Choose a shorter one")
    why = f"no answer within {CONNECT_S:g} s"
    with trio.move_on_after(CONNECT_S):
        try:
            with trio.socket.socket(trio.socket.AF_UNIX, trio.socket.SOCK_STREAM) as sock:
                await sock.connect(path)
                plain = socket.socket(fileno=sock.detach())  # closing has no effect on it then
            plain.setblocking(False)
            return TcpPort(plain, path)
        except OSError as error:
            RESERVE.lacked(error)
            why = (error.strerror or type(error).__name__).lower()
    raise WireDown(f"{path}: cannot connect ({why}). Check that the service runs, and port=")
