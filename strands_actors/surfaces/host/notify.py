"""Tell systemd that the host is ready, and that it is alive (the protocol of sd_notify(3)).

Without systemd there is no ``NOTIFY_SOCKET``, and nothing is sent.
"""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Mapping

READY, STOPPING, ALIVE, RELOADING = "READY=1", "STOPPING=1", "WATCHDOG=1", "RELOADING=1"


class Notifier:
    """The connection to systemd.

    Args:
        environment: The environment of this process. The variables are removed from it, so that no child process
            speaks to systemd.
    """

    def __init__(self, environment: dict[str, str] | os._Environ[str] = os.environ) -> None:
        self._address = environment.pop("NOTIFY_SOCKET", "")
        self.period_s = _watchdog_s(environment) / 3
        """How often systemd expects ``ALIVE``; 0 if it expects none. A third of its limit, so that one or two may
        be late."""
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


def _watchdog_s(environment: Mapping[str, str]) -> float:
    """Return the limit of systemd's watchdog for this process; 0 if it has none."""
    limit, pid = environment.get("WATCHDOG_USEC", ""), environment.get("WATCHDOG_PID", "")
    is_ours = not pid or pid == str(os.getpid())
    return int(limit) / 1e6 if limit.isdecimal() and is_ours else 0.0
