"""Test how much of a peer's data one turn processes (SAF-025)."""

from __future__ import annotations

import socket
from collections.abc import Callable

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.codecs.grpc_messages import ClientEnd, MessageDecoder
from strands_actors.drivers.common.ports.grpc import FRAMES, Connection
from strands_actors.drivers.common.ports.receive_budget import BUSY_TURNS, PIECES, SIZE, ReceiveBudget
from strands_actors.drivers.common.ports.udp_port import open_udp
from tests.drivers.common.memory_port import virtual

PING = b"\0\0\x08\x06\0\0\0\0\0" + b"12345678"


def endless(size: int) -> tuple[Callable[[], bytes], list[int]]:
    reads: list[int] = []

    def read_waiting() -> bytes:
        reads.append(size)
        return bytes(size)

    return read_waiting, reads


@pytest.mark.parametrize(("size", "most"), [(1, PIECES), (4096, SIZE // 4096)])
def test_saf_025_a_turn_ends_although_more_is_waiting(size: int, most: int) -> None:
    read_waiting, reads = endless(size)
    assert len(list(ReceiveBudget("it").turn(read_waiting))) == len(reads) == most


def test_saf_025_a_peer_that_is_always_ahead_is_lost_and_all_that_was_read_is_taken_in() -> None:
    budget, taken = ReceiveBudget("the arm"), 0
    read_waiting, reads = endless(1)
    with pytest.raises(WireDown, match="the arm: the peer sends more than this process can read"):
        for _ in range(BUSY_TURNS + 1):
            for _ in budget.turn(read_waiting):
                taken += 1
    assert taken == len(reads) == PIECES * (BUSY_TURNS + 1)


def test_a_backlog_that_is_read_in_the_end_is_no_flood() -> None:
    budget = ReceiveBudget("it")
    waiting: list[bytes] = []

    def read_waiting() -> bytes | None:
        return waiting.pop() if waiting else None

    for _ in range(3):
        waiting += [b"x"] * PIECES * BUSY_TURNS
        for _ in range(BUSY_TURNS + 1):
            list(budget.turn(read_waiting))
        assert not waiting


def test_saf_025_http2_is_taken_in_by_the_frame() -> None:
    """h2 alone would handle all frames of a read at once. Empty settings take 0.05 ms each."""
    end = ClientEnd("it")
    end.outgoing()
    _, frames = end.feed_some(PING * 1000, FRAMES)
    assert (frames, end.has_unread) == (FRAMES, True)
    assert end.outgoing().count(b"12345678") == FRAMES
    end.feed(b"")
    assert not end.has_unread and end.outgoing().count(b"12345678") == 1000 - FRAMES


class _Pinging:
    """A stream with a peer that sends pings without end. If ``deaf``, the peer reads nothing."""

    def __init__(self, deaf: bool = False) -> None:
        self.reads = 0
        self.written = 0
        self.deaf = deaf

    def write(self, data: bytes) -> None:
        if self.deaf:
            raise WireDown("output is blocked")
        self.written += len(data)

    async def read(self) -> bytes:
        await trio.sleep(0.001)
        return self.read_waiting()

    def read_waiting(self) -> bytes:
        self.reads += 1
        return PING * 100

    def close(self) -> None: ...

    def close_in_order(self) -> None: ...


def test_saf_025_a_connection_that_is_flooded_is_given_up_turn_by_turn() -> None:
    stream = _Pinging()
    connection = Connection("it", stream, ClientEnd("it"))
    for _ in range(BUSY_TURNS):
        connection.take_waiting()
    assert connection.is_open and stream.reads <= BUSY_TURNS
    with pytest.raises(WireDown, match="more than this process can read"):
        connection.take_waiting()
    assert not connection.is_open


def test_saf_025_answers_to_pings_are_not_kept_for_a_peer_that_does_not_read() -> None:
    connection = Connection("it", _Pinging(deaf=True), ClientEnd("it"))
    with pytest.raises(WireDown, match="output is blocked"):
        connection.take_waiting()


def test_saf_025_others_run_while_a_connection_is_flooded() -> None:
    async def main() -> None:
        connection, turns = Connection("it", _Pinging(), ClientEnd("it")), 0

        async def count() -> None:
            nonlocal turns
            while True:
                await trio.sleep(0.001)
                turns += 1

        async with trio.open_nursery() as nursery:
            nursery.start_soon(count)
            assert not await connection.until(lambda: False, 0.1)
            nursery.cancel_scope.cancel()
        assert turns > 60

    virtual(main)


def test_saf_025_a_message_in_single_bytes_is_put_together_without_a_copy_for_each() -> None:
    decoder, size = MessageDecoder(), 1 << 20
    list(decoder.feed(b"\0" + size.to_bytes(4, "big")))
    kept = decoder._pending
    for _ in range(1000):
        list(decoder.feed(b"x"))
    assert decoder._pending is kept


def test_saf_025_a_flood_of_datagrams_lets_others_run() -> None:
    async def main() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
            peer.bind(("127.0.0.1", 0))
            port = open_udp(*peer.getsockname())
            port.write(b"hello")
            _, us = peer.recvfrom(100)
            for _ in range(50):
                peer.sendto(b"x", us)
            turns = 0

            async def count() -> None:
                nonlocal turns
                while True:
                    await trio.lowlevel.checkpoint()
                    turns += 1

            async with trio.open_nursery() as nursery:
                nursery.start_soon(count)
                for _ in range(50):
                    await port.read()
                nursery.cancel_scope.cancel()
            port.close()
            assert turns >= 25

    trio.run(main)
