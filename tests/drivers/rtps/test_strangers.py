"""SAF-017 on DDS: a participant's name is no proof. A datagram counts only if it comes from the participant's
address and continues its numbers."""

from __future__ import annotations

import pytest

from strands_actors.drivers.common.rtps import discovery, messages, parameters, wire_types
from strands_actors.drivers.common.rtps.discovery import EndpointData, ParticipantData
from strands_actors.drivers.common.rtps.engine import MAX_PEERS, RESERVED
from strands_actors.drivers.common.rtps.peer_address import PeerAddress, parse_peer_address
from strands_actors.drivers.common.rtps.reader import LEAP, MAX_SAMPLE, REORDERED

from .pair import A, B, C, Network, Pair, payloads
from .test_discovery import announcement

FAR = 1 << 40


def in_the_name_of(pair: Pair, sequence: int, number: int = 999) -> bytes:
    """Return a datagram as this pair's writer sends it. All datagrams of the writer contain its GUID."""
    guid = pair.writer.data.guid
    return messages.header(guid[:12]) + messages.data(wire_types.UNKNOWN, guid[12:], sequence, payloads(number)[0])


@pytest.mark.parametrize("reliable", [False, True])
def test_saf_017_a_sample_in_a_peers_name_from_another_address_is_ignored(reliable: bool) -> None:
    pair = Pair(reliable)
    pair.read()
    pair.write(1, 2, then_s=0.01)
    pair.network.arrive(C, (B, 7411), in_the_name_of(pair, 3))
    pair.network.arrive(C, (B, 7411), in_the_name_of(pair, FAR))
    pair.network.run(0.01)
    pair.write(3, 4, 5, then_s=0.1)
    assert pair.log.payloads == payloads(1, 2, 3, 4, 5)
    assert pair.b.counters.misplaced == 2


def test_saf_017_a_goodbye_or_lost_reader_from_another_address_ends_nothing() -> None:
    pair = Pair()
    pair.read()
    prefix = pair.a.data.prefix
    guid = prefix + wire_types.PARTICIPANT
    goodbye = messages.disposal(
        wire_types.SPDP_READER,
        wire_types.SPDP_WRITER,
        2,
        guid,
        discovery.encode_ended(guid, parameters.PARTICIPANT_GUID),
    )
    pair.network.arrive(C, (B, 7410), messages.header(prefix) + goodbye)
    reader = pair.reader.data.guid
    lost = messages.disposal(
        wire_types.UNKNOWN,
        wire_types.SUBSCRIPTIONS_WRITER,
        2,
        reader,
        discovery.encode_ended(reader, parameters.ENDPOINT_GUID),
    )
    pair.network.arrive(C, (A, 7410), messages.header(pair.b.data.prefix) + lost)
    pair.network.run(0.05)
    assert (pair.reader.matched, pair.writer.matched) == (1, 1)
    assert (pair.a.counters.misplaced, pair.b.counters.misplaced) == (1, 1)


def test_saf_017_a_peer_cannot_send_in_the_name_of_another() -> None:
    """The attempt is a submessage that names another source than its datagram."""
    pair = Pair(reliable=False)
    pair.read()
    other = pair.network.participant(C, [B])
    pair.network.run(0.3)
    assert pair.b.peers == 2
    guid = pair.writer.data.guid
    named = messages._submessage(0x0C, 0, bytes(4) + b"\x02\x02\x01\x99" + guid[:12])
    for submessage in (messages.data(wire_types.UNKNOWN, guid[12:], 7, payloads(999)[0]), b""):
        pair.network.arrive(C, (B, 7411), messages.header(other.data.prefix) + named + submessage)
    pair.network.run(0.05)
    pair.write(1, then_s=0.05)
    assert pair.log.payloads == payloads(1)


# -- leaps


def test_saf_017_one_sample_that_leaps_does_not_end_those_behind_it() -> None:
    """This holds even for the robot's own address, which a stranger can forge."""
    pair = Pair(reliable=False)
    pair.read()
    for number in range(50):
        pair.write(number, then_s=0.002)
        if number == 20:
            pair.network.arrive(A, (B, 7411), in_the_name_of(pair, FAR))
    assert pair.log.payloads == payloads(*range(50))
    assert pair.reader.leaps == 1


def test_a_forged_first_sample_holds_the_true_ones_up_for_a_moment_only() -> None:
    pair = Pair(reliable=False)
    pair.read()
    pair.network.arrive(A, (B, 7411), in_the_name_of(pair, FAR))
    pair.network.run(0.001)
    for number in range(200):
        pair.write(number, then_s=0.002)
    assert pair.log.payloads[0] == payloads(999)[0]
    assert pair.log.payloads[1:] == payloads(*range(200))[-len(pair.log.payloads) + 1 :]
    assert len(pair.log.payloads) > 140


def test_a_writer_that_was_silent_goes_on_at_any_number() -> None:
    pair = Pair(reliable=False)
    pair.read()
    pair.write(1, then_s=0.2)
    pair.network.arrive(A, (B, 7411), in_the_name_of(pair, 5000, 2))
    pair.network.run(0.002)
    pair.network.arrive(A, (B, 7411), in_the_name_of(pair, 5000 + LEAP, 3))
    pair.network.run(0.002)
    pair.network.arrive(A, (B, 7411), in_the_name_of(pair, 5000 + LEAP - REORDERED, 4))
    pair.network.run(0.2)
    pair.network.arrive(A, (B, 7411), in_the_name_of(pair, 5000 + LEAP - 3, 5))  # late, not new
    pair.network.run(0.01)
    assert pair.log.payloads == payloads(1, 2, 3)


def test_saf_017_a_heartbeat_or_gap_with_a_far_number_skips_nothing() -> None:
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    pair.write(1, then_s=0.01)
    for part in (
        messages.heartbeat(wire_types.UNKNOWN, guid[12:], FAR, FAR, 77, True),
        messages.gap(wire_types.UNKNOWN, guid[12:], 1, FAR),
    ):
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + part)
        pair.network.run(0.01)
    pair.write(2, 3, then_s=0.1)
    assert pair.log.payloads == payloads(1, 2, 3)
    assert (pair.reader.leaps, pair.reader.lost) == (2, 0)


def test_a_reliable_writer_is_received_again_after_a_forged_heartbeat() -> None:
    """Its own heartbeats show that it was never at that number."""
    pair = Pair()
    pair.read()
    guid = pair.writer.data.guid
    pair.write(1, then_s=0.5)
    forged = messages.heartbeat(wire_types.UNKNOWN, guid[12:], FAR, FAR, 77, True)
    pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + forged)
    pair.network.run(2.0)
    for number in range(2, 30):
        pair.write(number, then_s=0.02)
    pair.network.run(0.5)
    assert pair.log.payloads[-20:] == payloads(*range(10, 30))


# -- places


def test_saf_017_a_participant_that_claims_the_robots_address_is_no_peer() -> None:
    network = Network()
    robot = network.participant(A, [B])
    driver = network.participant(B, [A])
    driver._only = PeerAddress(A)
    stranger = bytes(range(12))
    claim = ParticipantData(stranger, ((A, 7410), (C, 7410)), ((C, 7411),), 10.0)
    handshake = messages.data(
        wire_types.SPDP_READER, wire_types.SPDP_WRITER, 1, discovery.encode_participant(claim)
    )
    network.arrive(C, (B, 7410), messages.header(stranger) + handshake)
    network.run(0.5)
    assert list(driver._peers) == [robot.data.prefix]
    assert driver.counters.strangers == 1


@pytest.mark.parametrize(
    ("only", "sender", "is_there"),
    [
        ("10.0.0.1", (A, 7410), True),
        ("10.0.0.1", (A, 40000), True),
        ("10.0.0.1", (C, 7410), False),
        ("10.0.0.1:7410", (A, 7410), True),
        ("10.0.0.1:7410", (A, 7412), False),
        ("10.0.0.1:7412", (A, 7412), False),  # received from there, but not announced
    ],
)
def test_a_peers_address_is_the_one_that_it_sends_from(only: str, sender: tuple[str, int], is_there: bool) -> None:
    data = ParticipantData(bytes(12), ((A, 7410),), ((A, 7411),), 10.0)
    assert parse_peer_address(only).has(data, sender) is is_there


def test_saf_017_strangers_do_not_take_the_robots_place_in_the_table() -> None:
    network = Network()
    driver = network.participant(B, [A])
    for number in range(2 * MAX_PEERS):
        network.arrive(C, (B, 7410), announcement(number.to_bytes(12, "big"), C, 100.0))
    network.run(0.1)
    assert driver.peers == MAX_PEERS - RESERVED
    robot = network.participant(A, [B])
    network.run(0.5)
    assert robot.data.prefix in driver._peers


# -- fragments


def test_a_sample_that_is_longer_than_its_reader_takes_is_not_begun() -> None:
    pair = Pair(reliable=False)
    pair.read()
    guid = pair.writer.data.guid
    for total in (MAX_SAMPLE + 1, 4 << 20):
        piece, *_ = messages.fragments(wire_types.UNKNOWN, guid[12:], 1, bytes(total))
        pair.network.arrive(A, (B, 7411), messages.header(guid[:12]) + piece)
    pair.network.run(0.05)
    assert len(pair.b._reassembly) == pair.b._reassembly._bytes == 0
    assert pair.b.counters.refused == 2
    pair.write(1, then_s=0.05)
    assert pair.log.payloads == payloads(1)


def test_endpoints_are_accepted_only_from_their_owner() -> None:
    pair = Pair()
    pair.read()
    stolen = EndpointData(pair.a.data.prefix + b"evil", "rt/t", "T_", True, 0, ((C, 7411),))
    sent = messages.data(wire_types.UNKNOWN, wire_types.PUBLICATIONS_WRITER, 2, discovery.encode_endpoint(stolen))
    pair.network.arrive(C, (B, 7410), messages.header(pair.a.data.prefix) + sent)
    pair.network.run(0.05)
    assert stolen.guid not in pair.b._matching.hearing
