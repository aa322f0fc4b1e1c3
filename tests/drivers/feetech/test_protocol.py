"""Test the Feetech codec: encoded packets decode to the same, and noise never becomes a frame."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.feetech import protocol as p

SIGNED = [p.HOMING_OFFSET, p.GOAL_POSITION, p.GOAL_VELOCITY, p.POSITION, p.VELOCITY, p.LOAD]
UNSIGNED = [p.MODEL, p.ID, p.MIN_POSITION, p.TORQUE_ENABLE, p.TORQUE_LIMIT, p.LOCK, p.CURRENT]

servo_ids = st.integers(0, p.BROADCAST)
packets = st.builds(p.Packet, servo_ids, st.integers(0, 255), st.binary(max_size=60))
noise = st.one_of(
    st.binary(max_size=60), st.lists(st.sampled_from([0xFF, 0x00, 0x01, 0x04]), max_size=60).map(bytes)
)


def cut(data: bytes, places: list[int]) -> list[bytes]:
    ends = sorted({place % (len(data) + 1) for place in places} | {0, len(data)})
    return [data[start:end] for start, end in pairwise(ends)]


@given(st.lists(packets, max_size=6), st.lists(st.integers(0, 1000), max_size=8))
def test_frames_in_any_pieces_come_out_as_they_went_in(sent: list[p.Packet], places: list[int]) -> None:
    decoder = p.Decoder()
    stream = b"".join(p.frame(*packet) for packet in sent)
    received = [packet for piece in cut(stream, places) for packet in decoder.feed(piece)]
    assert received == sent
    assert decoder.pending == 0
    assert decoder.garbage_bytes == 0


@given(st.lists(noise, max_size=8))
def test_noise_never_raises_and_yields_only_frames_that_were_in_it(pieces: list[bytes]) -> None:
    decoder = p.Decoder()
    stream = b"".join(pieces)
    for packet in [packet for piece in pieces for packet in decoder.feed(piece)]:
        found = p.frame(*packet)
        assert found in stream
        assert packet.id != 0xFF
    assert decoder.garbage_bytes + decoder.pending <= len(stream)


@given(st.binary(max_size=20).filter(lambda data: b"\xff" not in data), packets)
def test_a_frame_after_noise_without_a_header_is_found(before: bytes, packet: p.Packet) -> None:
    decoder = p.Decoder()
    assert list(decoder.feed(before + p.frame(*packet))) == [packet]
    assert decoder.garbage_bytes == len(before)


@given(packets, st.data())
def test_one_flipped_bit_is_never_the_frame_that_was_sent(packet: p.Packet, data: st.DataObject) -> None:
    frame = bytearray(p.frame(*packet))
    bit = data.draw(st.integers(0, 8 * len(frame) - 1))
    frame[bit // 8] ^= 1 << bit % 8
    assert packet not in list(p.Decoder().feed(bytes(frame)))


def test_a_third_ff_moves_the_header_by_one() -> None:
    assert list(p.Decoder().feed(b"\xff" + p.ping(1))) == [p.Packet(1, p.PING, b"")]


def test_known_bytes() -> None:
    assert p.ping(1) == bytes.fromhex("ffff010201fb")
    assert p.LIMP.hex() == "fffffe04032800d2"
    assert p.read(1, 56, 2) == bytes.fromhex("ffff0104023802be")
    assert p.write(1, p.HOMING_OFFSET, -5)[6:8] == bytes((0x05, 0x08))  # sign bit 11, not two's complement


@given(st.sampled_from(SIGNED), st.data())
def test_signed_registers_are_sign_magnitude(register: p.Register, data: st.DataObject) -> None:
    assert register.sign_bit is not None
    most = (1 << register.sign_bit) - 1
    value = data.draw(st.integers(-most, most))
    raw = register.encode(value)
    assert register.decode(raw) == value
    magnitude = int.from_bytes(raw, "little")
    assert magnitude & most == abs(value)
    assert bool(magnitude >> register.sign_bit) == (value < 0)


@given(st.sampled_from(SIGNED + UNSIGNED), st.integers(-(1 << 20), 1 << 20))
def test_a_value_is_either_kept_or_refused(register: p.Register, value: int) -> None:
    try:
        raw = register.encode(value)
    except ValueError:
        bits = register.sign_bit if register.sign_bit is not None else 8 * register.size
        assert abs(value) >= 1 << bits or (value < 0 and register.sign_bit is None)
    else:
        assert register.decode(raw) == value
        assert register.decode(b"\x11\x22" + raw, base=register.address - 2) == value


@given(packets)
def test_any_request_can_be_classified(packet: p.Packet) -> None:
    assert p.classify(packet) in {"setpoint", "safe", "enable", "read", "config", "other"}


def packet_of(frame: bytes) -> p.Packet:
    (packet,) = p.Decoder().feed(frame)
    return packet


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (p.ping(1), "read"),
        (p.read(1, 56, 2), "read"),
        (p.sync_read([1, 2], 56, 4), "read"),
        (p.LIMP, "safe"),
        (p.write(3, p.TORQUE_ENABLE, 0), "safe"),
        (p.sync_write(p.TORQUE_ENABLE, {1: 0, 2: 0}), "safe"),
        (p.hold({1: 2048, 2: 1000}), "safe"),
        (p.write(3, p.TORQUE_ENABLE, 1), "enable"),
        (p.sync_write(p.TORQUE_ENABLE, {1: 0, 2: 1}), "enable"),
        (p.write(3, p.GOAL_POSITION, 100), "setpoint"),
        (p.sync_write(p.GOAL_POSITION, {1: 100, 2: 200}), "setpoint"),
        (p.write(3, p.GOAL_VELOCITY, 100), "setpoint"),
        (p.frame(3, p.WRITE, bytes((41, 0, 0, 8))), "setpoint"),  # from ACCELERATION into the goal
        (p.write(3, p.LOCK, 0), "config"),
        (p.write(3, p.RETURN_DELAY, 0), "config"),
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
        (p.sync_write(p.TORQUE_ENABLE, {1: 0, 2: 0}), "limp"),
        (p.sync_write(p.TORQUE_ENABLE, {1: 0}), ""),
        (p.hold({1: 5, 2: 6}), "hold"),
        (p.hold({2: 6}), ""),
        (p.torque(1, False), ""),
        (p.goals({1: 5, 2: 6}), ""),
        (p.ping(p.BROADCAST), ""),
    ],
)
def test_the_safe_state_of_a_frame_for_all_servos(frame: bytes, safe_state: str) -> None:
    assert p.safe_state(packet_of(frame), (1, 2)) == safe_state


def test_error_bits_have_names() -> None:
    assert p.error_words(0) == ""
    assert p.error_words(1 | 32) == "voltage, overload"
    assert p.error_words(64) == "unknown 0x40"
