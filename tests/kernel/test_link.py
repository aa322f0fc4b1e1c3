"""A link between two nodes in one process: descriptors, limits, and its end."""

from __future__ import annotations

import os
import socket

import pytest
import trio
from trio.testing import wait_all_tasks_blocked

from strands_actors.kernel.actor import Actor
from strands_actors.kernel.channels.link import BACKLOG_BYTES, Link
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.kernel.frames import TELL, frame
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Node

from .kernel import Number, Recorder, Table, real_time, until


def two_nodes() -> tuple[Node, Node, Link, Link]:
    here, there = (Node(name, MonotonicClock()) for name in ("here", "there"))
    ours, theirs = socket.socketpair()
    return here, there, Link(here, ours), Link(there, theirs)


@real_time
async def test_actors_hosted_before_the_other_end_starts_are_known_to_it() -> None:
    """A child needs a tenth of a second to start, and its parent may host new actors meanwhile."""
    here, there, ours, theirs = two_nodes()
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        for node in (here, there):
            await nursery.start(node.run)
        await nursery.start(here.cell("r/actor/before", lambda: Recorder(log)).run)
        await nursery.start(ours.run)
        await nursery.start(here.cell("r/actor/between", lambda: Recorder(log)).run)
        await nursery.start(theirs.run)
        await nursery.start(here.cell("r/actor/after", lambda: Recorder(log)).run)
        await wait_all_tasks_blocked(0.05)
        for name in ("before", "between", "after"):
            assert await there.ref(f"strands/r/actor/{name}", Recorder).ask(Number(1), 5.0) == Number(1)
        nursery.cancel_scope.cancel()


@real_time
async def test_a_peer_that_does_not_read_costs_neither_time_nor_memory() -> None:
    here, there, ours, theirs = two_nodes()
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(there.run)
        await nursery.start(ours.run)
        cell = there.cell("r/actor/recorder", lambda: Recorder(log))
        cell.mailbox.capacity = 100_000
        await nursery.start(cell.run)
        sent = 0
        while not ours.dropped:
            ours.send(cell.address, frame(cell.address, TELL, 0, "a", here.address, Number(sent)))
            sent += 1
        lost = sent - 1  # the last message
        await nursery.start(theirs.run)  # the peer reads now
        await until(lambda: len(log) == lost)
        assert log == [Number(value) for value in range(lost)]  # kept messages arrive in order
        ours.send(cell.address, frame(cell.address, TELL, 0, "a", here.address, Number(-1)))
        await until(lambda: log[-1] == Number(-1))
        assert ours.dropped == 1
        nursery.cancel_scope.cancel()


@real_time
async def test_a_packet_larger_than_the_backlog_does_not_damage_the_stream() -> None:
    here, there, ours, theirs = two_nodes()
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        for node, link in ((here, ours), (there, theirs)):
            await nursery.start(node.run)
            await nursery.start(link.run)
        await nursery.start(there.cell("r/actor/recorder", lambda: Recorder(log)).run)
        await wait_all_tasks_blocked(0.05)
        for size in (BACKLOG_BYTES - 100, BACKLOG_BYTES, BACKLOG_BYTES + 1, 900_000, 2_000_000):
            # One directly after the other, so that the second finds the socket full.
            for _ in range(2):
                ours.send("strands/r/actor/recorder", b"x" * size)
            await until(lambda: not ours._backlog)
        ref = here.ref("strands/r/actor/recorder", Recorder)
        assert await ref.ask(Number(1), 10.0) == Number(1)
        assert ours.dropped >= 8
        assert not ours.closed
        nursery.cancel_scope.cancel()


@real_time
async def test_large_answers_pass() -> None:
    """The limit is for messages to an actor. Its answers may be larger."""

    class Library(Actor):
        def receive(self, message: Number) -> Table:
            return Table({}, ("x" * message.value,))

    here, there, ours, theirs = two_nodes()
    async with trio.open_nursery() as nursery:
        for node, link in ((here, ours), (there, theirs)):
            await nursery.start(node.run)
            await nursery.start(link.run)
        await nursery.start(there.cell("r/actor/library", Library).run)
        await wait_all_tasks_blocked(0.05)
        ref = here.ref("strands/r/actor/library", Library)
        for size in (100, 100_000, 250_000):
            answer = await ref.ask(Number(size), 10.0)
            assert isinstance(answer, Table)
            assert len(answer.names[0]) == size
        nursery.cancel_scope.cancel()


@pytest.mark.parametrize("how", ["close", "cancel", "peer closes", "peer resets"])
@real_time
async def test_the_end_of_a_link_is_reported_once_and_leaves_no_descriptor(how: str) -> None:
    before = len(os.listdir("/proc/self/fd"))
    _, _, ours, theirs = two_nodes()
    ended: list[str] = []
    ours._on_closed = lambda: ended.append("closed")  # like the argument of the constructor
    read, write = os.pipe()
    async with trio.open_nursery() as nursery:
        inner = trio.CancelScope()

        async def run() -> None:
            with inner:
                await ours.run()
            ended.append("returned")

        nursery.start_soon(run)
        await wait_all_tasks_blocked()
        assert not ours.closed
        if how == "peer resets":
            theirs._socket.recv(100)  # bytes that are sent now are unread when the peer closes
        ours.send("x", b"y" * 1000, (write,))
        while ours.send("x", b"y" * 1000, (write,)) and not ours.dropped:
            pass  # the backlog holds duplicates
        match how:
            case "close":
                ours.close()
            case "cancel":
                inner.cancel()
            case _:
                theirs._socket.close()
        await until(lambda: ended[-1:] == ["returned"])
        ours.close()
        assert ours.closed
        assert ended == ["closed", "returned"]
        assert not ours.send("x", b"y")
    theirs._socket.close()
    os.close(write)
    assert os.read(read, 1) == b""
    os.close(read)
    assert len(os.listdir("/proc/self/fd")) == before


@pytest.mark.parametrize("junk", [b"\xff\xff\xff\xff\x00", b"\x00\x00\x20\x00\x00" + b"x" * 100])
@real_time
async def test_an_impossible_length_ends_the_link(junk: bytes) -> None:
    _, _, ours, theirs = two_nodes()
    ended = trio.Event()
    theirs._on_closed = ended.set
    async with trio.open_nursery() as nursery:
        await nursery.start(theirs.run)
        ours._socket.send(junk)
        await ended.wait()
    ours._socket.close()


@real_time
async def test_packets_are_assembled_from_pieces_of_any_size() -> None:
    here, there, ours, theirs = two_nodes()
    log: list[Message] = []
    async with trio.open_nursery() as nursery:
        await nursery.start(theirs.run)
        cell = there.cell("r/actor/recorder", lambda: Recorder(log))
        await nursery.start(cell.run)
        stream = b""
        for value in range(50):
            data = frame(cell.address, TELL, 0, "a", here.address, Number(value))
            stream += len(data).to_bytes(4, "little") + b"\0" + data
        raw = trio.socket.from_stdlib_socket(ours._socket)
        for start in range(0, len(stream), 7):
            await raw.send(stream[start : start + 7])
            await trio.lowlevel.checkpoint()
        await until(lambda: len(log) == 50)
        assert log == [Number(value) for value in range(50)]
        nursery.cancel_scope.cancel()
    ours._socket.close()
