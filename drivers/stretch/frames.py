"""Frames of Stretch's boards: COBS, CRC-16, and the split of a call into frames. Pure: no I/O, no clock.

A frame is ``COBS(code data.. crc crc) 00``: CRC-16/Modbus (polynomial 0xA001, initial 0xFFFF), high byte first.
A request to a board is named a call. It is a number and its arguments, and its reply has the next number. There
is no sequence number, so a late reply looks like the answer to the next call of the same kind.

These robots speak transport V1. A call that commands is *pushed* in frames of 58 bytes. Each frame is
acknowledged, and the last acknowledgement contains the reply. A call that asks is *pulled*: the host requests
each frame of the reply, of 58 bytes. Transport V0 is older. It is used for the one call that every firmware
answers, identification.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

END = b"\x00"
RESYNC = END
"""It is sent before the first safe frame, and ends a frame that was cut before."""

MAX_FRAME = 64
"""Bytes. A longer one does not fit into a board's receive buffer, so it is no frame."""
OVERHEAD = 5
"""Bytes of a frame beside its data: COBS, code, CRC, end."""

CHUNK_V1 = 58
CHUNK_V0 = 32
MAX_CALL = 1024

PUSH_FIRST, PUSH_ONLY, PUSH_MORE, PUSH_LAST, PUSH_ACK = 201, 202, 203, 204, 205
PULL_FIRST, PULL_NEXT, PULL_MORE, PULL_LAST = 206, 207, 208, 209
V0_START, V0_STARTED, V0_SEND_MORE, V0_SENT_MORE, V0_SEND_LAST, V0_SENT_LAST = 100, 101, 102, 103, 104, 105
V0_GET, V0_GOT_MORE, V0_GOT_LAST = 106, 107, 108


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = crc >> 1 ^ 0xA001 if crc & 1 else crc >> 1
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes) -> int:
    crc = 0xFFFF
    for byte in data:
        crc = crc >> 8 ^ _CRC[(crc ^ byte) & 0xFF]
    return crc


_ONE_OF = {PULL_MORE: PULL_LAST, V0_GOT_MORE: V0_GOT_LAST}
"""The code by which a reply is awaited, for each code that it may have instead."""


class Frame(NamedTuple):
    """One frame with a valid checksum, as a ``half_duplex.Packet``. A reply is recognised by its code. Its
    length depends on the firmware, so the decoder of the reply checks the length."""

    code: int
    data: bytes

    @property
    def id(self) -> int:
        return _ONE_OF.get(self.code, self.code)

    @property
    def params(self) -> bytes:
        return b""

    @property
    def failure(self) -> str:
        return ""


def frame(code: int, data: bytes = b"") -> bytes:
    """Encode one frame. Raise ``ValueError`` if the data do not fit."""
    if len(data) > CHUNK_V1:
        raise ValueError(f"{len(data)} bytes do not fit into one frame of {CHUNK_V1}")
    body = bytes((code,)) + data
    return stuff(body + crc16(body).to_bytes(2, "big")) + END


def stuff(data: bytes) -> bytes:
    """Encode up to 253 bytes by COBS. The result has no zero."""
    stuffed = bytearray()
    for run in data.split(END):
        stuffed.append(len(run) + 1)
        stuffed += run
    return bytes(stuffed)


def unstuff(data: bytes) -> bytes:
    """Decode COBS. Raise ``MalformedFrame``."""
    plain = bytearray()
    index = 0
    while index < len(data):
        size = data[index]
        if size == 0 or index + size > len(data):
            raise MalformedFrame("the bytes are no COBS")
        plain += data[index + 1 : index + size]
        index += size
        if index < len(data):
            plain.append(0)
    return bytes(plain)


def parse(data: bytes) -> Frame:
    """Decode the bytes between two frame ends (zero bytes). Raise ``MalformedFrame``."""
    body = unstuff(data)
    if len(body) < 3:
        raise MalformedFrame(f"{len(body)} bytes are too few for a frame")
    if crc16(body[:-2]).to_bytes(2, "big") != body[-2:]:
        raise MalformedFrame("the checksum is wrong")
    return Frame(body[0], body[1:-2])


class Decoder:
    """Decode a stream of bytes into frames with a valid checksum. Garbage is skipped and counted. An incomplete
    frame is kept until the rest arrives."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._too_long = False
        self.garbage_bytes = 0

    @property
    def pending(self) -> int:
        """Return the number of received bytes of a frame that is not complete yet."""
        return len(self._buffer)

    def clear(self) -> None:
        self._buffer.clear()
        self._too_long = False

    def feed(self, data: bytes) -> Iterator[Frame]:
        *ended, rest = data.split(END)
        for part in ended:
            whole = bytes(self._buffer) + part
            lost, self._too_long = self._too_long, False
            self._buffer.clear()
            complete = None if lost or len(whole) >= MAX_FRAME else _frame_in(whole)
            if complete is None:
                self.garbage_bytes += len(whole)
            else:
                yield complete
        self._buffer += rest
        if len(self._buffer) >= MAX_FRAME:
            self.garbage_bytes += len(self._buffer)
            self._buffer.clear()
            self._too_long = True


def _frame_in(data: bytes) -> Frame | None:
    try:
        return parse(data) if data else None
    except MalformedFrame:
        return None


# -- calls over transport V1


def pushes(call: bytes) -> tuple[bytes, ...]:
    """Return the frames that send a commanding call (a request to a board) of any length. Raise ``ValueError`` if
    it is too long."""
    if not 0 < len(call) <= MAX_CALL:
        raise ValueError(f"a call has 1 to {MAX_CALL} bytes, not {len(call)}")
    chunks = [call[start : start + CHUNK_V1] for start in range(0, len(call), CHUNK_V1)]
    if len(chunks) == 1:
        return (frame(PUSH_ONLY, call),)
    codes = (PUSH_FIRST, *[PUSH_MORE] * (len(chunks) - 2), PUSH_LAST)
    return tuple(frame(code, chunk) for code, chunk in zip(codes, chunks, strict=True))


def push(call: bytes) -> bytes:
    """Return the frame that sends a short commanding call (a request to a board). Raise ``ValueError`` if it is
    too long for one frame."""
    return frame(PUSH_ONLY, call)


def pull(call: int) -> bytes:
    """Return the frame that sends a call (a request to a board) which asks, and that requests the first part of
    its reply."""
    return frame(PULL_FIRST, bytes((call,)))


def pull_next(call: int) -> bytes:
    return frame(PULL_NEXT, bytes((call,)))


def answers(reply: bytes) -> Iterator[bytes]:
    """Split a reply into its frames, one for each request of the host. The simulated board uses this."""
    chunks = [reply[start : start + CHUNK_V1] for start in range(0, len(reply), CHUNK_V1)] or [b""]
    for index, chunk in enumerate(chunks):
        yield frame(PULL_LAST if index == len(chunks) - 1 else PULL_MORE, chunk)
