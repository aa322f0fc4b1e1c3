"""Serve the console, and the e-stop in a separate thread."""

from __future__ import annotations

import contextlib
import functools
import os
import secrets
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import NamedTuple

import msgspec
import trio
from hypercorn.config import Config
from hypercorn.trio import serve as serve_asgi
from starlette.types import ASGIApp

from strands_actors.caller.processes.background import open_background
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.mesh.sync import estop_button

from .access import Access, Role
from .app import Console
from .certificates import Certificate
from .estop_page import Press, estop_app
from .guard import Guard
from .poses import Poses, poses_file
from .robots import Robots

LOOPBACK = "127.0.0.1"
EVERYWHERE = "0.0.0.0"
LOOK_S = 0.25
MAX_MESSAGE = 4096
"""Longest message of a page, in bytes."""
LEAVE_S = 1.0
"""How long open connections may take to end when the server ends."""
CODE_DIGITS = 8

CONSOLE_POLICY = (
    "default-src 'self'; img-src 'self' data:; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "frame-src {estop}; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
)
ESTOP_POLICY = (
    "default-src 'none'; style-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors {console}"
)


class CannotListen(Exception):
    """A port cannot be opened. The text has the port and the reason."""


class Lan(msgspec.Struct, frozen=True):
    """Serve other devices, too.

    Attributes:
        name: Name or address of this computer, as other devices reach it.
        certificate: The certificate for it.
    """

    name: str
    certificate: Certificate


class Serving(msgspec.Struct, frozen=True):
    """The addresses of a running server.

    Attributes:
        url: The console for this computer, with the token.
        estop: The e-stop for this computer.
        pairing: The console for another device, with a code for one operator; empty without --lan.
        fingerprint: Fingerprint of the certificate that other devices see.
    """

    url: str
    estop: str
    pairing: str = ""
    fingerprint: str = ""


class _Door(NamedTuple):
    """A listening socket, with the addresses that visitors use."""

    listener: socket.socket
    scheme: str
    names: tuple[str, ...]

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


async def serve(
    client: MeshClient,
    config: MeshConfig,
    port: int,
    lan: Lan | None,
    on_serving: Callable[[Serving], None],
) -> None:
    """Serve the console until cancelled.

    Args:
        client: The client of the mesh.
        config: The configuration of the mesh.
        port: Port of the console. The e-stop gets the next one, other devices the two after it. 0: free ones.
        lan: Serve other devices, too; None for this computer only.
        on_serving: Called with the addresses once the server listens.

    Raises:
        CannotListen: A port is in use, or not allowed.
    """
    with contextlib.ExitStack() as stack:
        ports = [port + number if port else 0 for number in range(4)]
        pages, stops = [_open(stack, ports[0])], [_open(stack, ports[1])]
        if lan is not None:
            pages.append(_open(stack, ports[2], lan))
            stops.append(_open(stack, ports[3], lan))
        access = Access(f"console_{pages[0].port}", lambda: secrets.token_urlsafe(32), _code)
        access.serve_at([host for door in (*pages, *stops) for host in door.hosts])
        press = stack.enter_context(estop_button(mesh=config, by="console"))
        origins = " ".join(origin for door in pages for origin in door.origins)
        stack.enter_context(_stopping(press, access, stops, ESTOP_POLICY.format(console=origins), lan))
        robots = Robots(time.monotonic)
        robots.watch(client)
        pairing = f"{pages[1].origins[0]}/pair" if lan is not None else ""
        fingerprint = lan.certificate.fingerprint if lan is not None else ""
        estop_of = functools.partial(_beside, pages, stops)
        console = Console(client, config, robots, Poses(poses_file()), access, estop_of, pairing, fingerprint)
        policy = CONSOLE_POLICY.format(estop=" ".join(origin for door in stops for origin in door.origins))
        async with open_background() as nursery:
            nursery.start_soon(_keep_looking, robots)
            offered = f"{pairing}?code={access.offer(Role.OPERATOR, time.time())}" if pairing else ""
            url = f"{pages[0].origins[0]}/?token={access.token}"
            on_serving(Serving(url, f"{stops[0].origins[0]}/estop", offered, fingerprint))
            await _run(Guard(console.app(), access, policy), pages, lan, trio.sleep_forever)


@contextlib.contextmanager
def _stopping(press: Press, access: Access, doors: list[_Door], policy: str, lan: Lan | None) -> Iterator[None]:
    """Serve the e-stop in a separate thread while the block runs."""
    app = Guard(estop_app(press), access, policy)
    starting: Future[Callable[[], None]] = Future()

    async def run() -> None:
        ended, token = trio.Event(), trio.lowlevel.current_trio_token()
        starting.set_result(lambda: token.run_sync_soon(ended.set))
        await _run(app, doors, lan, ended.wait)

    thread = threading.Thread(target=trio.run, args=(run,), name="the console's e-stop", daemon=True)
    thread.start()
    end = starting.result()
    try:
        yield
    finally:
        end()
        thread.join()


async def _run(app: ASGIApp, doors: list[_Door], lan: Lan | None, until: Callable[[], object]) -> None:
    config = Config()
    config.accesslog = config.errorlog = None
    config.websocket_max_message_size = MAX_MESSAGE
    config.graceful_timeout = LEAVE_S
    # Hypercorn closes the descriptors that it gets.
    binds = [f"fd://{os.dup(door.listener.fileno())}" for door in doors]
    if lan is None:
        config.bind = binds
    else:
        config.insecure_bind, config.bind = binds[:1], binds[1:]
        config.certfile, config.keyfile = str(lan.certificate.file), str(lan.certificate.key)
    await serve_asgi(app, config, shutdown_trigger=until)  # type: ignore[arg-type]


async def _keep_looking(robots: Robots) -> None:
    while True:
        await trio.sleep(LOOK_S)
        robots.look()


def _open(stack: contextlib.ExitStack, port: int, lan: Lan | None = None) -> _Door:
    listener = stack.enter_context(socket.socket())
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((LOOPBACK if lan is None else EVERYWHERE, port))
        listener.listen()
    except OSError as error:
        raise CannotListen(f"port {port}: {error.strerror or error}") from error
    names = (LOOPBACK, "localhost") if lan is None else (lan.name,)
    return _Door(listener, "http" if lan is None else "https", names)


def _beside(pages: list[_Door], stops: list[_Door], scheme: str, host: str) -> str:
    """Return the address of the e-stop for a visitor of the console, under the same host name."""
    secure = scheme == "https"
    name = host.rpartition(":")[0]
    return f"{scheme}://{name}:{stops[1 if secure else 0].port}/estop"


def _code() -> str:
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"
