"""Delay the handling of one process's requests.

A controller serves its clients one after the other. A request that waits in one client's queue is
then carried out after a newer request of another client. In this way a stop of the root can overtake
a request that the wire process sent before it was killed.
"""

from __future__ import annotations

import os
import socket
import struct
import sys

_PEER_CREDENTIALS = struct.Struct("3i")
_LOCAL, _INODE = 1, 9
"""Columns of /proc/net/tcp and /proc/net/udp, see proc(5)."""


class Lateness:
    """The requests of process ``pid`` are handled ``seconds`` after they arrive; with 0 s none is
    delayed."""

    def __init__(self, pid: int = 0, seconds: float = 0.0) -> None:
        self._pid = pid
        self.seconds = seconds

    def of(self, sock: socket.socket) -> float:
        """Return the delay of this connection's requests in seconds."""
        if not self.seconds:
            return 0.0
        if sock.family == socket.AF_UNIX:
            credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
            return self.seconds if _PEER_CREDENTIALS.unpack(credentials)[0] == self._pid else 0.0
        try:
            return self.of_address(sock.getpeername(), "tcp")
        except OSError:
            return 0.0  # the client is gone

    def of_address(self, address: tuple[str, int], table: str = "udp") -> float:
        """Return the delay of requests from this address in seconds. ``table`` is ``tcp`` or ``udp``."""
        if not self.seconds:
            return 0.0
        host, port = address[:2]
        place = f"{int.from_bytes(socket.inet_aton(host), sys.byteorder):08X}:{port:04X}"
        with open(f"/proc/net/{table}") as rows:
            columns = [row.split() for row in rows.readlines()[1:]]
        sockets = {f"socket:[{row[_INODE]}]" for row in columns if row[_LOCAL] in (place, f"00000000:{port:04X}")}
        return self.seconds if sockets & _sockets_of(self._pid) else 0.0


def _sockets_of(pid: int) -> set[str]:
    directory = f"/proc/{pid}/fd"
    found: set[str] = set()
    try:
        for name in os.listdir(directory):
            try:
                found.add(os.readlink(f"{directory}/{name}"))
            except FileNotFoundError:
                continue  # The descriptor was closed meanwhile.
    except FileNotFoundError:
        return set()  # The process has ended.
    return found
