"""The recorder, in virtual time: when a recording is under way."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.local_mesh import LocalNetwork
from strands_actors.kernel.clock import MonotonicClock, VirtualClock
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.node import Node
from strands_actors.kernel.refusals import Code
from strands_actors.supervisors import addresses
from strands_actors.supervisors.instrument import (
    Acknowledge,
    Attach,
    Attached,
    Batch,
    Detach,
    Detached,
    InstrumentKeeper,
    Taken,
)
from strands_actors.surfaces.recording.errors import RecordingError
from strands_actors.surfaces.recording.recorder import FIRST_S, SOURCES, Recorder
from strands_actors.testing import run_virtual

ROBOT = "so101"
TOLD = msgspec.Raw(b"\x01")


class Keeper(Actor):
    """Sends one batch as soon as a recorder attaches."""

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

    def lost(self, source: str, reason: str) -> None:
        self.told.append(f"{source} lost")

    def flush(self) -> None: ...

    def close(self) -> None: ...


class Sinks(list[Sink]):
    """One sink for each started recording."""

    def open(self, attached: Attached) -> Sink:
        self.append(Sink())
        return self[-1]


def test_a_recording_starts_when_wire_and_root_take_part_and_has_their_first_events() -> None:
    async def run() -> None:
        node, sinks = Node("here", VirtualClock()), Sinks()
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            nursery.start_soon(Recorder(ROBOT, sinks.open).run, node)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("wire"), Keeper).run)
            await trio.sleep(FIRST_S / 2)
            assert not sinks, "the recording must not start before the root takes part"
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("root"), Keeper).run)
            await trio.sleep(1.0)
            (sink,) = sinks
            assert sink.told == ["wire", "root"]
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_a_process_that_does_not_answer_is_named() -> None:
    async def run() -> None:
        node = Node("here", VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("wire"), Keeper).run)
            with pytest.raises(RecordingError, match="its root process does not answer"):
                await Recorder(ROBOT, lambda attached: Sink()).run(node)
            nursery.cancel_scope.cancel()

    run_virtual(run)


def test_a_failed_recorder_makes_room_for_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """The robot has accepted the recorder, but its file or dataset cannot be opened. Each recorder is a separate
    process."""
    processes = itertools.count(100)

    class Full(Sink):
        def flush(self) -> None:
            raise OSError("no space")

    def refuse(attached: Attached) -> Sink:
        raise RecordingError("the dataset has another fps")

    async def run() -> None:
        network, robot = LocalNetwork(), Node("robot", MonotonicClock())
        network.join().attach(robot)
        kept = Attached({"robot": "fake"}, ("a",), "m")
        async with trio.open_nursery() as nursery:
            await nursery.start(robot.run)
            for name in SOURCES:
                at = addresses.of(ROBOT).instrument(name)
                await nursery.start(robot.cell(at, lambda: InstrumentKeeper({}, kept)).run)
            for open_sink, why in ((refuse, "another fps"), (lambda attached: Full(), "no space")) * 2:
                process = next(processes)
                monkeypatch.setattr(os, "getpid", lambda one=process: one)
                node = Node(f"recorder.{process}", MonotonicClock())
                network.join().attach(node)
                await nursery.start(node.run)
                with trio.fail_after(10), pytest.raises((RecordingError, OSError), match=why):
                    await Recorder(ROBOT, open_sink).run(node)
            nursery.cancel_scope.cancel()

    trio.run(run)


def test_a_second_recorder_is_refused_with_the_process_that_records() -> None:
    by = f"process {os.getppid()}"  # a living process

    class Busy(Keeper):
        def receive(self, message: Attach | Detach | Acknowledge) -> Any:
            return Taken(by, os.getppid())

    async def run() -> None:
        node = Node("here", VirtualClock())
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            for name in SOURCES:
                await nursery.start(node.cell(addresses.of(ROBOT).instrument(name), Busy).run)
            with pytest.raises(RecordingError) as refused:
                await Recorder(ROBOT, lambda attached: Sink()).run(node)
            assert str(refused.value) == f"{ROBOT}: {by} already records this robot. End that recording first"
            nursery.cancel_scope.cancel()

    run_virtual(run)


@pytest.mark.parametrize("reaped", [True, False])
@pytest.mark.parametrize("patience_s", [1.2, 100.0])
def test_a_recorder_that_was_killed_keeps_no_other_away_for_long(reaped: bool, patience_s: float) -> None:
    """The robot drops it after two seconds. If it does not, the refusal is reported."""
    with subprocess.Popen([sys.executable, "-c", ""]) as dead:
        if reaped:
            dead.wait()
        else:
            os.waitid(os.P_PID, dead.pid, os.WEXITED | os.WNOWAIT)

        class Keeps(Keeper):
            async def started(self) -> None:
                self.began = trio.current_time()

            def receive(self, message: Attach | Detach | Acknowledge) -> Any:
                if isinstance(message, Attach) and trio.current_time() < self.began + patience_s:
                    return Taken(f"process {dead.pid}", dead.pid)
                return super().receive(message)

        async def run() -> None:
            node, sinks = Node("here", VirtualClock()), Sinks()
            async with trio.open_nursery() as nursery:
                await nursery.start(node.run)
                for name in SOURCES:
                    await nursery.start(node.cell(addresses.of(ROBOT).instrument(name), Keeps).run)
                if patience_s > FIRST_S:
                    with pytest.raises(
                        RecordingError, match=f"process {dead.pid} already records this robot. End that recording"
                    ):
                        await Recorder(ROBOT, sinks.open).run(node)
                    assert not sinks
                else:
                    await Recorder(ROBOT, sinks.open).run(node, FIRST_S)
                    assert len(sinks) == 1
                nursery.cancel_scope.cancel()

        run_virtual(run)


class GivesUp(Keeper):
    """A keeper that has dropped its recorder, because the recorder was silent for too long."""

    def receive(self, message: Attach | Acknowledge | Detach) -> Attached | Detached | Refused | None:
        if isinstance(message, Detach):
            return Refused(Code.GIVEN_UP, "the robot has given the recording up")
        return super().receive(message)


def test_saf_023_a_dropped_recording_reports_that_the_rest_is_missing() -> None:
    async def run() -> None:
        node, sinks = Node("here", VirtualClock()), Sinks()
        async with trio.open_nursery() as nursery:
            await nursery.start(node.run)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("wire"), GivesUp).run)
            await nursery.start(node.cell(addresses.of(ROBOT).instrument("root"), Keeper).run)
            await Recorder(ROBOT, sinks.open).run(node, 1.0)
            nursery.cancel_scope.cancel()
        (sink,) = sinks
        assert sink.told == ["wire", "root", "wire lost"]

    run_virtual(run)
