"""Test the Dynamixel codec: encoded packets decode to the same, and noise never becomes a frame."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from strands_actors.drivers.common.dynamixel import protocol as p
from strands_actors.drivers.common.dynamixel import table as t

SIGNED = [t.HOMING_OFFSET, t.GOAL_POSITION, t.GOAL_VELOCITY, t.POSITION, t.VELOCITY, t.CURRENT, t.BUS_WATCHDOG]
UNSIGNED = [t.MODEL, t.ID, t.MIN_POSITION, t.TORQUE_ENABLE, t.STATUS_LEVEL, t.VOLTAGE, t.PROFILE_VELOCITY]

servo_ids = st.integers(0, p.MAX_ID)
instructions = st.integers(0, 255).filter(lambda code: code != p.STATUS)
# The bytes that need stuffing are drawn often.
params = st.one_of(st.binary(max_size=60), st.lists(st.sampled_from([0xFF, 0xFD, 0x00]), max_size=60).map(bytes))
requests = st.builds(p.Packet, st.one_of(servo_ids, st.just(p.BROADCAST)), instructions, params, st.just(0))
replies = st.builds(p.Packet, servo_ids, st.just(p.STATUS), params, st.integers(0, 255))
packets = st.one_of(requests, replies)
noise = st.one_of(
    st.binary(max_size=60), st.lists(st.sampled_from([0xFF, 0xFD, 0x00, 0x03]), max_size=60).map(bytes)
)


def bytes_of(packet: p.Packet) -> bytes:
    return p.frame(packet.id, packet.code, packet.params, packet.error)


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = sorted({place % (len(data) + 1) for place in places} | {0, len(data)})
    return [data[start:end] for start, end in pairwise(ends)]


@given(st.lists(packets, max_size=6), st.lists(st.integers(0, 1000), max_size=8))
@example([p.Packet(1, p.WRITE, b"\xff\xff\xfd\xff\xff\xfd\xfd")], [])
@example([p.Packet(1, p.STATUS, b"\xff\xfd", 0xFF)], [])
def test_frames_in_any_pieces_come_out_as_they_went_in(sent: list[p.Packet], places: list[int]) -> None:
    decoder = p.Decoder()
    stream = b"".join(map(bytes_of, sent))
    received = [packet for piece in cut(stream, places) for packet in decoder.feed(piece)]
    assert received == sent
    assert decoder.pending == 0
    assert decoder.garbage_bytes == 0
    assert decoder.take_damaged() == []


@given(packets)
def test_a_header_is_never_inside_a_frame(packet: p.Packet) -> None:
    frame = bytes_of(packet)
    assert p.HEADER not in frame[1:-2]


@given(st.lists(noise, max_size=8))
def test_noise_never_raises_and_yields_only_frames_that_were_in_it(pieces: list[bytes]) -> None:
    decoder = p.Decoder()
    stream = b"".join(pieces)
    for packet in [packet for piece in pieces for packet in decoder.feed(piece)]:
        assert p.HEADER + bytes((packet.id,)) in stream
    assert decoder.garbage_bytes + decoder.pending <= len(stream)


@given(st.binary(max_size=20).filter(lambda data: b"\xff" not in data), packets)
def test_a_frame_after_noise_without_a_header_is_found(before: bytes, packet: p.Packet) -> None:
    decoder = p.Decoder()
    assert list(decoder.feed(before + bytes_of(packet))) == [packet]
    assert decoder.garbage_bytes == len(before)


@given(packets, st.data())
def test_one_flipped_bit_is_never_the_frame_that_was_sent(packet: p.Packet, data: st.DataObject) -> None:
    frame = bytearray(bytes_of(packet))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert packet not in list(p.Decoder().feed(bytes(frame)))


def test_a_damaged_frame_is_kept_apart() -> None:
    decoder = p.Decoder()
    frame = bytearray(p.ping(3))
    frame[-1] ^= 1
    assert list(decoder.feed(bytes(frame) + p.ping(4))) == [p.Packet(4, p.PING, b"")]
    assert decoder.take_damaged() == [(3, bytes(frame))]
    assert decoder.take_damaged() == []


def test_known_bytes() -> None:
    """The values are from the vendor's own tables."""
    assert p.ping(1).hex() == "fffffd00010300 0119 4e".replace(" ", "")
    assert p.LIMP.hex() == "fffffd00fe0600034000002e16"
    assert p.write(1, t.HOMING_OFFSET, -5)[10:14] == bytes((0xFB, 0xFF, 0xFF, 0xFF))
    assert p.write(1, t.GOAL_POSITION, 0xFDFFFF)[5:15] == bytes.fromhex("0a00037400fffffdfd00")


@given(st.sampled_from(SIGNED + UNSIGNED), st.integers(-(1 << 33), 1 << 33))
def test_a_value_is_either_kept_or_refused(register: t.Register, value: int) -> None:
    bits = 8 * register.size
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if register.signed else (0, (1 << bits) - 1)
    try:
        raw = register.encode(value)
    except ValueError:
        assert not low <= value <= high
    else:
        assert low <= value <= high
        assert register.decode(raw) == value
        assert register.decode(b"\x11\x22" + raw, base=register.address - 2) == value


said_by = st.tuples(st.integers(0, 255), st.binary(min_size=4, max_size=4))


@given(st.dictionaries(servo_ids, said_by, min_size=1, max_size=8))
def test_a_fast_answer_comes_apart_again(said: dict[int, tuple[int, bytes]]) -> None:
    answers = [(servo_id, error, data) for servo_id, (error, data) in said.items()]
    (packet,) = p.Decoder().feed(p.fast_status(answers, [len(data) for _, _, data in answers]))
    apart = p.fast_answers(packet, 4)
    assert {i: (a.error, a.params) for i, a in apart.items()} == said


def test_a_fast_answer_that_ends_early_is_no_frame() -> None:
    decoder = p.Decoder()
    assert list(decoder.feed(p.fast_status([(1, 0, b"\1\2\3\4")], [4, 4]))) == []
    assert decoder.pending


def test_an_error_number_is_a_failure_and_the_alert_bit_is_not() -> None:
    assert p.Packet(1, p.STATUS, b"").failure == ""
    alert = p.Packet(1, p.STATUS, b"", p.ALERT)
    assert (alert.alert, alert.failure) == (True, "")
    both = p.Packet(1, p.STATUS, b"", p.ALERT | p.ACCESS_ERROR)
    assert (both.alert, both.failure) == (True, "access error")
    assert p.Packet(1, p.STATUS, b"", 99).failure == "error 99"


@given(packets)
def test_any_request_can_be_classified(packet: p.Packet) -> None:
    assert p.classify(packet) in {"setpoint", "safe", "enable", "read", "config", "other"}
    assert p.safe_state(packet, (1, 2)) in {"", "limp", "hold"}


def packet_of(frame: bytes) -> p.Packet:
    (packet,) = p.Decoder().feed(frame)
    return packet


def block(register: t.Register, data: bytes) -> bytes:
    return p.frame(3, p.WRITE, register.address.to_bytes(2, "little") + data)


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (p.ping(1), "read"),
        (p.read(1, 132, 4), "read"),
        (p.sync_read([1, 2], 132, 4), "read"),
        (p.fast_sync_read([1, 2], 132, 4), "read"),
        (p.LIMP, "safe"),
        (p.torque(3, False), "safe"),
        (p.sync_write(t.TORQUE_ENABLE, {1: 0, 2: 0}), "safe"),
        (p.hold({1: 2048, 2: -1000}), "safe"),
        (p.torque(3, True), "enable"),
        (p.sync_write(t.TORQUE_ENABLE, {1: 0, 2: 1}), "enable"),
        (p.write(3, t.GOAL_POSITION, 100), "setpoint"),
        (p.goals({1: 100, 2: 200}), "setpoint"),
        (p.write(3, t.GOAL_VELOCITY, 100), "setpoint"),
        (p.write(3, t.GOAL_CURRENT, 100), "setpoint"),
        (p.write(3, t.GOAL_PWM, 100), "setpoint"),
        (block(t.PROFILE_VELOCITY, bytes((9, 0, 0, 0, 0, 8, 0, 0))), "setpoint"),  # a velocity, so not a hold
        (block(t.PROFILE_ACCELERATION, bytes(12)), "setpoint"),
        (p.write(3, t.BUS_WATCHDOG, 15), "config"),
        (p.write(3, t.RETURN_DELAY, 0), "config"),
        (p.reboot(3), "other"),
        (p.frame(p.BROADCAST, p.ACTION), "other"),
        (p.frame(3, p.WRITE), "other"),
    ],
)
def test_the_kind_of_each_request(frame: bytes, kind: str) -> None:
    assert p.classify(packet_of(frame)) == kind


@pytest.mark.parametrize(
    ("frame", "safe_state"),
    [
        (p.LIMP, "limp"),
        (p.sync_write(t.TORQUE_ENABLE, {1: 0, 2: 0}), "limp"),
        (p.sync_write(t.TORQUE_ENABLE, {1: 0}), ""),
        (p.hold({1: 5, 2: 6}), "hold"),
        (p.hold({2: 6}), ""),
        (p.torque(1, False), ""),
        (p.goals({1: 5, 2: 6}), ""),
        (p.ping(p.BROADCAST), ""),
    ],
)
def test_the_safe_state_of_a_frame_for_all_servos(frame: bytes, safe_state: str) -> None:
    assert p.safe_state(packet_of(frame), (1, 2)) == safe_state


def test_hardware_errors_have_names() -> None:
    assert t.error_words(0) == ""
    assert t.error_words(t.VOLTAGE_BIT | t.OVERLOAD_BIT) == "voltage, overload"
    assert t.error_words(0x40) == "unknown 0x40"
