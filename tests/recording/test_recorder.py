"""The recorder, in virtual time: when a recording is under way."""

from __future__ import annotations

import msgspec
import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.clock import VirtualClock
from strands_actors.kernel.node import Node
from strands_actors.supervisors import addresses
from strands_actors.supervisors.instrument import Acknowledge, Attach, Attached, Batch, Detach, Detached
from strands_actors.surfaces.recording.errors import RecordingError
from strands_actors.surfaces.recording.recorder import FIRST_S, Recorder
from strands_actors.testing import run_virtual

ROBOT = "so101"
TOLD = msgspec.Raw(b"\x01")


class Keeper(Actor):
    """Tells one thing as soon as somebody listens."""

    def receive(self, message: Attach | Acknowledge | Detach) -> Attached | Detached | None:
        if isinstance(message, Attach):
            self.context.ref(message.to, Listener).tell(Batch(message.session, 1, (TOLD,)))
            return Attached({}, ("pan",), "deg")
        return Detached() if isinstance(message, Detach) else None


class Listener(Actor):
    def receive(self, message: Batch) -> None: ...


class Sink:
    def __init__(self) -> None:
        self.told: list[str] = []

    def add(self, source: str, batch: Batch) -> None:
        self.told += [source] * len(batch.entries)

    def lost(self, source: str, why: str) -> None:
        self.told.append(f"{source} lost")

    def flush(self) -> None: ...

    def close(self) -> None: ...


def test_a_recording_is_under_way_when_wire_and_root_are_in_it_and_has_what_they_told_first() -> None:
    async def run() -> None:
        node, sinks = Node("here", VirtualClock()), list[Sink]()

        def open_sink(attached: Attached) -> Sink:
            sinks.append(Sink())
            return sinks[-1]

        recorder = Recorder(ROBOT, open_sink)
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            nursery.start_soon(recorder.run, node)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("wire"), Keeper).run)
            await trio.sleep(FIRST_S / 2)
            assert not sinks, "an event of the root would not be in it"
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("root"), Keeper).run)
            await trio.sleep(1.0)
            (sink,) = sinks
            assert sink.told == ["wire", "root"]
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_who_does_not_answer_is_named() -> None:
    async def run() -> None:
        node = Node("here", VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("wire"), Keeper).run)
            with pytest.raises(RecordingError, match="its root process does not answer"):
                await Recorder(ROBOT, lambda attached: Sink()).run(node)
            nursery.cancel_scope.cancel()

    run_virtual(run)
