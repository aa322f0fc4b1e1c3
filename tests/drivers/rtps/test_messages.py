"""Test the codec: encoded values decode to the same in both byte orders, and truncated input is malformed."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.rtps import discovery, messages, parameters, wire_types
from strands_actors.drivers.common.rtps.discovery import EndpointData, ParticipantData
from strands_actors.drivers.common.rtps.messages import AckNack, Data, Fragment, Gap, Heartbeat

PEER = bytes(range(12))
OWN = bytes(range(100, 112))
READER = wire_types.reader_id(1)
WRITER = wire_types.writer_id(2)

sequences = st.integers(1, 2**61)
counts = st.integers(0, 2**32 - 1)
hosts = st.tuples(*(st.integers(0, 255) for _ in range(4))).map(lambda parts: ".".join(map(str, parts)))
addresses = st.lists(st.tuples(hosts, st.integers(1, 65535)), max_size=4).map(tuple)
names = st.text(st.characters(codec="utf-8", exclude_characters="\x00"), min_size=1, max_size=60)


def decoded(*submessages: bytes) -> list[messages.Submessage]:
    return messages.decode(memoryview(messages.header(PEER) + b"".join(submessages)), OWN)


@given(sequences, st.binary(max_size=70))
def test_data(sequence: int, payload: bytes) -> None:
    (part,) = decoded(messages.data(READER, WRITER, sequence, payload))
    assert isinstance(part, Data)
    assert part[:3] == (READER, PEER + WRITER, sequence)
    assert part.payload[: len(payload)] == payload
    assert len(part.payload) - len(payload) == -len(payload) % 4
    assert not part.disposed


@given(st.lists(st.tuples(sequences, st.binary(max_size=70), counts), min_size=1, max_size=4), st.booleans())
def test_a_frame_is_used_again_and_again(written: list[tuple[int, bytes, int]], reliable: bool) -> None:
    frame = messages.Frame(PEER, WRITER, reliable)
    for sequence, payload, count in written:
        datagram = b"".join(frame.parts(sequence, payload, sequence, count))
        part, *beat = messages.decode(memoryview(datagram), OWN)
        assert isinstance(part, Data)
        assert part[:3] == (wire_types.UNKNOWN, PEER + WRITER, sequence)
        assert part.payload[: len(payload)] == payload
        expected = Heartbeat(wire_types.UNKNOWN, PEER + WRITER, sequence, sequence, count, True)
        assert beat == ([expected] if reliable else [])


@given(sequences, st.integers(0, 1000), counts, st.booleans())
def test_heartbeat(first: int, length: int, count: int, final: bool) -> None:
    sent = messages.heartbeat(READER, WRITER, first, first + length - 1, count, final)
    assert decoded(sent) == [Heartbeat(READER, PEER + WRITER, first, first + length - 1, count, final)]


@given(sequences, st.sets(st.integers(0, 255)), counts, st.booleans())
def test_acknack(base: int, offsets: set[int], count: int, final: bool) -> None:
    missing = tuple(base + offset for offset in sorted(offsets))
    sent = messages.acknack(READER, WRITER, base, missing, count, final)
    assert decoded(sent) == [AckNack(PEER + READER, WRITER, base, missing, count, final)]


@given(sequences, st.integers(1, 1000))
def test_gap(start: int, length: int) -> None:
    sent = messages.gap(READER, WRITER, start, start + length)
    assert decoded(sent) == [Gap(READER, PEER + WRITER, start, start + length, ())]


@given(st.integers(1, 5 * messages.FRAGMENT_SIZE))
def test_fragments(size: int) -> None:
    payload = bytes(at * 7 & 0xFF for at in range(size))
    whole = bytearray(size)
    covered = 0
    for piece in messages.fragments(READER, WRITER, 9, payload):
        (part,) = decoded(piece)
        assert isinstance(part, Fragment)
        assert (part.reader, part.writer, part.sequence, part.total) == (READER, PEER + WRITER, 9, size)
        whole[part.first * part.size : part.first * part.size + len(part.payload)] = part.payload
        covered += len(part.payload)
    assert covered == size
    assert whole == payload


def test_big_endian_is_understood() -> None:
    body = READER + WRITER + struct.pack(">iIiII", 0, 3, 0, 9, 5)
    heartbeat = b"\x07\x02" + struct.pack(">H", len(body)) + body
    body = READER + WRITER + struct.pack(">iIIII", 0, 3, 2, 0x4000_0000, 6)
    acknack = b"\x06\x00" + struct.pack(">H", len(body)) + body
    body = struct.pack(">HH", 0, 16) + READER + WRITER + struct.pack(">iI", 1, 2) + b"\x00\x00\x00\x00ab"
    data = b"\x15\x04" + struct.pack(">H", 0) + body  # length 0: up to the end
    beat, ack, part = decoded(heartbeat, acknack, data)
    assert beat == Heartbeat(READER, PEER + WRITER, 3, 9, 5, True)
    assert ack == AckNack(PEER + READER, WRITER, 3, (4,), 6, False)
    assert isinstance(part, Data)
    assert (part.sequence, bytes(part.payload)) == (2**32 + 2, b"\x00\x00\x00\x00ab")


def test_a_disposal_is_no_data() -> None:
    guid = PEER + wire_types.PARTICIPANT
    key = discovery.encode_ended(guid, parameters.PARTICIPANT_GUID)
    (part,) = decoded(messages.disposal(wire_types.SPDP_READER, wire_types.SPDP_WRITER, 2, guid, key))
    assert isinstance(part, Data)
    assert part.disposed
    assert discovery.ended_guid(part.payload, part.key, parameters.PARTICIPANT_GUID) == guid
    assert discovery.ended_guid(part.payload, b"", parameters.PARTICIPANT_GUID) == guid


def test_only_messages_addressed_to_us_are_read() -> None:
    beat = messages.heartbeat(READER, WRITER, 1, 2, 3, True)
    everybody = messages.info_destination(bytes(12))
    other, us = messages.info_destination(PEER[::-1]), messages.info_destination(OWN)
    assert len(decoded(beat)) == 1
    assert len(decoded(us, beat)) == 1
    assert len(decoded(other, beat)) == 0
    assert len(decoded(other, beat, us, beat, everybody, beat)) == 2
    assert messages.decode(memoryview(messages.header(OWN) + us + beat), OWN) == []  # our own datagram


def test_unknown_parts_are_skipped() -> None:
    beat = messages.heartbeat(READER, WRITER, 1, 2, 3, True)
    timestamp = b"\x09\x01\x08\x00" + bytes(8)
    assert len(decoded(timestamp, b"\x80\x01\x04\x00abcd", b"\x01\x01\x00\x00", b"\x09\x03\x00\x00", beat)) == 1


@given(st.data())
def test_a_truncated_datagram_adds_nothing(choice: st.DataObject) -> None:
    submessages = (
        messages.info_destination(OWN),
        messages.data(READER, WRITER, 7, b"\x00\x01\x00\x00" + bytes(20)),
        messages.acknack(READER, WRITER, 3, (3, 40), 1, True),
        messages.gap(READER, WRITER, 3, 9),
        *messages.fragments(READER, WRITER, 9, bytes(40)),
        messages.disposal(READER, WRITER, 7, PEER + WRITER, b""),
        messages.heartbeat(READER, WRITER, 3, 9, 2, True),
    )
    datagram = messages.header(PEER) + b"".join(submessages)
    borders = [20 + sum(map(len, submessages[:at])) for at in range(len(submessages) + 1)]
    size = choice.draw(st.integers(0, len(datagram) - 1))
    cut = memoryview(datagram)[:size]
    if size in borders:
        assert len(messages.decode(cut, OWN)) == max(0, borders.index(size) - 1)
    else:
        with pytest.raises(MalformedFrame):
            messages.decode(cut, OWN)


FRAGMENT = struct.pack("<HH", 0, 28) + READER + WRITER
SAMPLE = struct.pack("<HH", 0, 16) + READER + WRITER


def submessage(kind: int, flags: int, body: bytes) -> bytes:
    return bytes((kind, flags | 1)) + struct.pack("<H", len(body)) + body


@pytest.mark.parametrize(
    "nonsense",
    [
        messages.data(READER, WRITER, 0, b""),  # numbers begin with 1
        messages.heartbeat(READER, WRITER, 0, 5, 1, True),
        messages.heartbeat(READER, WRITER, 5, 3, 1, True),  # the last before the first
        messages.gap(READER, WRITER, 9, 8),
        submessage(0x06, 0, READER + WRITER + struct.pack("<iIIII", 0, 1, 257, 0, 0)),  # 257 bits
        submessage(0x16, 0, FRAGMENT + struct.pack("<iIIHHII", 0, 1, 3, 1, 2, 4, 0)),  # past the end of its sample
        submessage(0x16, 0, FRAGMENT + struct.pack("<iIIHHII", 0, 1, 0, 1, 2, 4, 0)),  # pieces begin with 1
        submessage(0x16, 0, FRAGMENT + struct.pack("<iIIHHII", 0, 1, 1, 1, 1, 2**20, 0)),  # too many pieces
        submessage(0x15, 0x0C, SAMPLE + struct.pack("<iI", 0, 1)),  # data and key
        submessage(0x15, 0x04, SAMPLE.replace(b"\x10", b"\x0f") + struct.pack("<iI", 0, 1)),  # QoS in the head
        submessage(0x15, 0x06, SAMPLE + struct.pack("<iIHH", 0, 1, 0x70, 99)),  # QoS past the end
    ],
)
def test_nonsense_is_malformed(nonsense: bytes) -> None:
    with pytest.raises(MalformedFrame):
        decoded(nonsense)


# -- discovery data


@given(addresses.filter(len), addresses, st.floats(0.5, 600.0))
def test_participant_data(reached: tuple, user: tuple, lease_s: float) -> None:  # type: ignore[type-arg]
    sent = ParticipantData(PEER, reached, user, lease_s)
    found = discovery.decode_participant(memoryview(discovery.encode_participant(sent)))
    assert found.prefix == PEER
    assert found.discovery == reached
    assert found.user == (user or reached)
    assert found.lease_s == pytest.approx(lease_s, abs=1e-6)


@given(names, names, st.booleans(), st.sampled_from((0, 1)), addresses, st.booleans())
def test_endpoint_data(
    topic: str,
    type_name: str,
    reliable: bool,
    durability: int,
    locators: tuple,  # type: ignore[type-arg]
    is_writer: bool,
) -> None:
    sent = EndpointData(PEER + WRITER, topic, type_name, reliable, durability, locators)
    assert discovery.decode_endpoint(memoryview(discovery.encode_endpoint(sent)), is_writer) == sent


def test_missing_fields_of_an_endpoint_have_defaults() -> None:
    said = parameters.payload(
        parameters.encoded(parameters.ENDPOINT_GUID, PEER + WRITER),
        parameters.encoded_text(parameters.TOPIC, "rt/lowstate"),
        parameters.encoded_text(parameters.TYPE, "LowState_"),
        parameters.encoded(0x8021, b"of a vendor"),
    )
    writer = discovery.decode_endpoint(memoryview(said), is_writer=True)
    reader = discovery.decode_endpoint(memoryview(said), is_writer=False)
    assert (writer.reliable, reader.reliable) == (True, False)
    assert writer.durability == reader.durability == discovery.VOLATILE


def test_we_announce_protocol_2_2_and_no_vendor_parameter() -> None:
    """Booster's Fast DDS drops participants that send 0x8007, or a version from 2.3 on. Type information (0x75
    and 0x8021) of one generation of CycloneDDS crashes another."""
    data = ParticipantData(PEER, (("10.0.0.1", 7410),), (), 10.0)
    ends = EndpointData(PEER + WRITER, "rt/lowcmd", "LowCmd_", True, 1, (("10.0.0.1", 7411),))
    assert messages.header(PEER)[:6] == b"RTPS\x02\x02"
    for payload in (discovery.encode_participant(data), discovery.encode_endpoint(ends)):
        at, ids = 4, []
        while at < len(payload):
            parameter, length = struct.unpack_from("<HH", payload, at)
            ids.append(parameter)
            at += 4 + length
        assert ids[-1] == parameters.SENTINEL
        assert max(ids) < 0x75


@given(st.binary(max_size=200))
def test_discovery_data_of_any_bytes_decodes_or_is_malformed(content: bytes) -> None:
    for payload in (content, b"\x00\x03\x00\x00" + content, b"\x00\x02\x00\x00" + content):
        for decode in (
            discovery.decode_participant,
            lambda view: discovery.decode_endpoint(view, True),
            lambda view: discovery.ended_guid(view, b"", parameters.ENDPOINT_GUID),
        ):
            try:
                decode(memoryview(payload))
            except MalformedFrame:
                continue


known_ids = st.sampled_from((0x02, 0x05, 0x07, 0x1A, 0x1D, 0x29, 0x2F, 0x31, 0x32, 0x50, 0x5A))


@given(st.lists(st.tuples(known_ids, st.binary(max_size=40)), max_size=12))
def test_parameters_with_any_values_decode_or_are_malformed(found: list[tuple[int, bytes]]) -> None:
    payload = parameters.payload(*(parameters.encoded(name, value) for name, value in found))
    for decode in (discovery.decode_participant, lambda view: discovery.decode_endpoint(view, False)):
        try:
            decode(memoryview(payload))
        except MalformedFrame:
            continue


def test_partitions() -> None:
    two = struct.pack("<I", 2) + struct.pack("<I", 2) + b"a\x00\x00\x00" + struct.pack("<I", 5) + b"bbbb\x00"
    said = parameters.payload(
        parameters.encoded(parameters.ENDPOINT_GUID, PEER + WRITER),
        parameters.encoded_text(parameters.TOPIC, "t"),
        parameters.encoded_text(parameters.TYPE, "T"),
        parameters.encoded(parameters.PARTITION, two),
    )
    assert discovery.decode_endpoint(memoryview(said), True).partitions == ("a", "bbbb")


# -- matching types and QoS


ENDPOINT = EndpointData(PEER + WRITER, "t", "T", False, 0, ())


@pytest.mark.parametrize(
    ("writer", "reader", "word"),
    [
        ({}, {}, ""),
        ({"reliable": True}, {}, ""),
        ({}, {"reliable": True}, "best effort"),
        ({"durability": 1}, {}, ""),
        ({}, {"durability": 1}, "durability"),
        ({"type_name": "unitree_go::msg::dds_::LowCmd_"}, {}, "unitree_go"),
        ({"exclusive": True}, {}, "ownership"),
        ({"partitions": ("a",)}, {}, "partitions"),
        ({"partitions": ("a", "b")}, {"partitions": ("b", "c")}, ""),
        ({"partitions": ("",)}, {}, ""),
    ],
)
def test_a_writer_and_a_reader_match_or_the_reason_is_given(writer: dict, reader: dict, word: str) -> None:  # type: ignore[type-arg]
    said = discovery.mismatch(ENDPOINT._replace(**writer), ENDPOINT._replace(**reader))
    assert word in said
    assert bool(word) == bool(said)


def test_the_nearest_address_is_the_one_that_the_peer_sends_from() -> None:
    both = (("192.0.2.9", 7411), ("127.0.0.1", 7411), ("10.0.0.9", 7411))
    assert discovery.nearest(both, "10.0.0.9", "10.0.0.1") == both[2]
    assert discovery.nearest(both, "172.16.0.1", "127.0.0.7") == both[1]
    assert discovery.nearest(both, "172.16.0.1", "10.0.0.1") == both[0]
