"""Tell systemd that the host is ready, and that it is alive (the protocol of sd_notify(3)).

Without systemd there is no ``NOTIFY_SOCKET``, and nothing is sent.
"""

from __future__ import annotations

import contextlib
import os
import socket

ROOM_S = 1.0
"""Longest wait for room in the socket of systemd."""
READY, STOPPING, ALIVE, RELOADING = "READY=1", "STOPPING=1", "WATCHDOG=1", "RELOADING=1"


class Notifier:
    """The connection to systemd.

    Args:
        environment: The environment of this process. The variables are removed from it, so that no child process
            speaks to systemd.
    """

    def __init__(self, environment: dict[str, str] | os._Environ[str] = os.environ) -> None:
        self._address = environment.pop("NOTIFY_SOCKET", "")
        environment.pop("WATCHDOG_USEC", None)
        environment.pop("WATCHDOG_PID", None)

    def send(self, *states: str) -> None:
        """Send states in one datagram.

        ``ALIVE`` is sent again soon, so it never waits. The other states are sent once, so they wait for room in
        the socket. A closed socket of systemd is no reason to end the host.
        """
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender, contextlib.suppress(OSError):
            sender.settimeout(0.0 if states == (ALIVE,) else ROOM_S)
            sender.sendto("\n".join(states).encode(), address)
