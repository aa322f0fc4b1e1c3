"""Read and write the protobuf wire format, without descriptors.

The few messages of a robot's wire need field numbers only, and the codec of each wire names them. Decoding
one message takes microseconds. No run-time descriptors, generated code or process-wide registry are
needed. Source: the encoding page of the protobuf documentation (varint, 64-bit, length-delimited,
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

    A sub-message, a string and a packed list are all ``LENGTH``. Raises ``MalformedFrame``.
    """
    at = 0
    while at < len(data):
        key, at = _read_varint(data, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise MalformedFrame("protobuf: field number 0")
        if kind == VARINT:
            value, at = _read_varint(data, at)
            yield number, kind, value
        elif kind == LENGTH:
            size, at = _read_varint(data, at)
            yield number, kind, _take(data, at, size)
            at += size
        elif kind in _FIXED_SIZE:
            size = _FIXED_SIZE[kind]
            yield number, kind, int.from_bytes(_take(data, at, size), "little")
            at += size
        else:
            raise MalformedFrame(f"protobuf: wire type {kind} in field {number}")


def message(data: bytes) -> dict[int, list[Value]]:
    """Return the values of each field number, in order. Raises ``MalformedFrame``."""
    found: dict[int, list[Value]] = {}
    for number, _, value in fields(data):
        found.setdefault(number, []).append(value)
    return found


def last_int(found: dict[int, list[Value]], number: int, default: int = 0) -> int:
    """Return a varint or fixed field. The last of several values counts.

    Args:
        found: The result of ``message``.
        number: The number of the field.
        default: The value if the field is missing.

    Raises:
        MalformedFrame: The field is of another type.
    """
    value = found[number][-1] if number in found else default
    if isinstance(value, int):
        return value
    raise MalformedFrame(f"protobuf: field {number} is no number")


def last_bytes(found: dict[int, list[Value]], number: int) -> bytes:
    """Return the last value of a length-delimited field; empty if it is missing. Raises
    ``MalformedFrame`` if the field is of another type."""
    value = found[number][-1] if number in found else b""
    if isinstance(value, bytes):
        return value
    raise MalformedFrame(f"protobuf: field {number} has no length")


def last_float(found: dict[int, list[Value]], number: int) -> float:
    """Return the last value of a ``float`` field; 0 if it is missing. Raises ``MalformedFrame`` if the
    field is of another type."""
    value = last_int(found, number)
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
    for found, kind, value in fields(data):
        if found != number:
            continue
        if isinstance(value, bytes):
            if len(value) % 8:
                raise MalformedFrame(f"protobuf: {len(value)} bytes of packed doubles in field {number}")
            values.extend(struct.unpack(f"<{len(value) // 8}d", value))
        elif kind == FIXED64:
            values.append(as_double(value))
        else:
            raise MalformedFrame(f"protobuf: field {number} is no double")
    return tuple(values)


def varints(data: bytes, number: int) -> tuple[int, ...]:
    """Return a repeated varint field of the message ``data``, packed or not. Raises
    ``MalformedFrame``."""
    values: list[int] = []
    for found, kind, value in fields(data):
        if found != number:
            continue
        if isinstance(value, bytes):
            at = 0
            while at < len(value):
                one, at = _read_varint(value, at)
                values.append(one)
        elif kind == VARINT:
            values.append(value)
        else:
            raise MalformedFrame(f"protobuf: field {number} is no varint")
    return tuple(values)


def varint_field(number: int, value: int) -> bytes:
    """Encode an unsigned number, or a value of an enum."""
    return _varint(number << 3 | VARINT) + _varint(value)


def double_field(number: int, value: float) -> bytes:
    return _varint(number << 3 | FIXED64) + struct.pack("<d", value)


def float_field(number: int, value: float) -> bytes:
    return _varint(number << 3 | FIXED32) + struct.pack("<f", value)


def fixed32_field(number: int, value: int) -> bytes:
    return _varint(number << 3 | FIXED32) + struct.pack("<I", value)


def bytes_field(number: int, value: bytes) -> bytes:
    """Encode a sub-message, a string (as UTF-8) or a packed list."""
    return _varint(number << 3 | LENGTH) + _varint(len(value)) + value


def double_fields(number: int, values: Iterable[float], packed: bool = False) -> bytes:
    """Encode a repeated ``double``, one field each, or packed in one field."""
    if packed:
        return bytes_field(number, b"".join(struct.pack("<d", value) for value in values))
    return b"".join(double_field(number, value) for value in values)


_FIXED_SIZE = {FIXED64: 8, FIXED32: 4}


def _take(data: bytes, at: int, size: int) -> bytes:
    if at + size > len(data):
        raise MalformedFrame(f"protobuf: {size} bytes announced, {len(data) - at} there")
    return data[at : at + size]


def _read_varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(_VARINT_BYTES):
        if at >= len(data):
            raise MalformedFrame("protobuf: the message ends inside a number")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << 7 * shift
        if byte < 0x80:
            if value >> 64:
                raise MalformedFrame("protobuf: a number of more than 64 bits")
            return value, at
    raise MalformedFrame("protobuf: a number of more than 10 bytes")


def _varint(value: int) -> bytes:
    if not 0 <= value < 1 << 64:
        raise ValueError(f"protobuf: {value} is no unsigned 64-bit number")
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
