"""Encode and decode discovery data, and check whether a writer and a reader fit.

SPDP announces participants, SEDP their writers and readers. Types are compared by name only. No type
information is sent, and received type information is ignored.
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

_BLOCKING_S = 0.1  # longest wait of a reliable write; the QoS needs it, but our writes never wait
_LEASE_S = (0.5, 600.0)  # an announced lease is clamped to these bounds
_DEFAULT_LEASE_S = 100.0  # 8.5.3.2
_MAX_NAME = 256


class ParticipantData(NamedTuple):
    prefix: bytes
    discovery: tuple[Address, ...]  # addresses for SEDP
    user: tuple[Address, ...]  # addresses for endpoints without a separate locator
    lease_s: float


class EndpointData(NamedTuple):
    guid: bytes
    topic: str
    type_name: str
    reliable: bool
    durability: int  # VOLATILE, TRANSIENT_LOCAL, or more
    locators: tuple[Address, ...]
    partitions: tuple[str, ...] = ()
    exclusive: bool = False  # ownership


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
    """Raise ``MalformedFrame``, also if the data have no IPv4 address."""
    found, order = pl.decode_payload(payload)
    guid = pl.first(found, pl.PARTICIPANT_GUID, 16)
    if guid is None or guid[PREFIX_SIZE:16] != PARTICIPANT:
        raise MalformedFrame("a participant without GUID")
    discovery = pl.addresses(found.get(pl.DISCOVERY_LOCATOR, []), order)
    if not discovery:
        raise MalformedFrame("a participant without an IPv4 locator")
    lease = pl.first(found, pl.LEASE, 8)
    lease_s = _DEFAULT_LEASE_S if lease is None else pl.seconds(lease, order)
    return ParticipantData(
        bytes(guid[:PREFIX_SIZE]),
        discovery,
        pl.addresses(found.get(pl.DEFAULT_LOCATOR, []), order) or discovery,
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
    """Raise ``MalformedFrame``. Absent values get their defaults, and the default reliability of writers
    and readers differs."""
    found, order = pl.decode_payload(payload)
    guid = pl.first(found, pl.ENDPOINT_GUID, 16)
    topic = pl.first(found, pl.TOPIC, 4)
    type_name = pl.first(found, pl.TYPE, 4)
    if guid is None or topic is None or type_name is None:
        raise MalformedFrame("an endpoint without GUID, topic or type")
    reliability = pl.number(found, pl.RELIABILITY, order, RELIABLE if is_writer else BEST_EFFORT)
    partition = pl.first(found, pl.PARTITION, 4)
    data = EndpointData(
        bytes(guid[:16]),
        pl.text(topic, order),
        pl.text(type_name, order),
        reliability >= RELIABLE,
        pl.number(found, pl.DURABILITY, order, VOLATILE),
        pl.addresses(found.get(pl.LOCATOR, []), order),
        () if partition is None else _strings(partition, order),
        bool(pl.number(found, pl.OWNERSHIP, order, 0)),
    )
    if not 0 < len(data.topic) <= _MAX_NAME or not 0 < len(data.type_name) <= _MAX_NAME:
        raise MalformedFrame("an endpoint without a name, or with an endless one")
    return data


def _strings(value: memoryview, order: Order) -> tuple[str, ...]:
    (count,) = order.u32.unpack_from(value)
    found, at = [], 4
    for _ in range(count):  # the count needs no bound, because a missing name raises MalformedFrame
        name = value[at:]
        found.append(pl.text(name, order))
        (length,) = order.u32.unpack_from(name)
        at += 4 + length + -length % 4
    return tuple(found)


def gone(payload: memoryview, key: bytes, parameter: int) -> bytes:
    """Return the GUID in the key hash or payload of a disposal. Raise ``MalformedFrame``."""
    if key:
        return key
    found, _ = pl.decode_payload(payload)
    guid = pl.first(found, parameter, 16)
    if guid is None:
        raise MalformedFrame("something has ended, and nobody says what")
    return bytes(guid[:16])


def encode_gone(guid: bytes, parameter: int) -> bytes:
    return pl.payload(pl.encoded(parameter, guid))


def mismatch(writer: EndpointData, reader: EndpointData) -> str:
    """Return why these two, of one topic, do not fit, or an empty text if they do."""
    if writer.type_name != reader.type_name:
        return f"type {writer.type_name} is written, {reader.type_name} is read"
    if reader.reliable and not writer.reliable:
        return "best effort is offered, reliable is asked for"
    if reader.durability > writer.durability:
        return f"durability {writer.durability} is offered, {reader.durability} is asked for"
    if writer.exclusive != reader.exclusive:
        return "ownership is exclusive on one side only"
    # Ours are in the default partition. Names are compared literally, without wildcards.
    if not set(writer.partitions or ("",)) & set(reader.partitions or ("",)):
        return f"partitions {writer.partitions} and {reader.partitions} have none in common"
    return ""


def nearest(locators: Sequence[Address], heard_from: str, own: str) -> Address:
    """Return the best address of a peer.

    Preferred is the host from which it sends, then an address that is a loopback address exactly if
    ours is one, then the first.
    """

    def rank(address: Address) -> tuple[bool, bool]:
        return address[0] != heard_from, is_loopback(address[0]) != is_loopback(own)

    return min(locators, key=rank)


def is_loopback(host: str) -> bool:
    return host.startswith("127.")
