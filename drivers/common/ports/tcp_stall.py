"""Reset a connection that another process still has open after its writer has died.

When a process is killed, the system closes its socket with a reset and throws away all data that has
not left. This fails if a stop channel has a duplicate of the descriptor: the connection lives on, and the
kernel repeats the dead process's data for minutes. It could arrive after a stop on another connection. So
the process that stops the robot resets a connection that does not get rid of its data. Only Linux can
report this state, and do the reset.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import socket
import struct
import sys

STALLED_S = 0.06
"""A peer that has acknowledged nothing for so long takes nothing. TCP acknowledges within 40 ms, and a
robot's network is at most 20 ms away."""
_SIOCOUTQ, _SIOCOUTQNSD = 0x5411, 0x894B
"""Requests for the number of bytes that are not acknowledged, and of those not sent yet. Source: tcp(7),
sockios.h."""
_INFO = struct.Struct("8B13I")
"""The first part of tcp_info, in linux/tcp.h."""
_RETRANSMITS, _PROBES = 2, 3
_UNACKED, _LAST_SENT, _LAST_ACKNOWLEDGED = 8 + 4, 8 + 9, 8 + 12
_ADDRESS_OF_NOBODY = struct.pack("H14x", socket.AF_UNSPEC)


def is_stalled(sock: socket.socket) -> bool:
    """Return True if written bytes of a connected socket wait to be sent, or are not acknowledged in
    time."""
    if sys.platform != "linux" or sock.family == socket.AF_UNIX:
        return False
    try:
        if not _count(sock, _SIOCOUTQ):
            return False
        if _count(sock, _SIOCOUTQNSD):
            return True
        info = _INFO.unpack(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO.size))
    except OSError:  # The socket is closed.
        return False
    if info[_RETRANSMITS] or info[_PROBES]:
        return True
    since_ms = info[_LAST_ACKNOWLEDGED] if info[_UNACKED] > 1 else info[_LAST_SENT]
    return bool(since_ms >= STALLED_S * 1e3)


def reset(sock: socket.socket) -> None:
    """Reset a connection for every process that has it open, and throw away all data that has not left.

    It calls ``connect`` with an address of family AF_UNSPEC. ``close`` has no effect while a duplicate
    is open. Source: connect(2), on dissolving an association.

    Raises:
        OSError: It failed.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.connect(sock.fileno(), _ADDRESS_OF_NOBODY, len(_ADDRESS_OF_NOBODY)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _count(sock: socket.socket, request: int) -> int:
    (count,) = struct.unpack("i", fcntl.ioctl(sock, request, bytes(4)))
    return int(count)
