"""Test the frames of the boards: known bytes, pieces of any size, and 20,000 disturbed frames."""

from __future__ import annotations

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from tests.drivers.disturbed import DISTURBED

payloads = st.binary(max_size=f.CHUNK_V1)
codes = st.integers(0, 255)


def test_the_checksum_is_modbus() -> None:
    assert f.crc16(b"123456789") == 0x4B37


def test_a_frame_as_it_is_on_the_wire() -> None:
    # a request for a stepper's status: 206, 3, then the checksum, high byte first
    body = bytes((206, 3))
    assert f.pull(p.STATUS) == f.stuff(body + f.crc16(body).to_bytes(2, "big")) + b"\0"
    assert f.stuff(b"\x00") == b"\x01\x01"
    assert f.stuff(b"\x11\x22\x00\x33") == b"\x03\x11\x22\x02\x33"


@given(codes, payloads)
def test_a_frame_can_be_decoded_and_has_no_zero_inside(code: int, data: bytes) -> None:
    whole = f.frame(code, data)
    assert whole.endswith(b"\0") and b"\0" not in whole[:-1]
    assert len(whole) == len(data) + f.OVERHEAD <= f.MAX_FRAME
    assert list(f.Decoder().feed(whole)) == [f.Frame(code, data)]


@given(st.lists(st.tuples(codes, payloads), max_size=5), st.integers(1, 7), st.binary(max_size=20))
def test_frames_in_any_pieces_behind_noise(frames: list[tuple[int, bytes]], piece: int, noise: bytes) -> None:
    stream = noise + f.RESYNC + b"".join(f.frame(*each) for each in frames)
    decoder, found = f.Decoder(), []
    for at in range(0, len(stream), piece):
        found += decoder.feed(stream[at : at + piece])
    assert found[len(found) - len(frames) :] == [f.Frame(*each) for each in frames]
    assert decoder.pending == 0


def test_20_000_disturbed_frames_raise_nothing_and_keep_nothing() -> None:
    chance = random.Random(7)
    decoder = f.Decoder()
    good = [f.push(p.Command(p.Mode.POSITION_PROFILE, 1.5, 2.5).call()), f.pull(p.STATUS), *f.pushes(b"\5" * 130)]
    wrong = 0
    for _ in range(DISTURBED):
        whole = bytearray(chance.choice(good))
        for _ in range(chance.randrange(1, 4)):
            match chance.randrange(3):
                case 0:
                    whole[chance.randrange(len(whole))] ^= 1 << chance.randrange(8)
                case 1:
                    del whole[chance.randrange(len(whole)) :]
                    whole += chance.randbytes(2)
                case _:
                    whole.insert(chance.randrange(len(whole) + 1), chance.randrange(256))
        wrong += sum(f.frame(*found) not in good for found in decoder.feed(bytes(whole)))
        assert decoder.pending < f.MAX_FRAME
    assert wrong < DISTURBED / 1000, "a 16-bit checksum accepts few damaged frames"
    decoder.clear()
    assert list(decoder.feed(good[0])) == [f.Frame(f.PUSH_ONLY, p.Command(5, 1.5, 2.5).call())]


def test_an_endless_frame_is_dropped_and_the_next_is_read() -> None:
    decoder = f.Decoder()
    for _ in range(1000):
        assert list(decoder.feed(b"\x55" * 100)) == []
    assert decoder.pending < f.MAX_FRAME
    assert list(decoder.feed(f.END + f.pull(3))) == [f.Frame(f.PULL_FIRST, b"\3")]


@pytest.mark.parametrize("data", [b"", b"\x00", b"\x05\x01", b"\x01", b"\x04abc"])
def test_an_invalid_frame_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedFrame):
        f.parse(data)


@given(st.binary(min_size=1, max_size=f.MAX_CALL))
def test_a_long_call_is_pushed_in_parts(call: bytes) -> None:
    parts = [next(iter(f.Decoder().feed(part))) for part in f.pushes(call)]
    assert b"".join(part.data for part in parts) == call
    last = f.PUSH_ONLY if len(parts) == 1 else f.PUSH_LAST
    assert parts[-1].code == last
    assert [part.code for part in parts[:-1]] == [f.PUSH_FIRST, *[f.PUSH_MORE] * (len(parts) - 2)][: len(parts) - 1]


@given(st.binary(max_size=f.MAX_CALL))
def test_a_long_reply_is_pulled_in_parts(reply: bytes) -> None:
    parts = [next(iter(f.Decoder().feed(part))) for part in f.answers(reply)]
    assert b"".join(part.data for part in parts) == reply
    assert [part.code for part in parts] == [*[f.PULL_MORE] * (len(parts) - 1), f.PULL_LAST]
    assert {part.id for part in parts} == {f.PULL_LAST}, "all parts have the id of a valid answer"


def test_a_call_that_is_too_long_is_refused() -> None:
    with pytest.raises(ValueError, match="not 1025"):
        f.pushes(bytes(f.MAX_CALL + 1))
    with pytest.raises(ValueError, match="do not fit"):
        f.push(bytes(59))
