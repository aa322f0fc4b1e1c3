"""A connection that another process still has open when its writer has died.

A writer's socket is closed with a reset when its process is killed, and what has not left is thrown
away. Not where a stop channel has a duplicate of the descriptor: the connection lives on, and the
kernel repeats for minutes what the dead process wrote, behind a stop that another connection has
carried. So whoever stops the robot resets a connection that does not get rid of its data. Linux alone
tells, and can do it.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import sys

STALLED_S = 0.06
"""A peer that has acknowledged nothing for so long takes nothing: TCP acknowledges within 40 ms, and
a network of robots is no further away than 20."""
_SIOCOUTQ, _SIOCOUTQNSD = 0x5411, 0x894B
"""Bytes that are not acknowledged, and those of them that were not sent. Source: tcp(7), sockios.h."""
_INFO = struct.Struct("8B13I")
"""Of tcp_info, in linux/tcp.h, as far as it is read here."""
_RETRANSMITS, _PROBES = 2, 3
_UNACKED, _LAST_SENT, _LAST_ACKNOWLEDGED = 8 + 4, 8 + 9, 8 + 12
_ADDRESS_OF_NOBODY = struct.pack("H14x", socket.AF_UNSPEC)


def is_stalled(sock: socket.socket) -> bool:
    """Return whether bytes that were written to a connected socket wait to be sent, or were sent and
    are not acknowledged in time."""
    if sys.platform != "linux" or sock.family == socket.AF_UNIX:
        return False
    try:
        if not _count(sock, _SIOCOUTQ):
            return False
        if _count(sock, _SIOCOUTQNSD):
            return True
        info = _INFO.unpack(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO.size))
    except OSError:  # it is closed
        return False
    if info[_RETRANSMITS] or info[_PROBES]:
        return True
    since_ms = info[_LAST_ACKNOWLEDGED] if info[_UNACKED] > 1 else info[_LAST_SENT]
    return bool(since_ms >= STALLED_S * 1e3)


def reset(sock: socket.socket) -> None:
    """Reset a connection for every process that has it open, and throw away what has not left. Raise
    ``OSError``.

    ``connect`` to the address family of nobody does so; ``close`` does not, as long as a duplicate is
    open. Source: connect(2), on dissolving an association."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.connect(sock.fileno(), _ADDRESS_OF_NOBODY, len(_ADDRESS_OF_NOBODY)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _count(sock: socket.socket, request: int) -> int:
    (count,) = struct.unpack("i", fcntl.ioctl(sock, request, bytes(4)))
    return int(count)
