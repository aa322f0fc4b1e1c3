"""Tell systemd that the host is ready, and that it is alive (the protocol of sd_notify(3)).

Without systemd there is no ``NOTIFY_SOCKET``, and nothing is sent.
"""

from __future__ import annotations

import contextlib
import os
import socket

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
        """Send states in one datagram. A full or closed socket of systemd is no reason to end the host."""
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK
        with socket.socket(socket.AF_UNIX, kind) as sender, contextlib.suppress(OSError):
            sender.sendto("\n".join(states).encode(), address)
