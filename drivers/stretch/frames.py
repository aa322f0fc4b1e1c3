"""Frames of Stretch's boards: COBS, CRC-16, and how a call is split into them. Pure: no I/O, no
clock.

A frame is ``COBS(code data.. crc crc) 00``: CRC-16/Modbus (polynomial 0xA001, initial 0xFFFF), high
byte first. A call is a number and its arguments; its reply has the number after it. There is no
sequence number: a late reply looks like the answer to the next call of the same kind.

Transport V1, which these robots speak: a call that commands is *pushed*, 58 bytes a frame, each
acknowledged, the last with the reply. A call that asks is *pulled*: the reply comes 58 bytes a
frame, each asked for. Transport V0 is older and is used for one call, which every firmware answers:
who are you.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from strands_actors.drivers.common.malformed import MalformedFrame

END = b"\x00"
RESYNC = END
"""In front of the first safe frame: what was cut in two before it ends there."""

MAX_FRAME = 64
"""Bytes: more than a board's receive buffer is no frame."""
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
"""What a reply may be instead."""


class Frame(NamedTuple):
    """One checked frame, as a ``half_duplex.Packet``: a reply is known by its code. How long it is
    depends on the firmware, and is its reader's business."""

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
    """Return the bytes of one frame. Raise ``ValueError`` for data that one does not hold."""
    if len(data) > CHUNK_V1:
        raise ValueError(f"{len(data)} bytes do not fit one frame of {CHUNK_V1}")
    body = bytes((code,)) + data
    return stuff(body + crc16(body).to_bytes(2, "big")) + END


def stuff(data: bytes) -> bytes:
    """COBS of up to 253 bytes: no zero is left in them."""
    stuffed = bytearray()
    for run in data.split(END):
        stuffed.append(len(run) + 1)
        stuffed += run
    return bytes(stuffed)


def unstuff(data: bytes) -> bytes:
    """Raise ``MalformedFrame`` for what is no COBS."""
    plain = bytearray()
    at = 0
    while at < len(data):
        size = data[at]
        if size == 0 or at + size > len(data):
            raise MalformedFrame("the bytes are no COBS")
        plain += data[at + 1 : at + size]
        at += size
        if at < len(data):
            plain.append(0)
    return bytes(plain)


def parse(data: bytes) -> Frame:
    """Return the frame in the bytes between two ends. Raise ``MalformedFrame``."""
    body = unstuff(data)
    if len(body) < 3:
        raise MalformedFrame(f"{len(body)} bytes are too few for a frame")
    if crc16(body[:-2]).to_bytes(2, "big") != body[-2:]:
        raise MalformedFrame("the checksum is wrong")
    return Frame(body[0], body[1:-2])


class Decoder:
    """Bytes in any pieces, checked frames out. Garbage is skipped and counted, a torn frame waits
    for its rest."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._too_long = False
        self.garbage_bytes = 0

    @property
    def pending(self) -> int:
        """Bytes of a frame that has not ended yet."""
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
            found = None if lost or len(whole) >= MAX_FRAME else _frame_in(whole)
            if found is None:
                self.garbage_bytes += len(whole)
            else:
                yield found
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
    """Return the frames of a call that commands. Raise ``ValueError`` for one that is too long."""
    if not 0 < len(call) <= MAX_CALL:
        raise ValueError(f"a call of {len(call)} bytes. It has 1 to {MAX_CALL}")
    chunks = [call[at : at + CHUNK_V1] for at in range(0, len(call), CHUNK_V1)]
    if len(chunks) == 1:
        return (frame(PUSH_ONLY, call),)
    codes = (PUSH_FIRST, *[PUSH_MORE] * (len(chunks) - 2), PUSH_LAST)
    return tuple(frame(code, chunk) for code, chunk in zip(codes, chunks, strict=True))


def push(call: bytes) -> bytes:
    """Return the one frame of a short call. Raise ``ValueError`` for a longer one."""
    return frame(PUSH_ONLY, call)


def pull(call: int) -> bytes:
    """Return the frame that asks, and begins a reply."""
    return frame(PULL_FIRST, bytes((call,)))


def pull_next(call: int) -> bytes:
    return frame(PULL_NEXT, bytes((call,)))


def answers(reply: bytes) -> Iterator[bytes]:
    """Return the frames of a reply, each to be asked for: the board's side of ``pull``."""
    chunks = [reply[at : at + CHUNK_V1] for at in range(0, len(reply), CHUNK_V1)] or [b""]
    for at, chunk in enumerate(chunks):
        yield frame(PULL_LAST if at == len(chunks) - 1 else PULL_MORE, chunk)
