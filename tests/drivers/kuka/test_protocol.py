"""Test the FRI codec: it reads both encodings of a list, and noise raises only ``MalformedFrame``."""

from __future__ import annotations

import random
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.kuka import protocol as p
from tests.drivers.disturbed import DISTURBED

RADIANS = st.tuples(*[st.floats(-3.2, 3.2)] * p.JOINTS)

SAID = p.Monitoring(
    sequence=7,
    reflected=6,
    drives=(2,) * 7,
    operation_mode=2,
    position=(0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7),
    torque=(1.0,) * 7,
    commanded=(0.11, -0.21, 0.31, -0.41, 0.51, -0.61, 0.71),
    external_torque=(0.5,) * 7,
    state=p.State.COMMANDING_ACTIVE,
    quality=p.Quality.EXCELLENT,
    sample_ms=5,
    interpolated=(0.0,) * 7,
    client_mode=p.ClientMode.POSITION,
    overlay=p.Overlay.JOINT,
    tracking=1.0,
)


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("checksum", [False, True])
def test_a_monitoring_message_is_read_packed_or_not_with_a_checksum_or_without(
    packed: bool, checksum: bool
) -> None:
    data = p.encode_monitoring(SAID, packed, checksum)
    assert p.decode_monitoring(data) == SAID
    assert len(data) < p.LARGEST


@given(st.integers(0, p.COUNTER), st.integers(0, p.COUNTER), RADIANS)
def test_an_answer_is_read_back(sequence: int, reflected: int, radians: tuple[float, ...]) -> None:
    for position in ((), radians):
        command = p.Command(sequence, reflected, position)
        assert p.decode_command(p.encode_command(command)) == command


def test_an_answer_byte_by_byte() -> None:
    """The layout of the data sheet: header, one field per position, and the end with the length of the part
    before it."""
    header = bytes.fromhex("0a08 0881800d 1003 1807")
    doubles = b"".join(b"\x09" + struct.pack("<d", 0.5) for _ in range(7))
    data = b"\x12\x41" + b"\x0a\x3f" + doubles
    end = b"\x7a\x02\x08" + bytes([len(header) + len(data)])
    assert p.encode_command(p.Command(3, 7, (0.5,) * 7)) == header + data + end
    assert p.encode_command(p.Command(3, 7)) == header + b"\x7a\x02\x08" + bytes([len(header)])


def test_numbers_that_no_table_names_are_shown_as_they_are() -> None:
    assert p.name_of(p.State, 4) == "COMMANDING_ACTIVE"
    assert p.name_of(p.State, 9) == "9"


def without(number: int) -> bytes:
    """Return the message without one of its parts."""
    kept = pb.fields(p.encode_monitoring(SAID))
    return b"".join(pb.bytes_field(at, value) for at, _, value in kept if at != number and isinstance(value, bytes))


def with_positions(values: list[float]) -> bytes:
    measured = pb.bytes_field(1, pb.double_fields(1, values)) + pb.bytes_field(3, pb.double_fields(1, values))
    return without(3) + pb.bytes_field(3, measured)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "message 0x0"),
        (p.encode_command(p.Command(1, 1)), "message 0x34001 instead of 0x245142"),
        (without(1), "message 0x0"),
        (without(3), "0 measured positions"),
        (with_positions([0.0] * 6), "6 measured positions"),
        (with_positions([0.0] * 8), "8 measured positions"),
        (with_positions([0.0] * 6 + [float("nan")]), "not finite"),
        (with_positions([0.0] * 6 + [float("inf")]), "not finite"),
        (without(2) + pb.bytes_field(2, pb.varint_field(1, 6)), "a robot of 6 joints"),
        (p.encode_monitoring(SAID) + bytes(p.LARGEST), "bytes, 1500 at most"),
        (p.encode_monitoring(SAID)[:-1], "announced"),
        (pb.varint_field(1, 5), "has no length"),
    ],
)
def test_an_invalid_monitoring_message_is_refused_by_name(data: bytes, why: str) -> None:
    with pytest.raises(MalformedFrame, match=why):
        p.decode_monitoring(data)


def disturbed(chance: random.Random, data: bytes) -> bytes:
    """Return a datagram that is damaged in one of several ways."""
    noisy = bytearray(data)
    match chance.randrange(5):
        case 0:
            for _ in range(chance.randint(1, 4)):
                noisy[chance.randrange(len(noisy))] ^= 1 << chance.randrange(8)
        case 1:
            del noisy[chance.randrange(len(noisy)) :]
        case 2:
            at = chance.randrange(len(noisy))
            noisy[at:at] = chance.randbytes(chance.randint(1, 8))
        case 3:
            at = chance.randrange(len(noisy))
            del noisy[at : at + chance.randint(1, 20)]
        case _:
            noisy = bytearray(chance.randbytes(chance.randrange(300)))
    return bytes(noisy)


def test_a_disturbed_frame_gives_a_message_or_the_codecs_error() -> None:
    """A decoded message is usable: its joints are seven finite numbers."""
    chance = random.Random(30200)
    frames = [p.encode_monitoring(SAID, packed) for packed in (False, True)]
    frames.append(p.encode_command(p.Command(3, 7, (0.5,) * 7)))
    understood = refused = 0
    for _ in range(DISTURBED):
        data = disturbed(chance, chance.choice(frames))
        for decode in (p.decode_monitoring, p.decode_command):
            try:
                message = decode(data)
            except MalformedFrame:
                refused += 1
                continue
            understood += 1
            rows = [message.position]
            if isinstance(message, p.Monitoring):
                rows += [message.commanded, message.torque, message.external_torque, message.interpolated]
                assert len(message.drives) <= 2 * p.JOINTS
            assert all(len(row) in (0, p.JOINTS) and max(map(abs, row), default=0.0) < float("inf") for row in rows)
    assert understood and refused
