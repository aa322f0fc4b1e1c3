"""Read and write the protobuf wire format, without message descriptors.

A robot uses only a few message types, and decoding needs only their field numbers, which each robot's codec
defines. Decoding one message takes microseconds. Descriptors at run time, generated code and a process-wide
registry are not needed. Source: the encoding page of the protobuf documentation (varint, 64-bit, length-delimited,
32-bit).
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import Final

from .malformed import MalformedFrame

VARINT: Final = 0
FIXED64: Final = 1
LENGTH: Final = 2
FIXED32: Final = 5

Value = int | bytes
"""``int`` for a varint or fixed field (as unsigned bits), ``bytes`` for a length-delimited one."""

_VARINT_BYTES = 10
"""Longest varint: 64 bits, 7 at a time."""


def fields(data: bytes) -> Iterator[tuple[int, int, Value]]:
    """Yield number, wire type and value of each field, in the order of ``data``.

    A sub-message, a string and a packed list all have the wire type ``LENGTH`` (length-delimited). Raises
    ``MalformedFrame``.
    """
    offset = 0
    while offset < len(data):
        key, offset = _read_varint(data, offset)
        number, wire_type = key >> 3, key & 7
        if number == 0:
            raise MalformedFrame("protobuf: field number 0")
        if wire_type == VARINT:
            value, offset = _read_varint(data, offset)
            yield number, wire_type, value
        elif wire_type == LENGTH:
            size, offset = _read_varint(data, offset)
            yield number, wire_type, _take(data, offset, size)
            offset += size
        elif wire_type in _FIXED_SIZE:
            size = _FIXED_SIZE[wire_type]
            yield number, wire_type, int.from_bytes(_take(data, offset, size), "little")
            offset += size
        else:
            raise MalformedFrame(f"protobuf: wire type {wire_type} in field {number}")


def message(data: bytes) -> dict[int, list[Value]]:
    """Return the values of all fields of the message ``data``, in a dict by field number. A field that occurs
    several times has several values, in their order. Raises ``MalformedFrame``."""
    values: dict[int, list[Value]] = {}
    for number, _, value in fields(data):
        values.setdefault(number, []).append(value)
    return values


def last_int(values: dict[int, list[Value]], number: int, default: int = 0) -> int:
    """Return the integer in a varint or fixed field. If the field occurs several times, its last value is returned.

    Args:
        values: The result of ``message``.
        number: The number of the field.
        default: The value if the field is missing.

    Raises:
        MalformedFrame: The field is of another type.
    """
    value = values[number][-1] if number in values else default
    if isinstance(value, int):
        return value
    raise MalformedFrame(f"protobuf: field {number} is no number")


def last_bytes(values: dict[int, list[Value]], number: int) -> bytes:
    """Return the last value of a length-delimited field; empty if the field is missing. Raises ``MalformedFrame``
    if the field is of another type."""
    value = values[number][-1] if number in values else b""
    if isinstance(value, bytes):
        return value
    raise MalformedFrame(f"protobuf: field {number} has no length")


def last_float(values: dict[int, list[Value]], number: int) -> float:
    """Return the last value of a ``float`` field; 0 if it is missing. Raises ``MalformedFrame`` if the
    field is of another type."""
    value = last_int(values, number)
    if value >> 32:
        raise MalformedFrame(f"protobuf: field {number} is no float")
    return as_float(value)


def as_float(bits: int) -> float:
    """Return the ``float`` with these 32 bits."""
    (value,) = struct.unpack("<f", bits.to_bytes(4, "little"))
    return float(value)


def as_double(bits: int) -> float:
    """Return the ``double`` with these 64 bits."""
    (value,) = struct.unpack("<d", bits.to_bytes(8, "little"))
    return float(value)


def doubles(data: bytes, number: int) -> tuple[float, ...]:
    """Return a repeated ``double`` field of the message ``data``, packed or not. Raises
    ``MalformedFrame``."""
    values: list[float] = []
    for field, wire_type, value in fields(data):
        if field != number:
            continue
        if isinstance(value, bytes):
            if len(value) % 8:
                raise MalformedFrame(f"protobuf: {len(value)} bytes of packed doubles in field {number}")
            values.extend(struct.unpack(f"<{len(value) // 8}d", value))
        elif wire_type == FIXED64:
            values.append(as_double(value))
        else:
            raise MalformedFrame(f"protobuf: field {number} is no double")
    return tuple(values)


def varints(data: bytes, number: int) -> tuple[int, ...]:
    """Return a repeated varint field of the message ``data``, packed or not. Raises
    ``MalformedFrame``."""
    values: list[int] = []
    for field, wire_type, value in fields(data):
        if field != number:
            continue
        if isinstance(value, bytes):
            offset = 0
            while offset < len(value):
                integer, offset = _read_varint(value, offset)
                values.append(integer)
        elif wire_type == VARINT:
            values.append(value)
        else:
            raise MalformedFrame(f"protobuf: field {number} is no varint")
    return tuple(values)


def varint_field(number: int, value: int) -> bytes:
    """Encode a varint field: an unsigned number, or a value of an enum."""
    return _varint(number << 3 | VARINT) + _varint(value)


def double_field(number: int, value: float) -> bytes:
    return _varint(number << 3 | FIXED64) + struct.pack("<d", value)


def float_field(number: int, value: float) -> bytes:
    return _varint(number << 3 | FIXED32) + struct.pack("<f", value)


def fixed32_field(number: int, value: int) -> bytes:
    return _varint(number << 3 | FIXED32) + struct.pack("<I", value)


def bytes_field(number: int, value: bytes) -> bytes:
    """Encode a length-delimited field: a sub-message, a string (as UTF-8) or a packed list."""
    return _varint(number << 3 | LENGTH) + _varint(len(value)) + value


def double_fields(number: int, values: Iterable[float], packed: bool = False) -> bytes:
    """Encode a repeated ``double`` field: one field per number, or all numbers packed in one field."""
    if packed:
        return bytes_field(number, b"".join(struct.pack("<d", value) for value in values))
    return b"".join(double_field(number, value) for value in values)


_FIXED_SIZE = {FIXED64: 8, FIXED32: 4}


def _take(data: bytes, offset: int, size: int) -> bytes:
    if offset + size > len(data):
        raise MalformedFrame(f"protobuf: {size} bytes announced, {len(data) - offset} there")
    return data[offset : offset + size]


def _read_varint(data: bytes, offset: int) -> tuple[int, int]:
    value = 0
    for shift in range(_VARINT_BYTES):
        if offset >= len(data):
            raise MalformedFrame("protobuf: the message ends inside a number")
        byte = data[offset]
        offset += 1
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            if value >> 64:
                raise MalformedFrame("protobuf: a number of more than 64 bits")
            return value, offset
    raise MalformedFrame("protobuf: a number of more than 10 bytes")


def _varint(value: int) -> bytes:
    if not 0 <= value < 1 << 64:
        raise ValueError(f"protobuf: {value} does not fit an unsigned 64-bit number")
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
