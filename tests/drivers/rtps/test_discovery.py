"""Test discovery between participants in virtual time: which peers are found, accepted and forgotten."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.rtps import discovery, messages, parameters, wire_types
from strands_actors.drivers.common.rtps.discovery import EndpointData, ParticipantData
from strands_actors.drivers.common.rtps.engine import MAX_PEERS, RESERVED
from strands_actors.drivers.common.rtps.matching import MAX_ENDPOINTS

from .pair import A, B, C, Log, Pair, payloads, undisturbed


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


def test_only_requested_topics_are_received() -> None:
    pair = Pair(reliable=False)
    pair.read()
    stranger, log = pair.a.writer("rt/other", "T_", False, False, 8), Log()
    pair.network.run(0.2)
    # It has no particular addressee, and still arrives at B, as through a shared locator.
    sent = messages.data(wire_types.UNKNOWN, stranger.data.guid[12:], 1, payloads(7)[0])
    pair.network.arrive(A, (B, 7411), messages.header(pair.a.data.prefix) + sent)
    pair.network.run(0.1)
    assert pair.log.payloads == log.payloads == []
    assert pair.b.counters.unmatched == 1


def test_a_sample_in_the_name_of_an_unknown_participant_is_ignored() -> None:
    pair = Pair(reliable=False)
    pair.read()
    sent = messages.data(wire_types.UNKNOWN, pair.writer.data.guid[12:], 1, payloads(7)[0])
    pair.network.arrive(C, (B, 7411), messages.header(bytes(12)) + sent)
    pair.network.run(0.1)
    assert pair.log.payloads == []


def test_other_types_do_not_match_and_the_reason_is_given() -> None:
    pair = Pair()
    reader = pair.b.reader("rt/t", "Other_", True, False, pair.log)
    pair.network.run(0.5)
    assert pair.writer.matched == reader.matched == 0
    assert "T_" in reader.mismatch
    assert "Other_" in pair.writer.mismatch


def test_a_peer_that_does_not_know_us_is_not_matched() -> None:
    """B has announced its reader but does not know A's writer. B would not accept A's samples now."""
    pair = Pair(reliable=False)
    pair.reader = pair.b.reader("rt/t", "T_", False, False, pair.log)
    from_a = pair.a.data.prefix
    pair.network.fate = lambda sent: () if sent[8:20] == from_a and b"rt/t" in sent else undisturbed(sent)
    pair.network.run(1.0)
    assert (pair.writer.write(payloads(1)[0]), pair.writer.matched) == (1, 0)
    pair.network.fate = undisturbed
    pair.network.run(0.3)
    assert (pair.writer.matched, pair.reader.matched) == (1, 1)


def test_a_reliable_reader_that_never_answered_is_asked_again() -> None:
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
    """Return True if the datagram has an ACKNACK of this reader."""
    to = datagram[24:36] if datagram[20] == 0x0E else bytes(12)  # decoded as its addressee
    parts = messages.decode(memoryview(datagram), to)
    return any(isinstance(part, messages.AckNack) and part.reader[12:] == reader for part in parts)


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


def test_a_peer_cannot_send_a_goodbye_for_another() -> None:
    pair = Pair()
    pair.read()
    guid = pair.a.data.prefix + wire_types.PARTICIPANT
    key = discovery.encode_ended(guid, parameters.PARTICIPANT_GUID)
    sent = messages.disposal(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 2, guid, key)
    pair.network.arrive(C, (B, 7410), messages.header(bytes(12)) + sent)
    pair.network.run(0.1)
    assert pair.reader.matched == 1


def test_a_peer_cannot_announce_for_another() -> None:
    pair = Pair()
    pair.read()
    other = bytes(range(12))
    prefix = pair.a.data.prefix
    handshake = discovery.encode_participant(ParticipantData(other, ((C, 7410),), (), 10.0))
    writer = EndpointData(other + pair.writer.data.guid[12:], "rt/t", "T_", True, 0, ((C, 7411),))
    gone = discovery.encode_ended(other + wire_types.PARTICIPANT, parameters.PARTICIPANT_GUID)
    for submessage in (
        messages.data(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 1, handshake),
        messages.data(wire_types.UNKNOWN, wire_types.PUBLICATIONS_WRITER, 2, discovery.encode_endpoint(writer)),
        messages.disposal(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 2, other + wire_types.PARTICIPANT, gone),
    ):
        pair.network.arrive(A, (B, 7410), messages.header(prefix) + submessage)
    pair.network.run(0.1)
    assert pair.b.counters.malformed == 2  # a goodbye in another participant's name is only ignored
    assert (pair.b.peers, pair.reader.matched) == (1, 1)
    assert writer.guid not in pair.b._matching.hearing


def test_a_reader_that_ends_is_written_to_no_more() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.reader.data.guid
    key = discovery.encode_ended(guid, parameters.ENDPOINT_GUID)
    sent = messages.disposal(wire_types.UNKNOWN, wire_types.SUBSCRIPTIONS_WRITER, 2, guid, key)
    pair.network.arrive(B, (A, 7410), messages.header(pair.b.data.prefix) + sent)
    pair.network.run(0.1)
    assert pair.writer.matched == 0
    assert pair.writer.write(payloads(1)[0]) == 0


def announcement(prefix: bytes, host: str, lease_s: float = 10.0) -> bytes:
    data = ParticipantData(prefix, ((host, 7410),), ((host, 7411),), lease_s)
    return messages.header(prefix) + messages.data(
        wire_types.SPDP_READER, wire_types.SPDP_WRITER, 1, discovery.encode_participant(data)
    )


def test_a_peer_that_moved_is_found_again_after_its_old_address_is_silent() -> None:
    pair = Pair(lease_s=1.0)
    pair.read()
    moved = announcement(pair.a.data.prefix, C)
    pair.network.keep_sent = True
    pair.network.arrive(C, (B, 7410), moved)
    pair.network.run(0.01)
    assert (C, 7410) not in {address for _, address in pair.network.sent}
    assert pair.b.counters.misplaced == 1
    del pair.network.engines[A]
    pair.network.run(1.2)
    pair.network.arrive(C, (B, 7410), moved)
    pair.network.run(0.01)
    assert (C, 7410) in {address for _, address in pair.network.sent}
    assert pair.b.peers == 1


def test_tables_are_bounded() -> None:
    pair = Pair()
    pair.read()
    for number in range(2 * MAX_PEERS):
        pair.network.arrive(C, (B, 7410), announcement(number.to_bytes(12, "big"), C, 100.0))
    pair.network.run(0.1)
    assert pair.b.peers == MAX_PEERS - RESERVED
    assert pair.b.counters.refused > MAX_PEERS - 2
    matching = pair.b._matching
    for number in range(2 * MAX_ENDPOINTS):
        guid = pair.a.data.prefix + number.to_bytes(4, "big")
        matching.learn_writer(EndpointData(guid, f"rt/{number}", "T_", False, 0, ()))
    assert len(matching._remote_writers) == MAX_ENDPOINTS
    assert pair.reader.matched == 1
    # An endpoint of one of our topics always has room.
    guid = pair.a.data.prefix + b"last"
    assert matching.learn_writer(EndpointData(guid, "rt/t", "T_", True, 0, ()))
    assert len(matching._remote_writers) == MAX_ENDPOINTS
    assert matching.hearing[guid] == (pair.reader,)
