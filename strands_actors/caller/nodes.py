"""A node of this process on zenoh, for whoever starts robots, watches them or gives them orders."""

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
    """Where a node listens for the trees that it starts, and what they have to know to come in: it
    goes to them over their links alone."""

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
    """As long as the block runs; what runs in the nursery ends with it. Threads may ask by it,
    too. ``secret``: see ``known_by``. ``private``: addresses, see ``ask_privately``."""
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
                mesh.close()  # at the end of a script no thread can be started any more
