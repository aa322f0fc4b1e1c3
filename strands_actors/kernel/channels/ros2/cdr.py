"""Encode and decode ROS messages as CDR (XCDR version 1), the format of their bytes on the wire. Pure.

A message is a dictionary of its fields. Its bytes begin with four bytes: the encoding, here CDR in little endian
(``00 01``), and two options. Each number is aligned to its size, counted from the byte after these four. A text
has its length with its final zero byte, a sequence has its number of elements.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

from .definitions import ARRAY, BOUNDED, SINGLE, FieldType, fields_of, parse_type

LITTLE, BIG = b"\x00\x01", b"\x00\x00"
FORMATS: Mapping[str, str] = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""The basic types of fixed size, with their format of ``struct``. Each is aligned to its size."""
_BYTES = ("byte", "char", "uint8")


class MalformedCdr(ValueError):
    """Received bytes are not a message of the expected type."""


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """Return the bytes of a message.

    Args:
        name: The name of the type, such as ``sensor_msgs/msg/JointState``.
        message: The fields. A field that is left out is zero, empty or False.

    Raises:
        ValueError: A value does not fit its field, or the message has a field that its type lacks.
    """
    body = bytearray()
    try:
        _put_message(body, name, message)
    except (struct.error, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"{name}: a value does not fit its field: {error}") from error
    return LITTLE + b"\0\0" + bytes(body)


def decode(name: str, data: bytes) -> dict[str, Any]:
    """Return the message in these bytes. Bytes after its last field are ignored, since CDR pads with them.

    Raises:
        MalformedCdr: The bytes are not a message of this type.
    """
    if len(data) < 4 or data[:2] not in (LITTLE, BIG):
        raise MalformedCdr(f"{name}: the encoding is {data[:2].hex() or 'missing'}, and only CDR is supported")
    return _Reader(data, "<" if data[:2] == LITTLE else ">").message(name)


# -- encode


def _align(body: bytearray, size: int) -> None:
    body.extend(bytes(-len(body) % size))


def _put_message(body: bytearray, name: str, message: Mapping[str, Any]) -> None:
    fields = fields_of(name)
    if unknown := message.keys() - fields.keys():
        raise ValueError(f"{name} has no field {', '.join(sorted(unknown))}")
    for field, text in fields.items():
        _put_field(body, parse_type(text), message.get(field))


def _put_field(body: bytearray, field: FieldType, value: Any) -> None:
    if field.kind == SINGLE:
        _put_values(body, field.base, [_default(field.base) if value is None else value])
        return
    if field.kind == ARRAY:
        values: Any = [_default(field.base)] * field.size if value is None else value
        if len(values) != field.size:
            raise ValueError(f"an array of {field.size} {field.base} has {len(values)} values")
    else:
        values = () if value is None else value
        if field.kind == BOUNDED and len(values) > field.size:
            raise ValueError(f"a sequence of at most {field.size} {field.base} has {len(values)} values")
        _put_number(body, "uint32", len(values))
    _put_values(body, field.base, values)


def _put_values(body: bytearray, base: str, values: Sequence[Any]) -> None:
    if base in _BYTES and isinstance(values, bytes | bytearray | memoryview):
        body.extend(values)
    elif base in FORMATS:
        if values:
            _align(body, struct.calcsize(FORMATS[base]))
            body.extend(struct.pack(f"<{len(values)}{FORMATS[base]}", *values))
    elif base == "string":
        for value in values:
            text = value.encode()
            _put_number(body, "uint32", len(text) + 1)
            body.extend(text + b"\0")
    else:
        for value in values:
            _put_message(body, base, value)


def _put_number(body: bytearray, base: str, value: int) -> None:
    _put_values(body, base, [value])


def _default(base: str) -> Any:
    if base in FORMATS:
        return 0
    return "" if base == "string" else {}


# -- decode


class _Reader:
    def __init__(self, data: bytes, order: str) -> None:
        self._data = data
        self._order = order
        self._offset = 4

    def message(self, name: str) -> dict[str, Any]:
        types = fields_of(name).items()
        return {field: self._field(parse_type(text), f"{name}.{field}") for field, text in types}

    def _field(self, field: FieldType, where: str) -> Any:
        if field.kind == SINGLE:
            return self._values(field.base, 1, where)[0]
        count = field.size if field.kind == ARRAY else self._number("uint32", where)
        if field.kind == BOUNDED and count > field.size:
            raise MalformedCdr(f"{where}: {count} elements, and at most {field.size} are allowed")
        return self._values(field.base, count, where)

    def _values(self, base: str, count: int, where: str) -> Any:
        if base in FORMATS:
            if not count:
                return []
            size = struct.calcsize(FORMATS[base])
            self._align(size)
            data = self._take(size * count, where)
            if base in _BYTES and count > 1:
                return data
            # A bool on the wire may have any byte. ``struct`` reads every byte but 0 as True.
            return list(struct.unpack(f"{self._order}{count}{FORMATS[base]}", data))
        # Each element has at least one byte. So a false count cannot make this loop longer than the message.
        if count > len(self._data) - self._offset:
            raise MalformedCdr(f"{where}: {count} elements do not fit into the message")
        return [self._text(where) if base == "string" else self.message(base) for _ in range(count)]

    def _text(self, where: str) -> str:
        length = self._number("uint32", where)
        if not length:  # Some senders give an empty text no final zero byte.
            return ""
        data = self._take(length, where)
        try:
            return data[:-1].decode() if data[-1] == 0 else data.decode()
        except UnicodeDecodeError as error:
            raise MalformedCdr(f"{where}: the text is not UTF-8") from error

    def _number(self, base: str, where: str) -> int:
        return int(self._values(base, 1, where)[0])

    def _align(self, size: int) -> None:
        self._offset += -(self._offset - 4) % size

    def _take(self, size: int, where: str) -> bytes:
        data = self._data[self._offset : self._offset + size]
        if len(data) < size:
            raise MalformedCdr(f"{where}: the message ends after {len(self._data)} bytes")
        self._offset += size
        return data
