"""Test the protobuf wire format: encoded values decode to the same, and noise raises only ``MalformedFrame``."""

from __future__ import annotations

import contextlib
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

NUMBERS = st.integers(1, 2**29 - 1)
DOUBLES = st.lists(st.floats(allow_nan=False), max_size=20)


def test_the_example_of_the_specification() -> None:
    assert pb.varint_field(1, 150) == bytes.fromhex("089601")
    assert pb.bytes_field(2, b"testing") == bytes.fromhex("120774657374696e67")
    assert list(pb.fields(bytes.fromhex("089601"))) == [(1, pb.VARINT, 150)]


@given(NUMBERS, st.integers(0, 2**64 - 1))
def test_a_varint_is_read_back(number: int, value: int) -> None:
    assert list(pb.fields(pb.varint_field(number, value))) == [(number, pb.VARINT, value)]
    assert pb.varints(pb.varint_field(number, value), number) == (value,)


@given(NUMBERS, DOUBLES, st.booleans())
def test_doubles_are_read_back_packed_or_not(number: int, values: list[float], packed: bool) -> None:
    assert pb.doubles(pb.double_fields(number, values, packed), number) == tuple(values)


def test_floats_and_fixed_numbers() -> None:
    found = pb.message(pb.float_field(1, -1.5) + pb.fixed32_field(2, 0xDEADBEEF) + pb.double_field(3, 0.1))
    assert pb.last_float(found, 1) == -1.5
    assert pb.last_int(found, 2) == 0xDEADBEEF
    assert pb.as_double(pb.last_int(found, 3)) == 0.1
    assert pb.last_float(found, 9) == 0.0 and pb.last_int(found, 9, 7) == 7 and pb.last_bytes(found, 9) == b""


def test_of_several_the_last_counts() -> None:
    assert pb.last_int(pb.message(pb.varint_field(1, 2) + pb.varint_field(1, 3)), 1) == 3


@pytest.mark.parametrize(
    "data",
    [
        b"\x08",  # a key without a value
        b"\x08" + b"\xff" * 10,  # a number without end
        b"\x08" + b"\xff" * 9 + b"\x7f",  # more than 64 bits
        b"\x12\x05ab",  # three bytes missing
        b"\x09\x00",  # seven bytes of a double missing
        b"\x00\x00",  # field 0
        b"\x0b",  # a group
    ],
)
def test_invalid_protobuf_is_refused(data: bytes) -> None:
    with pytest.raises(MalformedFrame):
        list(pb.fields(data))


def test_a_field_of_another_kind_is_refused() -> None:
    with pytest.raises(MalformedFrame):
        pb.last_int(pb.message(pb.bytes_field(1, b"x")), 1)
    with pytest.raises(MalformedFrame):
        pb.last_bytes(pb.message(pb.varint_field(1, 1)), 1)
    with pytest.raises(MalformedFrame):
        pb.doubles(pb.bytes_field(1, b"1234567"), 1)
    with pytest.raises(MalformedFrame):
        pb.doubles(pb.varint_field(1, 1), 1)
    with pytest.raises(MalformedFrame):
        pb.last_float(pb.message(pb.double_field(1, 1.0)), 1)
    with pytest.raises(MalformedFrame):
        pb.varints(pb.double_field(1, 1.0), 1)


def test_only_unsigned_numbers_are_encoded() -> None:
    with pytest.raises(ValueError, match="unsigned"):
        pb.varint_field(1, -1)


@given(st.binary(max_size=64))
def test_noise_is_read_or_refused(data: bytes) -> None:
    for read in (pb.message, lambda raw: pb.doubles(raw, 1), lambda raw: pb.varints(raw, 1)):
        with contextlib.suppress(MalformedFrame):
            read(data)


def test_bits_become_numbers() -> None:
    assert pb.as_float(struct.unpack("<I", struct.pack("<f", 2.5))[0]) == 2.5
