"""The services that a host runs beside its robots, each in a process that ends with the host.

A process sends lines to the host: the address of its service, or after ``!`` the reason of its failure.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Awaitable, Callable, Mapping, Sequence
from typing import Any

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.contract.extras import MissingExtra, require
from strands_actors.kernel.processes.identity import take_name
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig

Serve = Callable[[MeshClient, Callable[[str], None]], Awaitable[None]]
"""Serves until it is cancelled. It gets the client of the mesh, and a function that sends a line to the host."""

ENTRIES: Mapping[str, str] = {name: f"{__name__}:{name}" for name in ("metrics", "ros2", "web")}
"""The function of each service's process."""


def metrics(arguments: dict[str, Any], sock: socket.socket) -> None:
    """Serve the metrics of all robots at ``host`` and ``port``."""

    async def serve_metrics(client: MeshClient, on_serving: Callable[[str], None]) -> None:
        from strands_actors.surfaces.metrics.serving import serve

        await serve(client, arguments["host"], arguments["port"], on_serving, arguments["traces"])

    extras = ("metrics", "otel") if arguments["traces"] else ("metrics",)
    _run("metrics", extras, arguments, sock, serve_metrics)


def web(arguments: dict[str, Any], sock: socket.socket) -> None:
    """Serve the console at ``port``."""

    async def serve_console(client: MeshClient, on_serving: Callable[[str], None]) -> None:
        from strands_actors.surfaces.web.serving import CannotListen, serve

        try:
            await serve(client, MeshConfig(), arguments["port"], None, lambda serving: on_serving(serving.url))
        except CannotListen as reason:
            raise OSError(str(reason)) from reason

    _run("web", ("web",), arguments, sock, serve_console)


def ros2(arguments: dict[str, Any], sock: socket.socket) -> None:
    """Show the robots on a ROS 2 graph. ``options`` are those of the file, as ``Ros2`` has them."""

    async def bridge(client: MeshClient, on_serving: Callable[[str], None]) -> None:
        from strands_actors.kernel.channels.ros2.names import Dialect
        from strands_actors.surfaces.ros2.bridge import Options, open_bridge

        domain, namespace, router, humble, allow_motion = arguments["options"]
        options = Options((), namespace, Dialect(domain, not humble), router, allow_motion)
        is_connected = trio.Event()

        def log(line: str) -> None:
            # Later lines are about single robots. The diagnostics on the graph have them, too.
            if not is_connected.is_set():
                on_serving(f"!{line}")

        async with open_bridge(client, options, log):
            is_connected.set()
            on_serving(f"{router}, ROS domain {domain}")
            await trio.sleep_forever()

    _run("ros2", (), arguments, sock, bridge)


def _run(name: str, extras: Sequence[str], arguments: Mapping[str, Any], sock: socket.socket, serve: Serve) -> None:
    """Serve until the host ends. ``extras`` names the optional packages that the service needs."""
    take_name("host", name, arguments["label"])

    async def outlive_host() -> None:
        await trio.lowlevel.wait_readable(sock)
        os._exit(0)

    async def main() -> None:
        async with open_mesh(MeshConfig()) as client, open_background() as nursery:
            nursery.start_soon(outlive_host)
            await serve(client, lambda address: sock.sendall(f"{address}\n".encode()))

    try:
        for extra in extras:
            require(extra, name)
        trio.run(main)
    except (MissingExtra, OSError) as error:
        sock.sendall(f"!{error}\n".encode())
