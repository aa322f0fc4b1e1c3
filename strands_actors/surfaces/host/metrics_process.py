"""The process that serves the metrics of a host's robots. It ends with the host."""

from __future__ import annotations

import os
import socket
from typing import Any

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.contract.extras import MissingExtra, require
from strands_actors.kernel.processes.identity import take_name
from strands_actors.surfaces.mesh.client import open_mesh
from strands_actors.surfaces.mesh.config import MeshConfig


def main(args: dict[str, Any], sock: socket.socket) -> None:
    """Serve the metrics at ``args["host"]`` and ``args["port"]``.

    One line on ``sock`` has the URL, or after ``!`` why there are no metrics.
    """
    take_name("host", "metrics", args["label"])
    try:
        require("metrics", "metrics")
        trio.run(_serve, args["host"], args["port"], sock)
    except (MissingExtra, OSError) as error:
        sock.sendall(f"!{error}\n".encode())


async def _serve(host: str, port: int, sock: socket.socket) -> None:
    from strands_actors.surfaces.metrics.serving import serve

    async def outlive_host() -> None:
        await trio.lowlevel.wait_readable(sock)
        os._exit(0)

    async with open_mesh(MeshConfig()) as client, open_background() as nursery:
        nursery.start_soon(outlive_host)
        await serve(client, host, port, lambda url: sock.sendall(f"{url}\n".encode()))
