"""Serve the console, and the e-stop in a separate thread."""

from __future__ import annotations

import contextlib
import functools
import secrets
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import NamedTuple

import msgspec
import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.caller.processes.run_directory import data_dir
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.config import MeshConfig
from strands_actors.surfaces.mesh.sync import estop_button

from .access import Access, Role
from .agent import AgentPanel
from .app import Console
from .certificates import Certificate
from .consent import Consents
from .doors import EVERYWHERE, LOCAL_NAMES, LOOPBACK, CannotListen, Door, open_door, serve_doors
from .estop_page import Press, estop_app
from .guard import Guard
from .poses import Poses, poses_file
from .recorders import Recorders
from .robots import Robots

LOOK_S = 0.25
CODE_DIGITS = 8

CONSOLE_POLICY = (
    "default-src 'self'; img-src 'self' data:; style-src 'self'; script-src 'self'; connect-src 'self'; "
    "frame-src {estop}; base-uri 'none'; form-action 'self'; frame-ancestors 'none'; object-src 'none'"
)
ESTOP_POLICY = (
    "default-src 'none'; style-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors {console}"
)


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


class ChosenAgent(NamedTuple):
    """The agent of the console.

    Attributes:
        factory: ``module:function`` of the user; empty for no agent.
        mesh: The file that configures the mesh for it; empty for the robots of this user.
    """

    factory: str = ""
    mesh: str = ""


NO_AGENT = ChosenAgent()
NO_MODELS: Mapping[str, str] = {}


async def serve(
    client: MeshClient,
    config: MeshConfig,
    port: int,
    lan: Lan | None,
    on_serving: Callable[[Serving], None],
    recordings: Path | None = None,
    agent: ChosenAgent = NO_AGENT,
    models: Mapping[str, str] = NO_MODELS,
) -> None:
    """Serve the console until cancelled.

    Args:
        client: The client of the mesh.
        config: The configuration of the mesh.
        port: Port of the console. The e-stop gets the next one, other devices the two after it. 0: free ones.
        lan: Serve other devices, too; None for this computer only.
        on_serving: Called with the addresses once the server listens.
        recordings: Folder of datasets and recordings; None for the usual one of this user.
        agent: The agent of the console.
        models: Model files of the user (MJCF or URDF), by name of the robot.

    Raises:
        CannotListen: A port is in use, or not allowed.
    """
    with contextlib.ExitStack() as stack:
        ports = [port + number if port else 0 for number in range(4)]
        pages, stops = ([open_door(stack, LOOPBACK, port, LOCAL_NAMES)] for port in ports[:2])
        if lan is not None:
            for doors, port in ((pages, ports[2]), (stops, ports[3])):
                doors.append(open_door(stack, EVERYWHERE, port, (lan.name,), lan.certificate))
        access = Access(f"console_{pages[0].port}", lambda: secrets.token_urlsafe(32), _code)
        access.serve_at([host for door in (*pages, *stops) for host in door.hosts])
        press = stack.enter_context(estop_button(mesh=config, by="console"))
        origins = " ".join(origin for door in pages for origin in door.origins)
        stack.enter_context(_stopping(press, access, stops, ESTOP_POLICY.format(console=origins)))
        robots = Robots(time.monotonic)
        robots.watch(client)
        pairing = f"{pages[1].origins[0]}/pair" if lan is not None else ""
        fingerprint = lan.certificate.fingerprint if lan is not None else ""
        estop_of = functools.partial(_beside, pages, stops)
        folder = recordings or data_dir() / "recordings"
        recorders = Recorders(folder, time.monotonic)
        consents = Consents()
        policy = CONSOLE_POLICY.format(estop=" ".join(origin for door in stops for origin in door.origins))
        async with open_background() as nursery:
            nursery.start_soon(_keep_looking, robots)
            nursery.start_soon(recorders.run)
            await nursery.start(consents.listen)
            console = Console(
                client,
                config,
                robots,
                Poses(poses_file()),
                access,
                estop_of,
                pairing,
                fingerprint,
                recorders,
                folder,
                consents,
                AgentPanel(agent.factory, agent.mesh, nursery),
                models,
            )
            nursery.start_soon(console.run)
            offered = f"{pairing}?code={access.offer(Role.OPERATOR, time.time())}" if pairing else ""
            url = f"{pages[0].origins[0]}/?token={access.token}"
            on_serving(Serving(url, f"{stops[0].origins[0]}/estop", offered, fingerprint))
            await serve_doors(Guard(console.app(), access, policy), pages, trio.sleep_forever)


@contextlib.contextmanager
def _stopping(press: Press, access: Access, doors: list[Door], policy: str) -> Iterator[None]:
    """Serve the e-stop in a separate thread while the block runs."""
    app = Guard(estop_app(press), access, policy)
    starting: Future[Callable[[], None]] = Future()

    async def run() -> None:
        ended, token = trio.Event(), trio.lowlevel.current_trio_token()
        starting.set_result(lambda: token.run_sync_soon(ended.set))
        await serve_doors(app, doors, ended.wait)

    thread = threading.Thread(target=trio.run, args=(run,), name="the console's e-stop", daemon=True)
    thread.start()
    end = starting.result()
    try:
        yield
    finally:
        end()
        thread.join()


async def _keep_looking(robots: Robots) -> None:
    while True:
        await trio.sleep(LOOK_S)
        robots.look()


def _beside(pages: list[Door], stops: list[Door], scheme: str, host: str) -> str:
    """Return the address of the e-stop for a visitor of the console, under the same host name."""
    secure = scheme == "https"
    name = host.rpartition(":")[0]
    return f"{scheme}://{name}:{stops[1 if secure else 0].port}/estop"


def _code() -> str:
    return f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"


__all__ = ["CannotListen", "Lan", "Serving", "serve"]
