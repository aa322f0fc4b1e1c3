"""Test Kortex frames and messages: recorded bytes, every field there and back, and noise."""

from __future__ import annotations

import contextlib
import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.kinova import protocol as p
from tests.drivers.disturbed import DISTURBED

KEEP_ALIVE = bytes.fromhex(
    "07784574526f4b07"  # magic
    "00000018"  # 24 bytes follow: big-endian
    "0a14"  # header
    "0d00000011"  # version 1, request, device 0
    "1507000500"  # session 5, message 7
    "1d03000110"  # version 1, KeepAlive
    "2500000000"  # no payload
    "1200"
)
"""Written by hand from the field table of the header."""

words16, words12, words28 = st.integers(0, 0xFFFF), st.integers(0, 0xFFF), st.integers(0, 0xFFF_FFFF)
frames = st.builds(
    p.Frame, st.integers(0, 15), words28, words16, words16, st.binary(max_size=200), st.integers(0, 15), words12
)
floats = st.floats(-1e6, 1e6, width=32)
banks = st.tuples(st.integers(0, 0xFFFFFFFF), st.integers(0, 0xFFFFFFFF))
actuators = st.builds(p.Actuator, floats, floats, floats, floats, floats, floats, banks)
feedbacks = st.builds(
    p.Feedback,
    st.integers(0, 10),
    st.lists(actuators, max_size=8).map(tuple),
    floats,
    st.tuples(floats, floats, floats),
    banks,
)


def test_a_frame_as_it_is_on_the_wire() -> None:
    frame = p.Frame(p.Kind.REQUEST, p.Call.KEEP_ALIVE, 7, 5)
    assert frame.encode() == KEEP_ALIVE
    assert list(p.Decoder().feed(KEEP_ALIVE)) == [frame]


def test_the_session_of_a_response_is_the_high_half_and_its_error_stands_in_the_first_word() -> None:
    header = struct.pack("<BIBIBIBI", 0x0D, 0x1300_1016, 0x15, 0x0009_0007, 0x1D, 0x1002_0084, 0x25, 0)
    frame = p.decode(b"\x0a" + bytes([len(header)]) + header)
    assert frame == p.Frame(p.Kind.RESPONSE, p.Call.SEND_JOINT_SPEEDS, 7, 9, b"", p.ERROR_OF_SERVER, 22)
    assert p.sub_error_name(frame.sub_error) == "ROBOT_IN_FAULT (22)"


@given(st.lists(frames, max_size=5), st.integers(1, 64))
def test_frames_are_decoded_from_any_pieces(wanted: list[p.Frame], piece: int) -> None:
    data, decoder = b"".join(frame.encode() for frame in wanted), p.Decoder()
    found = [frame for at in range(0, len(data), piece) for frame in decoder.feed(data[at : at + piece])]
    assert (found, decoder.skipped) == (wanted, 0)


@given(st.binary(max_size=40), frames, frames)
def test_invalid_bytes_are_skipped_up_to_the_next_frame(noise: bytes, first: p.Frame, second: p.Frame) -> None:
    """This happens when a process takes over a connection in the middle of an answer."""
    decoder = p.Decoder()
    half = first.encode()[9:]
    found = list(decoder.feed(noise + half + second.encode()))
    assert found[-1:] == [second] or p.MAGIC in noise + half
    assert decoder.skipped >= 1


def test_a_frame_with_a_wrong_length_loses_only_itself() -> None:
    good = p.Frame(p.Kind.RESPONSE, p.Call.STOP, 1, 1)
    long = p.MAGIC + (p.MAX_FRAME + 1).to_bytes(4, "big")
    body = KEEP_ALIVE[12:-2] + pb.bytes_field(2, b"four")
    lying = p.MAGIC + len(body).to_bytes(4, "big") + body
    decoder = p.Decoder()
    assert list(decoder.feed(long + lying + good.encode())) == [good]
    assert decoder.skipped >= 2


@given(feedbacks)
def test_a_feedback_comes_back_as_it_was(feedback: p.Feedback) -> None:
    assert p.Feedback.decode(feedback.encode()) == feedback


@given(st.lists(floats, min_size=7, max_size=7))
def test_speeds_come_back_by_joint(speeds: list[float]) -> None:
    assert p.decode_speeds(p.encode_speeds(speeds)) == dict(enumerate(speeds))


@given(st.text(max_size=20), st.text(max_size=20))
def test_a_login_comes_back_as_it_was(username: str, password: str) -> None:
    assert p.Login.decode(p.Login(username, password).encode()) == p.Login(username, password, 60_000, 2_000)


def test_invalid_numbers_are_refused() -> None:
    nan = p.Feedback(7, (p.Actuator(position_deg=float("nan")),))
    with pytest.raises(MalformedFrame, match="nan"):
        p.Feedback.decode(nan.encode())
    with pytest.raises(MalformedFrame):
        p.Login.decode(pb.bytes_field(1, b"\xff"))
    with pytest.raises(MalformedFrame):
        p.Feedback.decode(pb.varint_field(3, 1))


def test_a_value_without_a_name_is_shown_as_a_number() -> None:
    assert p.arm_state_name(4) == "IN_FAULT (4)"
    assert p.arm_state_name(99) == "unknown (99)"


READERS = (p.Feedback.decode, p.Login.decode, p.decode_speeds, p.decode_number, p.decode)


def disturb(chance: random.Random, data: bytes) -> bytes:
    """Flip, drop, double or replace some bytes."""
    found = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        at = chance.randrange(len(found)) if found else 0
        match chance.randrange(4):
            case 0 if found:
                found[at] ^= 1 << chance.randrange(8)
            case 1 if found:
                del found[at : at + chance.randint(1, 9)]
            case 2:
                found[at:at] = found[at : at + chance.randint(1, 9)]
            case _:
                found[at : at + 3] = chance.randbytes(chance.randint(0, 6))
    return bytes(found)


def fuzz(rounds: int, seed: int) -> int:
    """Return how many disturbed frames were decoded. The others may raise only ``MalformedFrame``."""
    chance, read = random.Random(seed), 0
    feedback = p.Feedback(7, tuple(p.Actuator(float(at), 1.0, 2.0, 3.0, 40.0, 41.0, (1, 2)) for at in range(7)))
    payloads = (feedback.encode(), p.Login("admin", "admin").encode(), p.encode_speeds([1.0] * 7), b"\x08\x07")
    good, decoder = p.Frame(p.Kind.RESPONSE, p.Call.STOP, 1, 1).encode(), p.Decoder()
    for _ in range(rounds):
        frame = p.Frame(p.Kind.RESPONSE, p.Call.REFRESH_FEEDBACK, 3, 4, chance.choice(payloads)).encode()
        for found in decoder.feed(disturb(chance, frame)):
            read += 1
            for reader in READERS:
                with contextlib.suppress(MalformedFrame):
                    reader(found.payload)
        assert len(decoder._pending) <= p.MAX_FRAME + 12
    assert list(decoder.feed(good * (p.MAX_FRAME // len(good) + 2)))[-1].call == p.Call.STOP
    return read


def test_disturbed_frames_are_read_or_skipped() -> None:
    assert fuzz(DISTURBED, 1) > 1000, "some disturbed frames can still be decoded"
