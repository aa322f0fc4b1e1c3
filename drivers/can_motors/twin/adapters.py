"""The robot's side of the adapters at a serial port. It finds out which adapter its client expects.

The text of ``slcan`` begins with a letter, Damiao's frames with 55 AA, and those of RobStride with ``AT``.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from strands_actors.drivers.can_motors.adapters import EXTENDED, RobStrideSerial, Slcan, SocketCan
from strands_actors.drivers.can_motors.protocol import Frame

_TO: Final = struct.Struct("<2sBBIIBIBBBB8sB")
_FROM: Final = struct.Struct("<BBBI8sB")
_COMMANDS: Final = b"CSOVNLYMmWZ"
"""The first letters of slcan's other lines that an adapter answers with CR."""
LONGEST: Final = 256


class AnyAdapter:
    """An adapter that speaks the language of its client.

    Args:
        socketcan: True for the client's end of a network interface, where each read is one frame.
    """

    def __init__(self, socketcan: bool = False) -> None:
        self._client: Slcan | RobStrideSerial | SocketCan | None = SocketCan() if socketcan else None
        self._fixed = socketcan
        self._rest = b""

    def frames(self, data: bytes) -> Iterator[tuple[bytes, Frame | None, bytes]]:
        """Take received bytes. Yield the bytes of each message, its frame (None for another message), and the
        adapter's own answer."""
        if self._fixed:
            for received in SocketCan().feed(data):
                yield SocketCan().encode(received), received, b""
            return
        data = self._rest + data
        while data:
            end, frame, answer = self._next(data)
            if not end:
                break
            yield data[:end], frame, answer
            data = data[end:]
        self._rest = data[-LONGEST:]

    def _next(self, data: bytes) -> tuple[int, Frame | None, bytes]:
        """Return the length of the first message (0 if it is incomplete), its frame and the answer."""
        if data[:1] == b"\x55":
            if len(data) < _TO.size:
                return 0, None, b""
            magic, _, _, _, _, extended, number, _, size, _, _, content, _ = _TO.unpack_from(data)
            if magic != b"\x55\xaa":
                return 1, None, b""
            self._client = None
            return _TO.size, Frame(number, content[: min(size, 8)], bool(extended)), b""
        if data[:2] == b"AT":
            return self._robstride(data)
        if data[0] < 0x07 or data[0] > 0x7E:
            return 1, None, b""
        end = data.find(b"\r") + 1
        if not end:
            return (len(data), None, b"") if len(data) > LONGEST else (0, None, b"")
        self._client = Slcan()
        line = data[:end]
        if frame := next(iter(Slcan().feed(line)), None):
            return end, frame, b""
        return end, None, b"\r" if line[:1] in (b"\r", *(bytes((each,)) for each in _COMMANDS)) else b"\a"

    def _robstride(self, data: bytes) -> tuple[int, Frame | None, bytes]:
        self._client = RobStrideSerial()
        if data[:5] == b"AT+AT":
            return (7, None, b"OK\r\n") if len(data) >= 7 else (0, None, b"")
        end = 9 + data[6] if len(data) > 6 else 0
        if not end or len(data) < end:
            return 0, None, b""
        return end, next(iter(RobStrideSerial().feed(data[:end])), None), b""

    def encode(self, frame: Frame) -> bytes:
        """Return the bytes by which the client receives a frame."""
        if self._client is not None:
            return self._client.encode(frame)
        form = len(frame.data) | (0x40 if frame.extended else 0)
        number = frame.id & ~EXTENDED
        return _FROM.pack(0xAA, 0x11, form, number, frame.data.ljust(8, b"\0"), 0x55)
