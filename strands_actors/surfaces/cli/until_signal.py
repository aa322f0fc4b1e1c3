"""Join the mesh until Ctrl-C."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import AsyncIterator
from pathlib import Path

import trio

from strands_actors.caller.processes.background import open_background
from strands_actors.surfaces.mesh.client import MeshClient, open_mesh

from .orders import configuration


@contextlib.asynccontextmanager
async def mesh_until_signal(mesh: Path | None) -> AsyncIterator[MeshClient]:
    """Join the mesh while the block runs. SIGINT and SIGTERM end the block, and the program goes on after it.

    Args:
        mesh: A TOML file with the endpoints of robots on other hosts.
    """
    with trio.open_signal_receiver(signal.SIGINT, signal.SIGTERM) as signals:
        async with open_mesh(configuration(mesh)) as client, open_background() as nursery:
            with trio.CancelScope() as block:

                async def listen() -> None:
                    async for _ in signals:
                        block.cancel()

                nursery.start_soon(listen)
                yield client
