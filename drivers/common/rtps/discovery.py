"""Encode and decode RTPS discovery data, and check whether a writer and a reader are compatible.

The protocol SPDP announces participants, SEDP announces their writers and readers. Types are compared by name only.
No type information is sent, and received type information is ignored.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from . import parameters as pl
from .wire_types import (
    BUILTIN_ENDPOINTS,
    LITTLE,
    PARTICIPANT,
    PREFIX_SIZE,
    VENDOR,
    Address,
    Order,
)

BEST_EFFORT = 1
RELIABLE = 2
VOLATILE = 0
TRANSIENT_LOCAL = 1

# The announcement must name the longest wait of a reliable write, although our writes never wait.
_BLOCKING_S = 0.1
_LEASE_S = (0.5, 600.0)  # bounds of a received lease, in seconds
_DEFAULT_LEASE_S = 100.0  # lease of a participant that announces no lease (RTPS specification, 8.5.3.2)
_MAX_NAME = 256


class ParticipantData(NamedTuple):
    prefix: bytes
    discovery: tuple[Address, ...]  # addresses that receive SEDP messages
    user: tuple[Address, ...]  # addresses of endpoints that announce no address
    lease_s: float


class EndpointData(NamedTuple):
    guid: bytes
    topic: str
    type_name: str
    reliable: bool
    durability: int  # VOLATILE, TRANSIENT_LOCAL, or a higher level
    locators: tuple[Address, ...]
    partitions: tuple[str, ...] = ()
    exclusive: bool = False  # True if the ownership of the topic is exclusive


def encode_participant(data: ParticipantData) -> bytes:
    return pl.payload(
        pl.encoded(pl.PROTOCOL_VERSION, b"\x02\x02"),
        pl.encoded(pl.VENDOR_ID, VENDOR),
        pl.encoded(pl.PARTICIPANT_GUID, data.prefix + PARTICIPANT),
        pl.encoded(pl.BUILTIN_SET, LITTLE.u32.pack(BUILTIN_ENDPOINTS)),
        *(pl.encoded_address(pl.DISCOVERY_LOCATOR, address) for address in data.discovery),
        *(pl.encoded_address(pl.DEFAULT_LOCATOR, address) for address in data.user),
        pl.encoded(pl.LEASE, pl.encoded_seconds(data.lease_s)),
    )


def decode_participant(payload: memoryview) -> ParticipantData:
    """Decode a participant's announcement. Raise ``MalformedFrame`` if it is malformed or has no IPv4 address."""
    fields, order = pl.decode_payload(payload)
    guid = pl.first(fields, pl.PARTICIPANT_GUID, 16)
    if guid is None or guid[PREFIX_SIZE:16] != PARTICIPANT:
        raise MalformedFrame("a participant without GUID")
    discovery = pl.addresses(fields.get(pl.DISCOVERY_LOCATOR, []), order)
    if not discovery:
        raise MalformedFrame("a participant without an IPv4 locator")
    lease = pl.first(fields, pl.LEASE, 8)
    lease_s = _DEFAULT_LEASE_S if lease is None else pl.seconds(lease, order)
    return ParticipantData(
        bytes(guid[:PREFIX_SIZE]),
        discovery,
        pl.addresses(fields.get(pl.DEFAULT_LOCATOR, []), order) or discovery,
        min(max(lease_s, _LEASE_S[0]), _LEASE_S[1]),
    )


def encode_endpoint(data: EndpointData) -> bytes:
    reliability = RELIABLE if data.reliable else BEST_EFFORT
    return pl.payload(
        pl.encoded(pl.ENDPOINT_GUID, data.guid),
        pl.encoded(pl.PARTICIPANT_GUID, data.guid[:PREFIX_SIZE] + PARTICIPANT),
        pl.encoded_text(pl.TOPIC, data.topic),
        pl.encoded_text(pl.TYPE, data.type_name),
        pl.encoded(pl.RELIABILITY, LITTLE.u32.pack(reliability) + pl.encoded_seconds(_BLOCKING_S)),
        pl.encoded(pl.DURABILITY, LITTLE.u32.pack(data.durability)),
        *(pl.encoded_address(pl.LOCATOR, address) for address in data.locators),
    )


def decode_endpoint(payload: memoryview, is_writer: bool) -> EndpointData:
    """Decode the announcement of a writer or a reader. Raise ``MalformedFrame``.

    Missing values get their defaults. The default reliability is RELIABLE for writers and BEST_EFFORT for readers.
    """
    fields, order = pl.decode_payload(payload)
    guid = pl.first(fields, pl.ENDPOINT_GUID, 16)
    topic = pl.first(fields, pl.TOPIC, 4)
    type_name = pl.first(fields, pl.TYPE, 4)
    if guid is None or topic is None or type_name is None:
        raise MalformedFrame("an endpoint without GUID, topic or type")
    reliability = pl.number(fields, pl.RELIABILITY, order, RELIABLE if is_writer else BEST_EFFORT)
    partition = pl.first(fields, pl.PARTITION, 4)
    data = EndpointData(
        bytes(guid[:16]),
        pl.text(topic, order),
        pl.text(type_name, order),
        reliability >= RELIABLE,
        pl.number(fields, pl.DURABILITY, order, VOLATILE),
        pl.addresses(fields.get(pl.LOCATOR, []), order),
        () if partition is None else _strings(partition, order),
        bool(pl.number(fields, pl.OWNERSHIP, order, 0)),
    )
    if not 0 < len(data.topic) <= _MAX_NAME or not 0 < len(data.type_name) <= _MAX_NAME:
        raise MalformedFrame("an endpoint without a name, or with an endless one")
    return data


def _strings(value: memoryview, order: Order) -> tuple[str, ...]:
    (count,) = order.u32.unpack_from(value)
    names, offset = [], 4
    # The number of names needs no check, because a missing name raises MalformedFrame.
    for _ in range(count):
        name = value[offset:]
        names.append(pl.text(name, order))
        (length,) = order.u32.unpack_from(name)
        offset += 4 + length + -length % 4
    return tuple(names)


def ended_guid(payload: memoryview, key: bytes, parameter: int) -> bytes:
    """Return the GUID of the participant or endpoint that has ended, from the key hash or the payload of the
    message. Raise ``MalformedFrame``."""
    if key:
        return key
    fields, _ = pl.decode_payload(payload)
    guid = pl.first(fields, parameter, 16)
    if guid is None:
        raise MalformedFrame("something has ended, and nobody says what")
    return bytes(guid[:16])


def encode_ended(guid: bytes, parameter: int) -> bytes:
    return pl.payload(pl.encoded(parameter, guid))


def mismatch(writer: EndpointData, reader: EndpointData) -> str:
    """Return why a writer and a reader of one topic are not compatible; empty if they are."""
    if writer.type_name != reader.type_name:
        return f"type {writer.type_name} is written, {reader.type_name} is read"
    if reader.reliable and not writer.reliable:
        return "best effort is offered, reliable is asked for"
    if reader.durability > writer.durability:
        return f"durability {writer.durability} is offered, {reader.durability} is asked for"
    if writer.exclusive != reader.exclusive:
        return "ownership is exclusive on one side only"
    # Our endpoints are in the default partition. Names are compared literally, without wildcards.
    if not set(writer.partitions or ("",)) & set(reader.partitions or ("",)):
        return f"partitions {writer.partitions} and {reader.partitions} have none in common"
    return ""


def nearest(locators: Sequence[Address], sender_host: str, own: str) -> Address:
    """Return the address of a peer to which data should be sent.

    An address on the host from which the peer sends is preferred. The next choice is a loopback address if our
    address is one, and another address otherwise. The last choice is the first address.
    """

    def rank(address: Address) -> tuple[bool, bool]:
        return address[0] != sender_host, is_loopback(address[0]) != is_loopback(own)

    return min(locators, key=rank)


def is_loopback(host: str) -> bool:
    return host.startswith("127.")
