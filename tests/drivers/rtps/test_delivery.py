"""Test two participants in virtual time: what is delivered, requested again, and given up."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.rtps import messages, wire_types
from strands_actors.drivers.common.rtps.reader import MAX_WAITING

from .pair import HEAD, A, B, Log, Pair, payloads, undisturbed

# -- best effort


def test_best_effort_takes_the_newer_and_drops_the_rest() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.writer.data.guid
    for sequence in (1, 2, 2, 5, 4, 3, 5, 6):
        sent = messages.data(wire_types.UNKNOWN, guid[12:], sequence, payloads(sequence)[0])
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent)
    pair.network.run(0.1)
    assert pair.log.payloads == payloads(1, 2, 5, 6)
    assert pair.reader.lost == 2


def test_a_write_is_one_datagram_for_each_address() -> None:
    pair = Pair(reliable=False)
    pair.read()
    pair.b.reader("rt/t", "T_", False, False, Log())  # a second reader at the same address
    pair.network.run(0.2)
    assert pair.writer.matched == 2
    pair.network.keep_sent = True
    assert pair.writer.write(payloads(1)[0]) == 1
    ((datagram, address),) = pair.network.sent
    assert address == (B, 7411)
    assert len(datagram) == 20 + 4 + 20 + 8


# -- reliable


def test_lost_samples_are_requested_again_and_delivered_in_order() -> None:
    pair = Pair()
    pair.read()
    pair.write(1, then_s=0.01)
    pair.network.fate = lambda datagram: ()
    pair.write(2, 3)
    pair.network.fate = undisturbed
    pair.write(4)
    pair.network.run(0.0005)  # one round trip, since the heartbeat came with sample 4
    assert pair.log.payloads == payloads(1, 2, 3, 4)


def test_the_last_sample_is_not_lost_either() -> None:
    pair = Pair()
    pair.read()
    pair.network.fate = lambda datagram: ()
    pair.write(1)
    pair.network.fate = undisturbed
    pair.network.run(0.2)
    assert pair.log.payloads == payloads(1)
    assert pair.writer.unacknowledged == 0
    pair.network.keep_sent = True
    pair.network.run(0.2)
    to = {address for _, address in pair.network.sent}
    assert to == {(A, 7410), (B, 7410)}  # everything is acknowledged, so they only announce themselves


def test_samples_that_left_the_history_are_given_up() -> None:
    pair = Pair(depth=2)
    pair.read()
    pair.write(1, then_s=0.01)
    pair.network.fate = lambda datagram: ()
    pair.write(2, 3, 4, 5)
    pair.network.fate = undisturbed
    pair.network.run(0.2)
    assert pair.log.payloads == payloads(1, 4, 5)
    assert pair.reader.lost == 2


@pytest.mark.parametrize("transient_local", [False, True])
def test_a_late_reader_gets_old_samples_only_if_both_want_it(transient_local: bool) -> None:
    """A command that was written before a reader existed must not be executed when it appears."""
    pair = Pair(transient_local=transient_local, depth=3)
    pair.write(1, 2, 3, 4, then_s=1.0)
    pair.read()
    assert pair.log.payloads == (payloads(2, 3, 4) if transient_local else [])
    pair.write(5, then_s=0.1)
    assert pair.log.payloads[-1:] == payloads(5)
    assert pair.writer.unacknowledged == 0


def test_a_late_reader_that_requests_older_samples_gets_a_gap() -> None:
    pair = Pair()
    pair.write(1, 2)
    pair.read()
    pair.network.keep_sent = True
    ask = messages.acknack(pair.reader.entity, pair.writer.data.guid[12:], 1, (1, 2), 77, True)
    pair.network.arrive(B, (A, 7410), messages.header(pair.b.data.prefix) + ask)
    pair.network.run(0.01)
    ((datagram, _),) = pair.network.sent
    (part,) = messages.decode(memoryview(datagram), pair.b.data.prefix)
    assert isinstance(part, messages.Gap)
    assert (part.start, part.base) == (1, 3)


def test_a_reader_that_forgot_the_writer_gets_nothing_twice() -> None:
    """A driver was frozen for longer than its lease. The robot forgets it and discovers it again. No sample may
    be repeated."""
    pair = Pair(lease_s=3.0)
    pair.read()
    pair.write(1, 2, then_s=0.1)
    pair.network.fate = lambda datagram: () if datagram[8:20] == pair.a.data.prefix else undisturbed(datagram)
    pair.network.run(3.5)
    assert (pair.reader.matched, pair.a.peers) == (0, 1)
    pair.network.fate = undisturbed
    pair.network.run(1.5)
    assert pair.reader.matched == 1
    pair.write(3, then_s=0.1)
    assert pair.log.payloads == payloads(1, 2, 3)


def test_a_repeated_request_is_answered_once() -> None:
    pair = Pair()
    pair.read()
    pair.network.fate = lambda datagram: ()
    pair.write(1)
    pair.network.fate = undisturbed
    pair.network.keep_sent = True
    ask = messages.acknack(pair.reader.entity, pair.writer.data.guid[12:], 1, (1,), 99, True)
    for _ in range(3):
        pair.network.arrive(B, (A, 7410), messages.header(pair.b.data.prefix) + ask)
    pair.network.run(0.01)
    assert len(pair.network.sent) == 1


def test_a_repeated_heartbeat_is_answered_once() -> None:
    pair = Pair()
    pair.read()
    pair.network.keep_sent = True
    beat = messages.heartbeat(pair.reader.entity, pair.writer.data.guid[12:], 1, 0, 99, False)
    for _ in range(3):
        pair.network.arrive(A, (B, 7411), messages.header(pair.a.data.prefix) + beat)
    pair.network.run(0.01)
    assert len(pair.network.sent) == 1


def test_early_samples_wait_within_bounds() -> None:
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    for sequence in range(2, 1000):
        sent = messages.data(wire_types.UNKNOWN, guid[12:], sequence, payloads(sequence)[0])
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent)
    pair.network.run(0.01)
    (known,) = pair.reader._writers.values()
    assert len(known.early) == 255
    gap = messages.gap(pair.reader.entity, guid[12:], 1, 2)
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + gap)
    pair.network.run(0.01)
    assert pair.log.payloads == payloads(*range(2, 257))
    assert (len(known.early), known.waiting) == (0, 0)


def test_samples_that_come_too_early_are_bounded_in_bytes() -> None:
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    for sequence in range(2, 200):
        sent = messages.data(wire_types.UNKNOWN, guid[12:], sequence, bytes(14_000))
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent)
    pair.network.run(0.01)
    (known,) = pair.reader._writers.values()
    assert MAX_WAITING - 14_000 < known.waiting <= MAX_WAITING


@pytest.mark.parametrize("reliable", [False, True])
def test_a_disposal_is_not_a_sample(reliable: bool) -> None:
    pair = Pair(reliable)
    pair.read()
    guid = pair.writer.data.guid
    sent = messages.disposal(wire_types.UNKNOWN, guid[12:], 1, bytes(16), payloads(1)[0])
    empty = messages.data(wire_types.UNKNOWN, guid[12:], 2, b"")
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent + empty)
    pair.network.run(0.01)
    assert pair.log.payloads == []
    pair.network.arrive(
        A, (B, 7411), messages.header(guid[:12]) + messages.data(wire_types.UNKNOWN, guid[12:], 3, HEAD)
    )
    pair.network.run(0.01)
    assert pair.log.payloads == [HEAD]
