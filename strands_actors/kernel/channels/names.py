"""Look up the addresses of hosts, and remember them for a stop.

A look-up starts a thread and may wait for a server. A stop has no time for that, so it takes the last addresses
that this process found.
"""

from __future__ import annotations

import errno
import socket
from typing import Any

import trio

from strands_actors.kernel.processes.reserve import RESERVE, lacks_resources

Address = tuple[int, int, int, str, Any]
"""Family, kind, protocol, canonical name and address, as of ``getaddrinfo``."""

_addresses: dict[str, list[Address]] = {}


async def look_up(host: str, port: int) -> list[Address]:
    """Return the addresses of a TCP port, the best first.

    Raises:
        OSError: The name is not known, no server answers, or no thread can be started.
        UnicodeError: The text cannot be a name.
    """
    if not (RESERVE.is_freed and host in _addresses):
        try:
            _addresses[host] = list(await trio.socket.getaddrinfo(host, port, type=socket.SOCK_STREAM))
        except RuntimeError as error:
            if lacks_resources(error):
                raise OSError(errno.ENOMEM, str(error)) from error
            raise
    return [
        (family, socket_type, protocol, name, (address[0], port, *address[2:]))
        for family, socket_type, protocol, name, address in _addresses[host]
    ]
