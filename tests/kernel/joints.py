"""Connect two nodes in each possible way. ``here`` asks, ``there`` hosts the actors, and ``sever`` cuts
the connection to ``there``.
"""

from __future__ import annotations

import socket
import tempfile
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager, asynccontextmanager, suppress
from dataclasses import dataclass

import msgspec
import trio

from strands_actors.kernel.actor import Actor, Cell
from strands_actors.kernel.channels.link import Link
from strands_actors.kernel.channels.zenoh_mesh import ZenohMesh, unix_endpoint
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import ASK, TELL, frame, protocol_of
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.node import Answer, Connection, Node, Unreachable

from .kernel import PATIENCE_S, Alarm, Recorder, local_pair


@dataclass
class Pair:
    here: Node
    there: Node
    connection: Connection  # the side of ``here``
    back: Connection  # the side of ``there``
    sever: Callable[[], None]
    nursery: trio.Nursery

    async def host(self, name: str, factory: Callable[[], Actor], node: Node | None = None) -> Cell:
        """Run an actor, by default on ``there``. Wait until the other node can reach it."""
        node = node or self.there
        cell = node.cell(f"r/actor/{name}", factory)
        await self.nursery.start(cell.run)
        await reachable(self.here if node is self.there else self.there, cell.address)
        return cell

    async def record(self, name: str = "recorder") -> tuple[Cell, list[Message]]:
        log: list[Message] = []
        cell = await self.host(name, lambda: Recorder(log))
        log.clear()
        cell.mailbox.conflated = 0
        return cell, log

    def raw(self, data: bytes, to: str | None = None) -> None:
        """Send bytes from ``here`` to ``there``, as any peer could."""
        assert self.connection.send(to or self.there.address, data)

    async def ask_raw(
        self, to: str, body: bytes, actor: type[Actor] = Recorder, deadline_s: float = PATIENCE_S
    ) -> Message | None:
        """Ask with a body that is not checked before it is sent."""
        answer = Answer(protocol_of(actor).decode_reply)
        answer.connection = self.connection
        cid = self.here.new_cid()
        self.here.pending[cid] = answer
        self.raw(frame(to, ASK, cid, "raw", self.here.address, msgspec.Raw(body)))
        with trio.fail_after(deadline_s):
            return await answer.wait()

    def tell_raw(self, to: str, body: bytes) -> None:
        self.raw(frame(to, TELL, 0, "raw", self.here.address, msgspec.Raw(body)))


async def reachable(node: Node, address: str) -> None:
    """Wait until ``address`` answers. Either of the two nodes may know the other first."""
    with trio.fail_after(PATIENCE_S):
        while True:
            with suppress(Unreachable):
                await node.ref(address).ask(Alarm(0), PATIENCE_S)
                return
            await trio.sleep(0.002)


@asynccontextmanager
async def _serving(pair: Pair) -> AsyncIterator[Pair]:
    nursery = pair.nursery
    for node in (pair.here, pair.there):
        await nursery.start(node.run)
    await reachable(pair.here, pair.there.address)
    await reachable(pair.there, pair.here.address)
    for node in (pair.here, pair.there):
        node.refused_count = node.dead_letter_count = 0
        node.dead_letters.clear()
    yield pair
    nursery.cancel_scope.cancel()


@asynccontextmanager
async def by_local_mesh() -> AsyncIterator[Pair]:
    network, here, there = local_pair()
    assert here.mesh is not None and there.mesh is not None
    async with trio.open_nursery() as nursery:

        def sever() -> None:
            network.cut(there)

        async with _serving(Pair(here, there, here.mesh, there.mesh, sever, nursery)) as pair:
            yield pair


@asynccontextmanager
async def by_zenoh() -> AsyncIterator[Pair]:
    with tempfile.TemporaryDirectory(prefix="sa-", dir="/tmp") as directory:
        endpoint = unix_endpoint(f"{directory}/there")
        theirs = await ZenohMesh.open([endpoint])
        ours = await ZenohMesh.open([unix_endpoint(f"{directory}/here")], [endpoint])
        try:
            async with trio.open_nursery() as nursery:
                here, there = (Node(name, MonotonicClock()) for name in ("here", "there"))
                for mesh, node in ((ours, here), (theirs, there)):
                    mesh.attach(node)
                    await nursery.start(mesh.run)
                async with _serving(Pair(here, there, ours, theirs, theirs.close, nursery)) as pair:
                    yield pair
        finally:
            with trio.CancelScope(shield=True):
                for mesh in (ours, theirs):
                    await trio.to_thread.run_sync(mesh.close)


@asynccontextmanager
async def by_link() -> AsyncIterator[Pair]:
    here, there = (Node(name, MonotonicClock()) for name in ("here", "there"))
    ends = socket.socketpair()
    ours, theirs = (Link(node, end) for node, end in zip((here, there), ends, strict=True))
    async with trio.open_nursery() as nursery:
        for link in (ours, theirs):
            await nursery.start(link.run)
        async with _serving(Pair(here, there, ours, theirs, theirs.close, nursery)) as pair:
            yield pair


Joint = Callable[[], AbstractAsyncContextManager[Pair]]
JOINTS: dict[str, Joint] = {"local": by_local_mesh, "zenoh": by_zenoh, "link": by_link}


def code_of(answer: Message | None) -> str:
    assert isinstance(answer, Refused), answer
    return answer.code
