"""Encode and decode parameter lists, the format of discovery data and inline QoS (RTPS specification, 9.4.2.11).
Parameters that we do not use are skipped, also vendor-specific ones (ids from 0x8000)."""

from __future__ import annotations

import socket

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .wire_types import BIG, LITTLE, Address, Order

PAD = 0x00
SENTINEL = 0x01
LEASE = 0x02
TOPIC = 0x05
TYPE = 0x07
PROTOCOL_VERSION = 0x15
VENDOR_ID = 0x16
RELIABILITY = 0x1A
DURABILITY = 0x1D
OWNERSHIP = 0x1F
PARTITION = 0x29
LOCATOR = 0x2F
DEFAULT_LOCATOR = 0x31
DISCOVERY_LOCATOR = 0x32
PARTICIPANT_GUID = 0x50
BUILTIN_SET = 0x58
ENDPOINT_GUID = 0x5A
KEY_HASH = 0x70
STATUS = 0x71

VENDOR_SPECIFIC = 0x8000
ID_MASK = 0x3FFF  # removes the vendor bit and the must-understand bit from a parameter id

PL_CDR_LE = b"\x00\x03\x00\x00"
_ORDERS = {b"\x00\x02": BIG, b"\x00\x03": LITTLE}
_UDP_V4 = 1

Parameters = dict[int, list[memoryview]]


# -- decoding


def decode(body: memoryview, offset: int, order: Order) -> tuple[Parameters, int]:
    """Return the parameter list that starts at ``offset``, and the offset of its end.

    Raises:
        MalformedFrame: The list has no end mark, or a value exceeds the message.
    """
    fields: Parameters = {}
    size = len(body)
    while offset + 4 <= size:
        parameter, length = order.pair.unpack_from(body, offset)
        offset += 4
        if parameter == SENTINEL:
            return fields, offset
        if offset + length > size:
            raise MalformedFrame(f"parameter {parameter:#06x} is longer than its list")
        if parameter != PAD and not parameter & VENDOR_SPECIFIC:
            fields.setdefault(parameter & ID_MASK, []).append(body[offset : offset + length])
        offset += length
    raise MalformedFrame("a parameter list without end")


def decode_payload(payload: memoryview) -> tuple[Parameters, Order]:
    """Decode the payload of a discovery sample, which starts with an encapsulation header."""
    order = _ORDERS.get(bytes(payload[:2]))
    if order is None:
        raise MalformedFrame("discovery data that is no parameter list")
    return decode(payload, 4, order)[0], order


def first(fields: Parameters, parameter: int, size: int) -> memoryview | None:
    """Return the first value of a parameter; None if it is missing. Raise ``MalformedFrame`` if it has fewer than
    ``size`` bytes."""
    values = fields.get(parameter)
    if values is None:
        return None
    if len(values[0]) < size:
        raise MalformedFrame(f"parameter {parameter:#06x} is too short")
    return values[0]


def number(fields: Parameters, parameter: int, order: Order, default: int) -> int:
    value = first(fields, parameter, 4)
    return default if value is None else order.u32.unpack_from(value)[0]


def text(value: memoryview, order: Order) -> str:
    """Decode a CDR string."""
    if len(value) < 4:
        raise MalformedFrame("a string without length")
    (length,) = order.u32.unpack_from(value)
    if not 1 <= length <= len(value) - 4:
        raise MalformedFrame("a string that is longer than its parameter")
    try:
        return str(value[4 : 3 + length], "utf-8")
    except UnicodeDecodeError:
        raise MalformedFrame("a string that is not UTF-8") from None


def addresses(values: list[memoryview], order: Order) -> tuple[Address, ...]:
    """Return the UDP/IPv4 addresses among encoded locators."""
    result = []
    for value in values:
        if len(value) < 24:
            raise MalformedFrame("a locator that is too short")
        kind, port, host = order.locator.unpack_from(value)
        if kind == _UDP_V4 and 0 < port < 65536:
            result.append((socket.inet_ntoa(host[12:]), port))
    return tuple(result)


def seconds(value: memoryview, order: Order) -> float:
    whole, fraction = order.duration.unpack_from(value)
    return float(whole) + float(fraction) / 2**32


# -- encoding; byte order is always little endian


def encoded(parameter: int, value: bytes) -> bytes:
    value += bytes(-len(value) % 4)
    return LITTLE.pair.pack(parameter, len(value)) + value


def encoded_text(parameter: int, value: str) -> bytes:
    characters = value.encode() + b"\x00"
    return encoded(parameter, LITTLE.u32.pack(len(characters)) + characters)


def encoded_address(parameter: int, address: Address) -> bytes:
    host, port = address
    return encoded(parameter, LITTLE.locator.pack(_UDP_V4, port, bytes(12) + socket.inet_aton(host)))


def encoded_seconds(value: float) -> bytes:
    whole = int(value)
    return LITTLE.duration.pack(whole, int((value - whole) * 2**32))


def encoded_list(*parameters: bytes) -> bytes:
    return b"".join(parameters) + LITTLE.pair.pack(SENTINEL, 0)


def payload(*parameters: bytes) -> bytes:
    """Encode the payload of a discovery sample, with its encapsulation header."""
    return PL_CDR_LE + encoded_list(*parameters)
