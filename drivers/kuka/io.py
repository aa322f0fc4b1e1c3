"""Encode and decode the inputs and outputs of a robot program in FRI (the protocol's message ``FriIOValue``).

A robot program registers up to ten of its inputs and outputs, by name. A monitoring message has all their values. A
command message sets outputs.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Sequence
from typing import Final

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

MOST_IOS: Final = 10
"""Most values in one message. The vendor's client has room for no more."""
LONGEST_NAME: Final = 63
"""Most bytes of a name. The vendor's client has room for no more."""


class IoType(enum.IntEnum):
    BOOLEAN = 0
    DIGITAL = 1
    ANALOG = 2


class IoDirection(enum.IntEnum):
    """The direction as the robot program sees it: a client reads both, and sets only outputs."""

    INPUT = 0
    OUTPUT = 1


class Io(msgspec.Struct, frozen=True, gc=False):
    """One input or output: its name (``GROUP.NAME``), and its value. A boolean value is 0 or 1."""

    name: str
    type: int
    direction: int
    value: int | float = 0


def encode_io(io: Io) -> bytes:
    body = pb.bytes_field(1, io.name.encode()) + pb.varint_field(2, io.type) + pb.varint_field(3, io.direction)
    if io.type == IoType.ANALOG:
        return body + pb.double_field(5, io.value)
    return body + pb.varint_field(4, int(io.value))


def encode_ios(number: int, ios: Sequence[Io]) -> bytes:
    """Encode the values as the repeated field ``number``."""
    return b"".join(pb.bytes_field(number, encode_io(io)) for io in ios)


def decode_ios(fields: dict[int, list[pb.Value]], number: int) -> tuple[Io, ...]:
    """Return the values in the repeated field ``number``. Raise ``MalformedFrame``."""
    values = fields.get(number, [])
    if len(values) > MOST_IOS:
        raise MalformedFrame(f"FRI: {len(values)} inputs and outputs, {MOST_IOS} at most")
    return tuple(_decode_io(value) for value in values)


def _decode_io(data: pb.Value) -> Io:
    if isinstance(data, int):
        raise MalformedFrame("FRI: an input or output that is a number")
    fields = pb.message(data)
    name = pb.last_bytes(fields, 1)
    number = pb.last_int(fields, 2)
    value = pb.as_double(pb.last_int(fields, 5)) if number == IoType.ANALOG else pb.last_int(fields, 4)
    if not name or len(name) > LONGEST_NAME or not math.isfinite(value):
        raise MalformedFrame("FRI: an input or output without a usable name or value")
    try:
        return Io(name.decode(), number, pb.last_int(fields, 3), value)
    except UnicodeDecodeError:
        raise MalformedFrame("FRI: a name of an input or output that is no text") from None
