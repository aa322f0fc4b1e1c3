"""Listen for browsers, and serve an application to them with hypercorn, until it is cancelled."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hypercorn.config import Config
from hypercorn.trio import serve as serve_asgi
from starlette.types import ASGIApp

from .certificates import Certificate

LOOPBACK = "127.0.0.1"
EVERYWHERE = "0.0.0.0"
LOCAL_NAMES = (LOOPBACK, "localhost")
"""Names of this computer for its own browsers."""
MAX_MESSAGE = 4096
"""Longest message of a page, in bytes."""
LEAVE_S = 1.0
"""How long open connections may take to end when the server ends."""


class CannotListen(OSError):
    """A port cannot be opened. The text has the port and the reason."""


class Door(NamedTuple):
    """A listening socket, with the names that visitors use.

    Attributes:
        listener: The socket.
        names: Names and addresses of this computer in the visitors' URLs.
        certificate: The certificate for encrypted connections; None for plain ones.
    """

    listener: socket.socket
    names: tuple[str, ...]
    certificate: Certificate | None = None

    @property
    def scheme(self) -> str:
        return "http" if self.certificate is None else "https"

    @property
    def port(self) -> int:
        port: int = self.listener.getsockname()[1]
        return port

    @property
    def hosts(self) -> list[str]:
        return [f"{name}:{self.port}" for name in self.names]

    @property
    def origins(self) -> list[str]:
        return [f"{self.scheme}://{host}" for host in self.hosts]


def open_door(
    stack: contextlib.ExitStack,
    address: str,
    port: int,
    names: tuple[str, ...],
    certificate: Certificate | None = None,
) -> Door:
    """Listen at an address until the stack ends.

    Args:
        stack: Closes the socket at its end.
        address: Address to listen at.
        port: Port; 0 for a free one.
        names: Names and addresses of this computer in the visitors' URLs.
        certificate: The certificate for encrypted connections; None for plain ones.

    Raises:
        CannotListen: The port is in use, or not allowed.
    """
    listener = stack.enter_context(socket.socket())
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((address, port))
        listener.listen()
    except OSError as error:
        raise CannotListen(f"port {port}: {error.strerror or error}") from error
    return Door(listener, names, certificate)


async def serve_doors(app: ASGIApp, doors: Sequence[Door], until: Callable[[], object]) -> None:
    """Serve an application until ``until`` returns, or until cancelled.

    Args:
        app: The application.
        doors: Where it listens. All encrypted ones have the same certificate.
        until: An asynchronous function. The server ends when it returns.
    """
    config = Config()
    config.accesslog = config.errorlog = None
    config.websocket_max_message_size = MAX_MESSAGE
    config.graceful_timeout = LEAVE_S
    # Hypercorn closes the descriptors that it gets.
    plain = [f"fd://{os.dup(door.listener.fileno())}" for door in doors if door.certificate is None]
    encrypted = [door for door in doors if door.certificate is not None]
    if not encrypted:
        config.bind = plain
    else:
        config.insecure_bind = plain
        config.bind = [f"fd://{os.dup(door.listener.fileno())}" for door in encrypted]
        certificate = encrypted[0].certificate
        assert certificate is not None
        config.certfile, config.keyfile = str(certificate.file), str(certificate.key)
    await serve_asgi(app, config, shutdown_trigger=until)  # type: ignore[arg-type]
