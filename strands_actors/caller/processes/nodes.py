"""Open a node (the actors of this process, connected to others by zenoh), for programs that start, watch or
command robots.
"""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Mapping, Sequence
from typing import Any, NamedTuple

import trio

from strands_actors.kernel.channels.zenoh_mesh import EVERYBODY, ZenohMesh
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.node import Node

from .background import open_background


class Entrance(NamedTuple):
    """The address at which a program listens for the robot processes that it starts, and a secret.

    The secret admits these processes. It is sent to them only over inherited sockets.
    """

    endpoint: str
    secret: str


@contextlib.asynccontextmanager
async def open_node(
    name: str,
    listen: Sequence[str] = (),
    connect: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    tokens: str = EVERYBODY,
    secret: str = "",
    private: Sequence[str] = (),
) -> AsyncIterator[tuple[Node, trio.Nursery]]:
    """Open a node (the actors of this process, connected to others by zenoh) for a block. Yield the node, and a
    nursery that ends with the block. Threads may use the node, too.

    Args:
        name: Name of the node.
        listen: Addresses to listen at.
        connect: Addresses to connect to.
        settings: zenoh's settings.
        tokens: As in ``ZenohMesh.attach``.
        secret: The secret that every peer must know (``zenoh_session.secured_by``); empty for no secret.
        private: Addresses of actors, for ``ZenohMesh.ask_privately``.
    """
    node = Node(name, MonotonicClock())
    mesh = await ZenohMesh.open(listen, connect, settings, secret)
    try:
        async with open_background() as nursery:
            await nursery.start(node.run)
            mesh.attach(node, tokens)
            for address in private:
                mesh.ask_privately(address)
            mesh.serve_threads()
            await nursery.start(mesh.run)
            yield node, nursery
    finally:
        with trio.CancelScope(shield=True):
            try:
                await trio.to_thread.run_sync(mesh.close)
            except RuntimeError:
                # While Python exits, no thread can be started any more. So close the session in this thread.
                mesh.close()
