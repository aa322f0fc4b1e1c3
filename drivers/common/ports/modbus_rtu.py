"""Modbus RTU: a codec with a checksum, and a decoder that finds the beginning of a frame. Pure.

RTU frames have no start mark, and replies have no number. Bytes count as a frame if their length fits their
function code and their checksum is correct. So a master must send one request at a time (``half_duplex``).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ModbusPDU

from .modbus import exception_words

OVERHEAD = 4
"""Bytes of a frame that are no parameters: unit, function, checksum."""

_MIN = 4
_MAX = 256
_UNIT_AND_FUNCTION = 2
_CHECKSUM = 2
_EXCEPTION = 0x80

_READS = (3, 4)
_WRITE_ONE, _WRITE, _READ_WRITE = 6, 16, 23

_REQUEST_BYTES: Mapping[int, tuple[int, int | None]] = {
    **dict.fromkeys(_READS, (8, None)),
    _WRITE_ONE: (8, None),
    _WRITE: (9, 6),
    _READ_WRITE: (13, 10),
}
"""By function: the length of a frame, and the index of the byte with the number of further bytes."""
_REPLY_BYTES: Mapping[int, tuple[int, int | None]] = {
    **dict.fromkeys((*_READS, _READ_WRITE), (5, 2)),
    _WRITE_ONE: (8, None),
    _WRITE: (8, None),
}


class RtuFrame(NamedTuple):
    """A frame with a correct checksum."""

    id: int  # Modbus unit id
    function: int
    params: bytes
    bytes: bytes  # the whole frame with its checksum

    @property
    def failure(self) -> str:
        """Why the unit did not carry out the request, from its reply; empty if it did."""
        return exception_words(self.params[0]) if self.function & _EXCEPTION else ""


class RtuDecoder:
    """Find frames in a stream of bytes. Bytes that belong to no frame are skipped one by one."""

    def __init__(self, *, requests: bool) -> None:
        """Make a decoder: with ``requests`` for the requests of a master, otherwise for the replies of a unit."""
        self._lengths = _REQUEST_BYTES if requests else _REPLY_BYTES
        self._answers = not requests
        self._pending = b""

    def clear(self) -> None:
        self._pending = b""

    def feed(self, data: bytes) -> Iterator[RtuFrame]:
        self._pending += data
        while len(self._pending) >= _MIN:
            size = self._size()
            if size > len(self._pending):
                return
            frame = self._pending[:size]
            if size and frame[-_CHECKSUM:] == checksum(frame[:-_CHECKSUM]):
                self._pending = self._pending[size:]
                yield RtuFrame(frame[0], frame[1], frame[_UNIT_AND_FUNCTION:-_CHECKSUM], frame)
            else:
                self._pending = self._pending[1:]

    def _size(self) -> int:
        """Return the size of the frame at the beginning of the buffer; 0 if no frame can begin with these bytes."""
        function = self._pending[1]
        if self._answers and function & _EXCEPTION:
            return 5 if function & ~_EXCEPTION in self._lengths else 0
        size, length_offset = self._lengths.get(function, (0, None))
        if length_offset is not None:
            # Until the byte that holds the length has arrived, ``size`` is the size without the variable part.
            size += self._pending[length_offset] if len(self._pending) > length_offset else 0
        return size if size <= _MAX else 0


def checksum(frame: bytes) -> bytes:
    """Return the CRC-16/MODBUS of a frame, low byte first."""
    return FramerRTU.compute_CRC(frame).to_bytes(2, "big")


def encode(pdu: ModbusPDU) -> bytes:
    """Return the frame of a PDU. Its ``dev_id`` must be set."""
    frame: bytes = FramerRTU(DecodePDU(is_server=False)).buildFrame(pdu)
    return frame


def request_of(frame: RtuFrame) -> ModbusPDU | None:
    """Decode the request in a master's frame; return None if pymodbus does not know its function code."""
    pdu = DecodePDU(is_server=True).decode(frame.bytes[1:-_CHECKSUM])
    if pdu is not None:
        pdu.dev_id = frame.id
    return pdu
