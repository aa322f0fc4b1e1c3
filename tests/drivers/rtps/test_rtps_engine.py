"""Participants in virtual time: who finds whom, what is delivered, what is asked for again, what is forgotten."""

from __future__ import annotations

import pytest
from rtps_pair import Log, Network, undisturbed

from strands_actors.drivers.common.rtps import discovery, messages, parameters, words
from strands_actors.drivers.common.rtps.discovery import EndpointData, ParticipantData
from strands_actors.drivers.common.rtps.engine import MAX_PEERS
from strands_actors.drivers.common.rtps.matching import MAX_ENDPOINTS
from strands_actors.drivers.common.rtps.messages import Fragment
from strands_actors.drivers.common.rtps.reader import MAX_WAITING
from strands_actors.drivers.common.rtps.reassembly import MAX_BYTES, MAX_SAMPLES, PATIENCE_NS, Reassembly
from strands_actors.drivers.common.rtps.words import Malformed

A, B, C = "10.0.0.1", "10.0.0.2", "10.0.0.3"
HEAD = b"\x00\x01\x00\x00"


def payloads(*numbers: int) -> list[bytes]:
    return [HEAD + number.to_bytes(4, "little") for number in numbers]


class Pair:
    """A writes ``rt/t`` to B."""

    def __init__(
        self, reliable: bool = True, transient_local: bool = False, depth: int = 8, lease_s: float = 10.0
    ) -> None:
        self.network = Network()
        self.a = self.network.participant(A, [B], lease_s)
        self.b = self.network.participant(B, [])
        self.log = Log()
        self.writer = self.a.writer("rt/t", "T_", reliable, transient_local, depth)
        self.qos = (reliable, transient_local)

    def read(self) -> None:
        self.reader = self.b.reader("rt/t", "T_", *self.qos, self.log)
        self.network.run(0.5)
        assert self.writer.matched == self.reader.matched == 1

    def write(self, *numbers: int, then_s: float = 0.0) -> None:
        for payload in payloads(*numbers):
            self.writer.write(payload)
        self.network.run(then_s)


# -- discovery


def test_they_find_each_other_within_two_announcements() -> None:
    pair = Pair()
    pair.reader = pair.b.reader("rt/t", "T_", True, False, pair.log)
    pair.network.run(0.06)
    assert pair.writer.matched == pair.reader.matched == 1


@pytest.mark.parametrize("reliable", [False, True])
def test_endpoints_made_before_and_after_discovery_match(reliable: bool) -> None:
    pair = Pair(reliable)
    pair.network.run(1.0)
    pair.read()
    late = pair.a.writer("rt/t", "T_", reliable, False, 8)
    pair.network.run(0.5)
    assert (pair.writer.matched, late.matched, pair.reader.matched) == (1, 1, 2)
    pair.write(1, then_s=0.1)
    late.write(payloads(2)[0])
    pair.network.run(0.1)
    assert pair.log.payloads == payloads(1, 2)
    assert pair.log.writers == [pair.writer.data.guid, late.data.guid]


def test_only_topics_asked_for_are_heard() -> None:
    pair = Pair(reliable=False)
    pair.read()
    stranger, log = pair.a.writer("rt/other", "T_", False, False, 8), Log()
    pair.network.run(0.2)
    # Addressed to nobody in particular and sent to B all the same: a shared locator does that.
    sent = messages.data(words.UNKNOWN, stranger.data.guid[12:], 1, payloads(7)[0])
    pair.network.arrive(A, (B, 7411), messages.header(pair.a.data.prefix) + sent)
    pair.network.run(0.1)
    assert pair.log.payloads == log.payloads == []
    assert pair.b.counters.unmatched == 1


def test_a_sample_in_the_name_of_an_unknown_participant_is_not_heard() -> None:
    pair = Pair(reliable=False)
    pair.read()
    sent = messages.data(words.UNKNOWN, pair.writer.data.guid[12:], 1, payloads(7)[0])
    pair.network.arrive(C, (B, 7411), messages.header(bytes(12)) + sent)
    pair.network.run(0.1)
    assert pair.log.payloads == []


def test_other_types_do_not_match_and_it_is_said_why() -> None:
    pair = Pair()
    reader = pair.b.reader("rt/t", "Other_", True, False, pair.log)
    pair.network.run(0.5)
    assert pair.writer.matched == reader.matched == 0
    assert "T_" in reader.mismatch
    assert "Other_" in pair.writer.mismatch


def test_a_peer_that_falls_silent_is_forgotten_after_its_lease() -> None:
    pair = Pair(lease_s=3.0)
    pair.read()
    pair.network.fate = lambda datagram: ()
    pair.network.run(2.5)
    assert pair.reader.matched == 1
    pair.network.run(1.0)
    assert (pair.reader.matched, pair.b.peers) == (0, 0)
    assert pair.writer.matched == 1  # B promised 10 s
    pair.network.fate = undisturbed
    pair.network.run(1.5)
    assert (pair.reader.matched, pair.writer.matched) == (1, 1)
    pair.write(1, then_s=0.1)
    assert pair.log.payloads == payloads(1)


def test_a_peer_that_says_goodbye_is_forgotten_at_once() -> None:
    pair = Pair()
    pair.read()
    pair.a.say_goodbye()
    del pair.network.engines[A]
    pair.network.run(0.01)
    assert (pair.reader.matched, pair.b.peers) == (0, 0)


def test_nobody_can_say_goodbye_for_another() -> None:
    pair = Pair()
    pair.read()
    guid = pair.a.data.prefix + words.PARTICIPANT
    key = discovery.encode_gone(guid, parameters.PARTICIPANT_GUID)
    sent = messages.disposal(words.SPDP_READER, words.SPDP_WRITER, 2, guid, key)
    pair.network.arrive(C, (B, 7410), messages.header(bytes(12)) + sent)
    pair.network.run(0.1)
    assert pair.reader.matched == 1


def test_a_reader_that_ends_is_written_to_no_more() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.reader.data.guid
    key = discovery.encode_gone(guid, parameters.ENDPOINT_GUID)
    sent = messages.disposal(words.UNKNOWN, words.SUBSCRIPTIONS_WRITER, 2, guid, key)
    pair.network.arrive(B, (A, 7410), messages.header(pair.b.data.prefix) + sent)
    pair.network.run(0.1)
    assert pair.writer.matched == 0
    assert pair.writer.write(payloads(1)[0]) == 0


def test_a_peer_that_has_moved_is_met_anew() -> None:
    pair = Pair()
    pair.read()
    moved = ParticipantData(pair.a.data.prefix, ((C, 7410),), ((C, 7411),), 10.0)
    hello = messages.data(words.SPDP_READER, words.SPDP_WRITER, 1, discovery.encode_participant(moved))
    pair.network.keep_sent = True
    pair.network.arrive(C, (B, 7410), messages.header(moved.prefix) + hello)
    pair.network.run(0.01)
    assert (C, 7410) in {address for _, address in pair.network.sent}
    assert pair.b.peers == 1


def test_tables_are_bounded() -> None:
    pair = Pair()
    pair.read()
    for number in range(2 * MAX_PEERS):
        prefix = number.to_bytes(12, "big")
        data = ParticipantData(prefix, ((C, 7410),), (), 100.0)
        hello = messages.data(words.SPDP_READER, words.SPDP_WRITER, 1, discovery.encode_participant(data))
        pair.network.arrive(C, (B, 7410), messages.header(prefix) + hello)
    pair.network.run(0.1)
    assert pair.b.peers == MAX_PEERS
    assert pair.b.counters.refused > MAX_PEERS - 2
    matching = pair.b._matching
    for number in range(2 * MAX_ENDPOINTS):
        guid = pair.a.data.prefix + number.to_bytes(4, "big")
        matching.learn_writer(EndpointData(guid, f"rt/{number}", "T_", False, 0, ()))
    assert len(matching._remote_writers) == MAX_ENDPOINTS
    assert pair.reader.matched == 1
    # One of a topic of ours always has room.
    guid = pair.a.data.prefix + b"last"
    assert matching.learn_writer(EndpointData(guid, "rt/t", "T_", True, 0, ()))
    assert len(matching._remote_writers) == MAX_ENDPOINTS
    assert matching.hearing[guid] == (pair.reader,)


# -- best effort


def test_best_effort_takes_the_newer_and_drops_the_rest() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.writer.data.guid
    for sequence in (1, 2, 2, 5, 4, 3, 5, 6):
        sent = messages.data(words.UNKNOWN, guid[12:], sequence, payloads(sequence)[0])
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


def test_what_was_lost_is_asked_for_again_and_delivered_in_order() -> None:
    pair = Pair()
    pair.read()
    pair.write(1, then_s=0.01)
    pair.network.fate = lambda datagram: ()
    pair.write(2, 3)
    pair.network.fate = undisturbed
    pair.write(4)
    pair.network.run(0.0005)  # one round trip: the heartbeat that came with 4 said so
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
    assert to == {(A, 7410), (B, 7410)}  # all is acknowledged: they announce themselves, no more


def test_what_fell_out_of_the_history_is_given_up() -> None:
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
    """A command that was written before somebody listened must not be executed when he begins to."""
    pair = Pair(transient_local=transient_local, depth=3)
    pair.write(1, 2, 3, 4, then_s=1.0)
    pair.read()
    assert pair.log.payloads == (payloads(2, 3, 4) if transient_local else [])
    pair.write(5, then_s=0.1)
    assert pair.log.payloads[-1:] == payloads(5)
    assert pair.writer.unacknowledged == 0


def test_a_late_reader_that_asks_for_what_is_not_its_business_gets_a_gap() -> None:
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
    """A driver frozen for longer than its lease: the robot forgets it, meets it anew, must repeat nothing."""
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


def test_what_comes_too_early_waits_within_bounds() -> None:
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    for sequence in range(2, 1000):
        sent = messages.data(words.UNKNOWN, guid[12:], sequence, payloads(sequence)[0])
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent)
    pair.network.run(0.01)
    (known,) = pair.reader._writers.values()
    assert len(known.early) == 255
    gap = messages.gap(pair.reader.entity, guid[12:], 1, 2)
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + gap)
    pair.network.run(0.01)
    assert pair.log.payloads == payloads(*range(2, 257))
    assert (len(known.early), known.waiting) == (0, 0)


@pytest.mark.parametrize("reliable", [False, True])
def test_a_disposal_is_not_a_sample(reliable: bool) -> None:
    pair = Pair(reliable)
    pair.read()
    guid = pair.writer.data.guid
    sent = messages.disposal(words.UNKNOWN, guid[12:], 1, bytes(16), payloads(1)[0])
    empty = messages.data(words.UNKNOWN, guid[12:], 2, b"")
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent + empty)
    pair.network.run(0.01)
    assert pair.log.payloads == []
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + messages.data(words.UNKNOWN, guid[12:], 3, HEAD))
    pair.network.run(0.01)
    assert pair.log.payloads == [HEAD]


# -- fragments


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
        words.UNKNOWN, bytes([writer]) * 16, sequence, index, 1, size, total, memoryview(bytes(size)), False
    )


def test_reassembly_is_bounded_in_number_size_and_time() -> None:
    parts = Reassembly()
    for sequence in range(100):
        parts.add(fragment(sequence), 0)
    assert (len(parts), parts.given_up) == (MAX_SAMPLES, 100 - MAX_SAMPLES)
    parts.tick(PATIENCE_NS)
    assert len(parts) == MAX_SAMPLES
    parts.tick(PATIENCE_NS + 1)
    assert len(parts) == parts._bytes == 0
    with pytest.raises(Malformed):
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
    with pytest.raises(Malformed):
        parts.add(fragment(1, 1, total=40), 0)
    assert len(parts) == 0


def test_fragments_whose_rest_never_comes_are_given_up() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.writer.data.guid
    piece, *_ = messages.fragments(words.UNKNOWN, guid[12:], 1, bytes(50_000))
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + piece)
    pair.network.run(0.1)
    assert len(pair.b._reassembly) == 1
    pair.network.run(1.2)
    assert len(pair.b._reassembly) == 0


# -- what else must not be believed, and what must be said


def test_nobody_speaks_for_another() -> None:
    pair = Pair()
    pair.read()
    other = bytes(range(12))
    prefix = pair.a.data.prefix
    hello = discovery.encode_participant(ParticipantData(other, ((C, 7410),), (), 10.0))
    writer = EndpointData(other + pair.writer.data.guid[12:], "rt/t", "T_", True, 0, ((C, 7411),))
    gone = discovery.encode_gone(other + words.PARTICIPANT, parameters.PARTICIPANT_GUID)
    for submessage in (
        messages.data(words.SPDP_READER, words.SPDP_WRITER, 1, hello),
        messages.data(words.UNKNOWN, words.PUBLICATIONS_WRITER, 2, discovery.encode_endpoint(writer)),
        messages.disposal(words.SPDP_READER, words.SPDP_WRITER, 2, other + words.PARTICIPANT, gone),
    ):
        pair.network.arrive(A, (B, 7410), messages.header(prefix) + submessage)
    pair.network.run(0.1)
    assert pair.b.counters.malformed == 2  # a goodbye in another's name is only ignored
    assert (pair.b.peers, pair.reader.matched) == (1, 1)
    assert writer.guid not in pair.b._matching.hearing


def test_a_repeated_heartbeat_is_answered_once() -> None:
    pair = Pair()
    pair.read()
    pair.network.keep_sent = True
    beat = messages.heartbeat(pair.reader.entity, pair.writer.data.guid[12:], 1, 0, 99, False)
    for _ in range(3):
        pair.network.arrive(A, (B, 7411), messages.header(pair.a.data.prefix) + beat)
    pair.network.run(0.01)
    assert len(pair.network.sent) == 1


def test_samples_that_come_too_early_are_bounded_in_bytes() -> None:
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    for sequence in range(2, 200):
        sent = messages.data(words.UNKNOWN, guid[12:], sequence, bytes(14_000))
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + sent)
    pair.network.run(0.01)
    (known,) = pair.reader._writers.values()
    assert MAX_WAITING - 14_000 < known.waiting <= MAX_WAITING


def test_who_does_not_know_of_us_is_not_matched() -> None:
    """B has announced its reader, and does not hear of A's writer: what A wrote now, B would not take."""
    pair = Pair(reliable=False)
    pair.reader = pair.b.reader("rt/t", "T_", False, False, pair.log)
    from_a = pair.a.data.prefix
    pair.network.fate = lambda sent: () if sent[8:20] == from_a and b"rt/t" in sent else undisturbed(sent)
    pair.network.run(1.0)
    assert (pair.writer.write(payloads(1)[0]), pair.writer.matched) == (1, 0)
    pair.network.fate = undisturbed
    pair.network.run(0.3)
    assert (pair.writer.matched, pair.reader.matched) == (1, 1)


def test_a_reliable_reader_that_was_never_heard_is_asked_again() -> None:
    pair = Pair()
    pair.reader = pair.b.reader("rt/t", "T_", True, False, pair.log)
    entity = pair.reader.entity
    pair.network.fate = lambda sent: () if is_acknack_of(sent, entity) else undisturbed(sent)
    pair.network.run(1.0)
    assert (pair.writer.matched, pair.reader.matched) == (0, 1)
    pair.network.fate = undisturbed
    pair.network.run(0.2)
    assert pair.writer.matched == 1


def is_acknack_of(datagram: bytes, reader: bytes) -> bool:
    """Whether it has an ACKNACK of this reader."""
    to = datagram[24:36] if datagram[20] == 0x0E else bytes(12)  # as whom it is addressed to hears it
    parts = messages.decode(memoryview(datagram), to)
    return any(isinstance(part, messages.AckNack) and part.reader[12:] == reader for part in parts)
