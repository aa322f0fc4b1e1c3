"""Test samples that are longer than a datagram."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import messages, wire_types
from strands_actors.drivers.common.rtps.messages import Fragment
from strands_actors.drivers.common.rtps.reassembly import MAX_BYTES, MAX_SAMPLES, PATIENCE_NS, Reassembly

from .pair import HEAD, A, B, Pair


@pytest.mark.parametrize("reliable", [False, True])
def test_a_long_sample_goes_in_fragments(reliable: bool) -> None:
    pair = Pair(reliable)
    pair.read()
    long = HEAD + bytes(range(256)) * 400
    assert pair.writer.write(long) == 1
    pair.network.run(0.01)
    assert pair.log.payloads == [long]


def test_a_long_sample_that_lost_a_fragment_comes_again() -> None:
    pair = Pair()
    pair.read()
    long = HEAD + bytes(range(256)) * 400
    count = 0

    def one_lost(datagram: bytes) -> tuple[tuple[int, bytes], ...]:
        nonlocal count
        count += 1
        return () if count == 3 else ((1000, datagram),)

    pair.network.fate = one_lost
    pair.writer.write(long)
    pair.network.run(0.2)
    assert pair.log.payloads == [long]


def fragment(sequence: int, index: int = 0, size: int = 10, total: int = 30, writer: int = 0) -> Fragment:
    return Fragment(
        wire_types.UNKNOWN, bytes([writer]) * 16, sequence, index, 1, size, total, memoryview(bytes(size)), False
    )


def test_reassembly_is_bounded_in_number_size_and_time() -> None:
    parts = Reassembly()
    for sequence in range(100):
        parts.add(fragment(sequence), 0)
    assert (len(parts), parts.dropped) == (MAX_SAMPLES, 100 - MAX_SAMPLES)
    parts.tick(PATIENCE_NS)
    assert len(parts) == MAX_SAMPLES
    parts.tick(PATIENCE_NS + 1)
    assert len(parts) == parts._bytes == 0
    with pytest.raises(MalformedFrame):
        parts.add(fragment(1, size=60000, total=MAX_BYTES + 1), 0)
    for sequence in range(3):
        parts.add(fragment(sequence, size=60000, total=MAX_BYTES // 2), 0)
    assert (len(parts), parts._bytes) == (2, MAX_BYTES)
    parts.forget(bytes(12))
    assert len(parts) == parts._bytes == 0


def test_fragments_come_in_any_order_and_more_than_once() -> None:
    parts = Reassembly()
    assert parts.add(fragment(1, 2), 0) is None
    assert parts.add(fragment(1, 0), 0) is None
    assert parts.add(fragment(1, 2), 0) is None
    assert parts.add(fragment(1, 1), 0) == bytes(30)
    assert len(parts) == parts._bytes == 0


def test_fragments_that_do_not_fit_together_are_malformed() -> None:
    parts = Reassembly()
    parts.add(fragment(1, 0), 0)
    with pytest.raises(MalformedFrame):
        parts.add(fragment(1, 1, total=40), 0)
    assert len(parts) == 0


def test_incomplete_fragments_are_given_up() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.writer.data.guid
    piece, *_ = messages.fragments(wire_types.UNKNOWN, guid[12:], 1, bytes(50_000))
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + piece)
    pair.network.run(0.1)
    assert len(pair.b._reassembly) == 1
    pair.network.run(1.2)
    assert len(pair.b._reassembly) == 0
