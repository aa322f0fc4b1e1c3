"""Delay the requests of one client process, to test the order of requests in a simulated robot.

A real controller serves its clients one after the other. A request that waits in one client's queue may be carried
out after a newer request of another client. So a stop from the supervising process can overtake a request that the
killed process had sent before.
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
    """A delay: requests of the process ``pid`` are handled ``seconds`` after they arrive. With 0 s no request is
    delayed."""

    def __init__(self, pid: int = 0, seconds: float = 0.0) -> None:
        self._pid = pid
        self.seconds = seconds

    def of(self, sock: socket.socket) -> float:
        """Return the delay in seconds of requests on this connection."""
        if not self.seconds:
            return 0.0
        if sock.family == socket.AF_UNIX:
            credentials = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _PEER_CREDENTIALS.size)
            return self.seconds if _PEER_CREDENTIALS.unpack(credentials)[0] == self._pid else 0.0
        try:
            return self.of_address(sock.getpeername(), "tcp")
        except OSError:
            # The client has disconnected, so its requests are not delayed.
            return 0.0

    def of_address(self, address: tuple[str, int], table: str = "udp") -> float:
        """Return the delay in seconds of requests from this address. ``table`` is the protocol, ``tcp`` or
        ``udp``."""
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
    sockets: set[str] = set()
    try:
        for name in os.listdir(directory):
            try:
                sockets.add(os.readlink(f"{directory}/{name}"))
            except FileNotFoundError:
                continue  # The descriptor was closed meanwhile.
    except FileNotFoundError:
        # The client process has ended, so it has no sockets.
        return set()
    return sockets
