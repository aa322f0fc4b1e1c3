"""Choose a port for a server that a test starts later."""

from __future__ import annotations

import random
import socket

BELOW_EPHEMERAL = range(20_000, 32_000)
"""Linux gives ports from 32768 on to sockets that ask for any port. So between this choice and the start of the
server, no test that runs beside takes the port by chance."""


def free_port(kind: socket.SocketKind = socket.SOCK_STREAM) -> int:
    """Return a port of every address of this host that no socket of this kind has bound."""
    while True:
        port = random.choice(BELOW_EPHEMERAL)
        with socket.socket(socket.AF_INET, kind) as probe:
            try:
                probe.bind(("0.0.0.0", port))
            except OSError:
                continue
        return port
