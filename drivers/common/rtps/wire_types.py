"""Basic definitions of RTPS: GUIDs, entity ids, ports and byte orders.

The numbers come from DDSI-RTPS 2.2, chapter 9 (mapping to UDP).
"""

from __future__ import annotations

import struct
from typing import NamedTuple

Buffer = bytes | bytearray | memoryview
Address = tuple[str, int]
"""IPv4 host and UDP port."""


# -- names. A GUID has 16 bytes: the participant's prefix (12) and an entity id (4).

VENDOR = bytes.fromhex("0199")
"""An id that no vendor holds: stacks switch on work-arounds for those they know."""

PREFIX_SIZE = 12
UNKNOWN = bytes(4)
PARTICIPANT = bytes.fromhex("000001c1")
SPDP_WRITER = bytes.fromhex("000100c2")
SPDP_READER = bytes.fromhex("000100c7")
PUBLICATIONS_WRITER = bytes.fromhex("000003c2")
PUBLICATIONS_READER = bytes.fromhex("000003c7")
SUBSCRIPTIONS_WRITER = bytes.fromhex("000004c2")
SUBSCRIPTIONS_READER = bytes.fromhex("000004c7")
BUILTIN_ENDPOINTS = 0x3F
"""SPDP and SEDP, each both ways. Nothing else is offered: no liveliness messages, no types."""

CDR = b"\0\1\0\0"
"""Encapsulation of a payload: little endian CDR."""

MAX_ENTITIES = 255


def writer_id(number: int) -> bytes:
    """Return the entity id of a writer of user data (without a key).

    The number, 1..``MAX_ENTITIES``, fills three bytes of the id. So two ids of one participant differ in several
    bytes, and a single damaged byte cannot turn one id into another.
    """
    return bytes((number, number, number, 0x03))


def reader_id(number: int) -> bytes:
    """As ``writer_id``."""
    return bytes((number, number, number, 0x04))


# -- ports (RTPS specification, 9.6.1.1, default mapping)

MULTICAST_GROUP = "239.255.0.1"
MAX_DOMAIN = 232
MAX_PORT = 65535


def multicast_port(domain: int) -> int:
    return 7400 + 250 * domain


def discovery_port(domain: int, index: int) -> int:
    return 7410 + 250 * domain + 2 * index


def indices(domain: int) -> int:
    """Return the number of participants that can use one address in this domain. Higher ports belong to the next
    domain, or do not exist."""
    return min(120, (MAX_PORT - user_port(domain, 0)) // 2 + 1)


def user_port(domain: int, index: int) -> int:
    return 7411 + 250 * domain + 2 * index


# -- byte orders


class Order(NamedTuple):
    """The field layouts of one byte order. A sequence number is a signed high word and an unsigned low word."""

    u16: struct.Struct
    u32: struct.Struct
    pair: struct.Struct  # fields: parameter id, length
    sequence: struct.Struct
    data: struct.Struct  # fields: flags, octets to inline QoS, reader, writer, sequence number
    # Fields of DATA_FRAG: those of DATA, then first fragment, number of fragments, fragment size, sample size.
    fragment: struct.Struct
    heartbeat: struct.Struct  # fields: reader, writer, first number, last number, count
    acknack: struct.Struct  # fields: reader, writer, base, number of bits
    gap: struct.Struct  # fields: reader, writer, start, base, number of bits
    locator: struct.Struct  # fields: kind, port, address
    duration: struct.Struct  # fields: seconds, and a fraction in units of 2^-32 seconds


def _order(sign: str) -> Order:
    return Order(
        *(
            struct.Struct(sign + layout)
            for layout in (
                "H",
                "I",
                "HH",
                "iI",
                "HH4s4siI",
                "HH4s4siIIHHI",
                "4s4siIiII",
                "4s4siII",
                "4s4siIiII",
                "iI16s",
                "iI",
            )
        )
    )


LITTLE = _order("<")
BIG = _order(">")
