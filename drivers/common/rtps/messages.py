"""Convert RTPS messages to values and back (RTPS specification, 8.3 and 9.4). Pure.

One malformed submessage makes the whole datagram invalid. A submessage is ignored if it is for another participant,
has another sender's name, or is of an unused kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from . import parameters
from .wire_types import BIG, LITTLE, PREFIX_SIZE, UNKNOWN, VENDOR, Address, Buffer, Order

HEADER_SIZE = 20
MAX_BITS = 256
"""Largest set of sequence numbers."""
MAX_FRAGMENTS = 65536

_MAGIC = b"RTPS"
# Booster's Fast DDS ignores participants of version 2.3 and later.
_VERSION = b"\x02\x02"
_MAX_SEQUENCE = 2**62

_PAD = 0x01
_ACKNACK = 0x06
_HEARTBEAT = 0x07
_GAP = 0x08
_INFO_TS = 0x09
_INFO_SRC = 0x0C
_INFO_DST = 0x0E
_NACK_FRAG = 0x12
_DATA = 0x15
_DATA_FRAG = 0x16

_ENDIAN = 0x01
_INLINE_QOS = 0x02
_HAS_DATA = 0x04
_HAS_KEY = 0x08
_FRAGMENT_OF_KEY = 0x04
_FINAL = 0x02
_DISPOSED_OR_UNREGISTERED = 0x03

Send = Callable[[Sequence[Buffer], Address], bool]
"""Sends one datagram, given in parts. Returns False if the network did not take it."""


class Data(NamedTuple):
    reader: bytes  # entity id of the receiving reader; UNKNOWN means every reader of the writer
    writer: bytes  # GUID of the writer
    sequence: int
    # The payload, with its encapsulation header. It is a view of the datagram, so copy it to keep it.
    payload: memoryview
    disposed: bool  # True if the message means that an object has ended; the payload may then be its key
    key: bytes  # hash of the object's key; may be empty


class Fragment(NamedTuple):
    reader: bytes
    writer: bytes
    sequence: int
    first: int  # index of the first fragment in this message; the sample's first fragment is 0
    pieces: int
    size: int  # size of a fragment in bytes; the last fragment of a sample may be shorter
    total: int  # size of the whole sample in bytes
    payload: memoryview
    disposed: bool


class Heartbeat(NamedTuple):
    reader: bytes
    writer: bytes  # GUID of the writer
    first: int
    last: int  # number of the last available sample; ``first - 1`` if no sample is available
    serial: int  # number of the heartbeat
    final: bool  # True if the reader need not answer


class AckNack(NamedTuple):
    reader: bytes  # GUID of the reader
    writer: bytes  # entity id of the writer
    base: int  # all samples with lower numbers have arrived
    missing: tuple[int, ...]
    serial: int | None  # number of the message; None for a kind that has no number
    final: bool


class Gap(NamedTuple):
    reader: bytes
    writer: bytes  # GUID of the writer
    start: int
    base: int  # the samples ``start <= n < base`` will not be sent
    listed: tuple[int, ...]  # further samples that will not be sent


Submessage = Data | Fragment | Heartbeat | AckNack | Gap


# -- decoding


MOST_SUBMESSAGES = 512
"""Of one datagram. CycloneDDS fills 14 kB with heartbeats of 32 bytes at most."""


def decode(datagram: memoryview, own: bytes) -> list[Submessage]:
    """Return the submessages of a datagram that are for the participant with the GUID prefix ``own``. Raise
    ``MalformedFrame``."""
    size = len(datagram)
    if size < HEADER_SIZE or datagram[:4] != _MAGIC:
        raise MalformedFrame("no RTPS header")
    if datagram[4] != _VERSION[0]:
        raise MalformedFrame(f"RTPS version {datagram[4]}.{datagram[5]}")
    source = bytes(datagram[8:HEADER_SIZE])
    mine = named = source != own
    submessages: list[Submessage] = []
    offset, count = HEADER_SIZE, 0
    while offset < size:
        count += 1
        if count > MOST_SUBMESSAGES:
            raise MalformedFrame(f"more than {MOST_SUBMESSAGES} submessages")
        if offset + 4 > size:
            raise MalformedFrame("a submessage header is cut off")
        kind, flags = datagram[offset], datagram[offset + 1]
        order = LITTLE if flags & _ENDIAN else BIG
        (length,) = order.u16.unpack_from(datagram, offset + 2)
        offset += 4
        end = offset + length if length or kind in (_PAD, _INFO_TS) else size
        if end > size:
            raise MalformedFrame("a submessage is longer than its datagram")
        body = datagram[offset:end]
        offset = end
        if kind == _INFO_DST:
            destination = bytes(_need(body, PREFIX_SIZE)[:PREFIX_SIZE])
            mine = named and destination in (own, bytes(PREFIX_SIZE))
        elif kind == _INFO_SRC:
            # INFO_SRC names the source of the following submessages. If it is not the sender of the datagram, they
            # are ignored, because the sender's address does not prove another participant's name.
            named = named and bytes(_need(body, 20)[8:20]) == source
            mine = mine and named
        elif decoder := _DECODERS.get(kind):
            part = decoder(body, flags, order, source)
            if mine:
                submessages.append(part)
    return submessages


def _need(body: memoryview, size: int) -> memoryview:
    if len(body) < size:
        raise MalformedFrame(f"a submessage of {len(body)} bytes that needs {size}")
    return body


def _sequence(high: int, low: int, least: int = 1) -> int:
    value = high << 32 | low
    if not least <= value < _MAX_SEQUENCE:
        raise MalformedFrame(f"sequence number {value}")
    return value


def _numbers(body: memoryview, offset: int, order: Order, base: int, bits: int) -> tuple[int, ...]:
    """Return the sequence numbers in an encoded set. Its bitmap begins at ``offset`` and has one bit for each of
    the ``bits`` numbers from ``base`` on."""
    if bits > MAX_BITS:
        raise MalformedFrame(f"a set of {bits} numbers")
    words = (bits + 31) // 32
    _need(body, offset + 4 * words)
    members = []
    for word in range(words):
        (value,) = order.u32.unpack_from(body, offset + 4 * word)
        if value:
            top = min(32, bits - 32 * word)
            members += [base + 32 * word + bit for bit in range(top) if value >> (31 - bit) & 1]
    return tuple(members)


def _content(body: memoryview, flags: int, order: Order, skip: int, least: int) -> tuple[memoryview, bool, bytes]:
    """Return the variable part of a sample: payload, disposed flag, key hash.

    Args:
        skip: Number of bytes from the end of the field "octets to inline QoS" to the variable part.
        least: Offset at which the fixed part ends.
    """
    offset = 4 + skip
    if offset < least or offset > len(body):
        raise MalformedFrame("inline QoS out of place")
    disposed, key = False, b""
    if flags & _INLINE_QOS:
        fields, offset = parameters.decode(body, offset, order)
        status = parameters.first(fields, parameters.STATUS, 4)
        disposed = status is not None and bool(status[3] & _DISPOSED_OR_UNREGISTERED)
        if (key_hash := parameters.first(fields, parameters.KEY_HASH, 16)) is not None:
            key = bytes(key_hash[:16])
    return body[offset:], disposed, key


def _data(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    _, skip, reader, writer, high, low = order.data.unpack_from(_need(body, order.data.size))
    payload, disposed, key = _content(body, flags, order, skip, order.data.size)
    if flags & _HAS_DATA and flags & _HAS_KEY:
        raise MalformedFrame("a sample that is data and key")
    if not flags & (_HAS_DATA | _HAS_KEY):
        payload = payload[:0]
    return Data(reader, source + writer, _sequence(high, low), payload, disposed or bool(flags & _HAS_KEY), key)


def _fragment(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    _need(body, order.fragment.size)
    _, skip, reader, writer, high, low, number, count, size, total = order.fragment.unpack_from(body)
    payload, disposed, _ = _content(body, flags, order, skip, order.fragment.size)
    if not number or not count or not size or total > size * MAX_FRAGMENTS:
        raise MalformedFrame("a fragment without a number")
    index = number - 1
    length = min(count * size, total - index * size)
    if (index + count - 1) * size >= total or len(payload) < length:
        raise MalformedFrame("a fragment past the end of its sample")
    return Fragment(
        reader,
        source + writer,
        _sequence(high, low),
        index,
        count,
        size,
        total,
        payload[:length],
        disposed or bool(flags & _FRAGMENT_OF_KEY),
    )


def _heartbeat(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    _need(body, order.heartbeat.size)
    reader, writer, high, low, last_high, last_low, count = order.heartbeat.unpack_from(body)
    first = _sequence(high, low)
    last = _sequence(last_high, last_low, first - 1)
    return Heartbeat(reader, source + writer, first, last, count, bool(flags & _FINAL))


def _acknack(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    offset = order.acknack.size
    reader, writer, high, low, bits = order.acknack.unpack_from(_need(body, offset))
    # Fast DDS requests its first heartbeat with base 0, so 0 is accepted here.
    base = _sequence(high, low, 0)
    missing = _numbers(body, offset, order, base, bits)
    offset += 4 * ((bits + 31) // 32)
    (count,) = order.u32.unpack_from(_need(body, offset + 4), offset)
    return AckNack(source + reader, writer, base, missing, count, bool(flags & _FINAL))


def _nack_fragment(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    """Decode a request for missing fragments. It is answered with the whole sample, so it becomes an
    ``AckNack``."""
    reader, writer, high, low, _ = order.acknack.unpack_from(_need(body, order.acknack.size))
    return AckNack(source + reader, writer, 0, (_sequence(high, low),), None, True)


def _gap(body: memoryview, flags: int, order: Order, source: bytes) -> Submessage:
    offset = order.gap.size
    reader, writer, high, low, base_high, base_low, bits = order.gap.unpack_from(_need(body, offset))
    start = _sequence(high, low)
    base = _sequence(base_high, base_low, start)
    return Gap(reader, source + writer, start, base, _numbers(body, offset, order, base, bits))


_DECODERS: dict[int, Callable[[memoryview, int, Order, bytes], Submessage]] = {
    _DATA: _data,
    _DATA_FRAG: _fragment,
    _HEARTBEAT: _heartbeat,
    _ACKNACK: _acknack,
    _NACK_FRAG: _nack_fragment,
    _GAP: _gap,
}


# -- encoding; byte order is always little endian

FRAGMENT_SIZE = 14_000
"""Longer samples are sent in fragments of this size, one in each datagram."""

PADDING = (b"", b"\x00\x00\x00", b"\x00\x00", b"\x00")
"""Padding by length modulo 4, because the next submessage starts at a multiple of 4."""

_DATA_SKIP = 16
_FRAGMENT_SKIP = 28


def header(prefix: bytes) -> bytes:
    return _MAGIC + _VERSION + VENDOR + prefix


def _submessage(kind: int, flags: int, body: bytes) -> bytes:
    return bytes((kind, flags | _ENDIAN)) + LITTLE.u16.pack(len(body)) + body


def _split(sequence: int) -> tuple[int, int]:
    return sequence >> 32, sequence & 0xFFFFFFFF


def info_destination(prefix: bytes) -> bytes:
    return _submessage(_INFO_DST, 0, prefix)


def data(reader: bytes, writer: bytes, sequence: int, payload: bytes) -> bytes:
    fixed = LITTLE.data.pack(0, _DATA_SKIP, reader, writer, *_split(sequence))
    return _submessage(_DATA, _HAS_DATA, fixed + payload + PADDING[len(payload) % 4])


def disposal(reader: bytes, writer: bytes, sequence: int, key: bytes, payload: bytes) -> bytes:
    """Return the submessage which announces that an object (a participant or an endpoint) has ended.

    Args:
        key: The GUID of the object.
        payload: The GUID as a parameter list.
    """
    fixed = LITTLE.data.pack(0, _DATA_SKIP, reader, writer, *_split(sequence))
    status = parameters.encoded(parameters.STATUS, bytes((0, 0, 0, _DISPOSED_OR_UNREGISTERED)))
    qos = parameters.encoded_list(parameters.encoded(parameters.KEY_HASH, key), status)
    return _submessage(_DATA, _INLINE_QOS | _HAS_KEY, fixed + qos + payload)


def fragments(reader: bytes, writer: bytes, sequence: int, payload: Buffer) -> Iterable[bytes]:
    """Yield the submessages of a long sample, each with one fragment."""
    total = len(payload)
    for index in range(-(-total // FRAGMENT_SIZE)):
        piece = bytes(payload[index * FRAGMENT_SIZE : (index + 1) * FRAGMENT_SIZE])
        fixed = LITTLE.fragment.pack(
            0, _FRAGMENT_SKIP, reader, writer, *_split(sequence), index + 1, 1, FRAGMENT_SIZE, total
        )
        yield _submessage(_DATA_FRAG, 0, fixed + piece + PADDING[len(piece) % 4])


def heartbeat(reader: bytes, writer: bytes, first: int, last: int, count: int, final: bool) -> bytes:
    body = LITTLE.heartbeat.pack(reader, writer, *_split(first), *_split(last), count & 0xFFFFFFFF)
    return _submessage(_HEARTBEAT, _FINAL if final else 0, body)


def _bitmap(base: int, members: Sequence[int]) -> tuple[int, bytes]:
    """Return the bitmap of a set of sequence numbers: the number of its bits, and its 32-bit words.

    Args:
        base: The number of the first bit.
        members: Ascending numbers, from ``base`` to less than ``base`` plus ``MAX_BITS``.
    """
    bits = members[-1] - base + 1 if members else 0
    words = [0] * ((bits + 31) // 32)
    for member in members:
        word, bit = divmod(member - base, 32)
        words[word] |= 1 << (31 - bit)
    return bits, b"".join(LITTLE.u32.pack(word) for word in words)


def acknack(reader: bytes, writer: bytes, base: int, missing: Sequence[int], count: int, final: bool) -> bytes:
    bits, words = _bitmap(base, missing)
    body = LITTLE.acknack.pack(reader, writer, *_split(base), bits) + words + LITTLE.u32.pack(count & 0xFFFFFFFF)
    return _submessage(_ACKNACK, _FINAL if final else 0, body)


def gap(reader: bytes, writer: bytes, start: int, end: int) -> bytes:
    """Return the submessage which announces that the samples ``start <= n < end`` will not be sent."""
    return _submessage(_GAP, 0, LITTLE.gap.pack(reader, writer, *_split(start), *_split(end), 0))


class Frame:
    """The bytes around the payload of a sample. Before it come the RTPS header and the start of the DATA
    submessage, after it, for a reliable writer, a final HEARTBEAT.

    They are made once and reused for each sample.
    """

    def __init__(self, prefix: bytes, writer: bytes, reliable: bool) -> None:
        self.head = bytearray(header(prefix) + data(UNKNOWN, writer, 0, b""))
        self.tail = bytearray(heartbeat(UNKNOWN, writer, 1, 1, 0, True) if reliable else b"")

    def parts(self, sequence: int, payload: Buffer, first: int, count: int) -> Sequence[Buffer]:
        """Return the parts of one datagram. They are valid until the next call.

        Args:
            sequence: Sequence number of the sample.
            payload: The sample.
            first: First available sequence number, for the heartbeat.
            count: Number of the heartbeat.
        """
        length = len(payload)
        padding = PADDING[length % 4]
        high, low = sequence >> 32, sequence & 0xFFFFFFFF
        LITTLE.u16.pack_into(self.head, _LENGTH_AT, LITTLE.data.size + length + len(padding))
        LITTLE.sequence.pack_into(self.head, _SEQUENCE_AT, high, low)
        if not self.tail:
            return self.head, payload, padding
        LITTLE.sequence.pack_into(self.tail, _FIRST_AT, first >> 32, first & 0xFFFFFFFF)
        LITTLE.sequence.pack_into(self.tail, _LAST_AT, high, low)
        LITTLE.u32.pack_into(self.tail, _COUNT_AT, count & 0xFFFFFFFF)
        return self.head, payload, padding, self.tail


_LENGTH_AT = HEADER_SIZE + 2
_SEQUENCE_AT = HEADER_SIZE + 4 + 12
_FIRST_AT = 4 + 8
_LAST_AT = 4 + 16
_COUNT_AT = 4 + 24
