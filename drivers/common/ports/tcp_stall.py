"""Reset a connection that another process still has open after the writing process has ended.

When a process is killed, the system usually resets its sockets and drops all data that was not sent. This does not
happen if the process that stops the robot has a duplicate of the descriptor. The connection then stays open, and
the kernel repeats the dead process's data for minutes. This data could arrive after a stop on another connection.
So the stopping process resets a connection whose data is not acknowledged. Only Linux can report this state, and do
the reset.
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
    """Return True if data written to a connected socket was not sent yet, or was not acknowledged in time."""
    if sys.platform != "linux" or sock.family == socket.AF_UNIX:
        return False
    try:
        if not _count(sock, _SIOCOUTQ):
            return False
        if _count(sock, _SIOCOUTQNSD):
            return True
        info = _INFO.unpack(sock.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _INFO.size))
    # This fails only if the socket is closed, so no data waits in it.
    except OSError:
        return False
    if info[_RETRANSMITS] or info[_PROBES]:
        return True
    since_ms = info[_LAST_ACKNOWLEDGED] if info[_UNACKED] > 1 else info[_LAST_SENT]
    return bool(since_ms >= STALLED_S * 1e3)


def reset(sock: socket.socket) -> None:
    """Reset a connection for every process that has it open, and drop all data that was not sent.

    ``close`` has no effect while another process has a duplicate. So this function calls ``connect`` with an
    address of family AF_UNSPEC. Source: connect(2), on dissolving an association.

    Raises:
        OSError: The reset failed.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.connect(sock.fileno(), _ADDRESS_OF_NOBODY, len(_ADDRESS_OF_NOBODY)):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()))


def _count(sock: socket.socket, request: int) -> int:
    (count,) = struct.unpack("i", fcntl.ioctl(sock, request, bytes(4)))
    return int(count)
