"""A tree and its recorder in virtual time, all in memory."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field

import msgspec
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.local_mesh import LocalNetwork
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.instrument import (
    Acknowledge,
    Attach,
    Attached,
    Batch,
    Detach,
    Detached,
    Entry,
    InstrumentKeeper,
)
from strands_actors.supervisors.wire.group import instrument_keeper
from strands_actors.surfaces.recording.file import Recording, decode_entries, new_info
from strands_actors.surfaces.recording.rows import Gap, Journal
from strands_actors.testing import InlineTree, open_inline_tree


class Taker(Actor):
    """A recorder that keeps batches, and acknowledges them while ``reads``."""

    def __init__(self, instrument: str) -> None:
        self.batches: list[Batch] = []
        self.reads = True
        self._instrument_address = instrument

    def receive(self, message: Batch) -> None:
        self.batches.append(message)
        if self.reads:
            self.context.ref(self._instrument_address).tell(Acknowledge(message.session, message.number))


@dataclass
class Tape:
    """One recorder of one inline tree."""

    tree: InlineTree
    node: Node
    taker: Taker
    instrument: str
    at: str
    session: int = 0
    attached: Attached = field(default_factory=lambda: Attached({}, (), ""))

    async def attach(self, session: int = 1, at: str = "") -> Attached:
        answer = await self.ask(Attach(at or self.at, session, "a test"))
        assert isinstance(answer, Attached), answer
        self.session, self.attached = session, answer
        return answer

    async def detach(self) -> None:
        assert isinstance(await self.ask(Detach(self.session)), Detached)

    async def ask(self, message: Attach | Detach) -> object:
        return await self.node.ref(self.instrument, InstrumentKeeper).ask(message, 5.0)

    @property
    def entries(self) -> list[Entry]:
        return [entry for batch in self.taker.batches for entry in entries_of(batch)]

    def recording(self) -> Recording:
        robot = self.instrument.split("/")[1]
        parts: list[Journal | Gap] = [
            Journal("wire", batch.session, batch.number, msgspec.msgpack.encode(batch.entries))
            for batch in self.taker.batches
        ]
        return Recording(new_info(robot, "", self.attached), parts)


def entries_of(batch: Batch) -> list[Entry]:
    return decode_entries(msgspec.msgpack.encode(batch.entries))


@contextlib.asynccontextmanager
async def open_tape() -> AsyncIterator[Tape]:
    network = LocalNetwork()
    async with open_inline_tree() as tree, trio.open_nursery() as nursery:
        robot = tree.gate.address.split("/")[1]
        network.join().attach(tree.node)
        path = addresses.of(robot).instrument("wire")
        description = {"class": "fake", "robot": "fake", "port": robot, "options": {}}
        keeper = tree.node.cell(
            path, lambda: instrument_keeper(tree.node, tree.driver, description, robot), "instrument"
        )
        await nursery.start(keeper.run)
        node = Node("recorder", VirtualClock())
        network.join().attach(node)
        await nursery.start(node.run)
        instrument = f"strands/{path}"
        taker = Taker(instrument)
        cell = node.cell("recorder/actor/wire", lambda: taker)
        await nursery.start(cell.run)
        yield Tape(tree, node, taker, instrument, cell.address)
        nursery.cancel_scope.cancel()
