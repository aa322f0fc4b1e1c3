"""Encode CAN frames as the bytes of an adapter, and decode them. Pure.

``socketcan``  the kernel's ``struct can_frame``, one in each read of the socket
``slcan``      text lines (CANable, CANtact): ``t`` or ``T``, the id, the length and the data in hex
``damiao``     Damiao's USB adapter: 30 bytes to it, 16 bytes from it
``robstride``  RobStride's USB adapter: ``AT``, the id shifted by 3 bits, the length, the data, CR and LF [assumed]
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import Final, Protocol

from .protocol import Frame

EXTENDED: Final = 0x8000_0000
"""Flag of the kernel in the id of an extended frame. The next two bits mark frames without data, and errors."""
_KERNEL: Final = struct.Struct("=IB3x8s")
LONGEST: Final = 64
"""More bytes than the longest frame of any adapter has. A longer frame without an end is dropped."""


class Adapter(Protocol):
    """The format of one adapter. It keeps the received bytes of an incomplete frame."""

    OPEN: bytes
    """The bytes that open the adapter's channel at 1 Mbit/s."""
    END: bytes
    """The bytes that end an incomplete frame in the adapter."""

    def encode(self, frame: Frame) -> bytes: ...
    def feed(self, data: bytes) -> Iterable[Frame]:
        """Take received bytes, and return the complete frames. Anything else is dropped."""
        ...


class SocketCan:
    OPEN = END = b""

    def encode(self, frame: Frame) -> bytes:
        return _KERNEL.pack(frame.id | (EXTENDED if frame.extended else 0), len(frame.data), frame.data)

    def feed(self, data: bytes) -> Iterable[Frame]:
        for start in range(0, len(data) - _KERNEL.size + 1, _KERNEL.size):
            number, size, content = _KERNEL.unpack_from(data, start)
            if size <= 8 and not number & 0x6000_0000:
                yield Frame(number & ~EXTENDED, content[:size], bool(number & EXTENDED))


class _Buffered:
    def __init__(self) -> None:
        self._rest = b""

    def keep(self, rest: bytes) -> None:
        """Keep the bytes of an incomplete frame for the next call of ``feed``."""
        self._rest = rest[-LONGEST:]


class Slcan(_Buffered):
    OPEN, END = b"\rC\rS8\rO\r", b"\r"

    def encode(self, frame: Frame) -> bytes:
        head = f"T{frame.id:08X}" if frame.extended else f"t{frame.id:03X}"
        return f"{head}{len(frame.data)}{frame.data.hex().upper()}\r".encode()

    def feed(self, data: bytes) -> Iterable[Frame]:
        # An adapter answers with CR, and reports an error with BEL. Neither belongs to a frame.
        *lines, rest = (self._rest + data).replace(b"\a", b"\r").split(b"\r")
        self.keep(rest)
        for line in lines:
            extended = line[:1] == b"T"
            end = 9 if extended else 4
            if line[:1] in (b"t", b"T") and len(line) > end:
                try:
                    number, content = int(line[1:end], 16), bytes.fromhex(line[end + 1 :].decode("ascii"))
                except ValueError:
                    continue
                if len(content) == line[end] - ord("0") <= 8:
                    yield Frame(number, content, extended)


class DamiaoSerial(_Buffered):
    OPEN, END = b"", bytes(30)
    _TO: Final = struct.Struct("<2sBBIIBIBBBB8sB")
    _FROM: Final = struct.Struct("<BBBI8sB")
    RECEIVED: Final = 0x11

    def encode(self, frame: Frame) -> bytes:
        size, data = len(frame.data), frame.data
        return self._TO.pack(b"\x55\xaa", 30, 3, 1, 10, frame.extended, frame.id, 0, size, 0, 0, data, 0)

    def feed(self, data: bytes) -> Iterable[Frame]:
        data, size = self._rest + data, self._FROM.size
        while True:
            start = data.find(b"\xaa")
            if start < 0 or len(data) - start < size:
                self.keep(data[start:] if start >= 0 else b"")
                return
            _, code, form, number, content, end = self._FROM.unpack_from(data, start)
            if end != 0x55:
                data = data[start + 1 :]
                continue
            data = data[start + size :]
            if code == self.RECEIVED:
                yield Frame(number, content[: min(8, form & 0x3F) or 8], bool(form & 0x40))


class RobStrideSerial(_Buffered):
    OPEN, END = b"AT+AT\r\n", b"\r\n"

    def encode(self, frame: Frame) -> bytes:
        number = frame.id << 3 | 4 if frame.extended else frame.id << 21
        return b"AT" + number.to_bytes(4, "big") + bytes((len(frame.data),)) + frame.data + b"\r\n"

    def feed(self, data: bytes) -> Iterable[Frame]:
        data = self._rest + data
        while (start := data.find(b"AT")) >= 0 and len(data) >= start + 7:
            size = data[start + 6]
            end = start + 7 + size
            if size > 8 or (len(data) >= end + 2 and data[end : end + 2] != b"\r\n"):
                data = data[start + 2 :]
                continue
            if len(data) < end + 2:
                break
            number, extended = int.from_bytes(data[start + 2 : start + 6], "big"), bool(data[start + 5] & 4)
            yield Frame(number >> 3 if extended else number >> 21, data[start + 7 : end], extended)
            data = data[end + 2 :]
        self.keep(data[max(0, data.find(b"AT")) :])


ADAPTERS: Mapping[str, type[Adapter]] = {
    "socketcan": SocketCan,
    "slcan": Slcan,
    "damiao": DamiaoSerial,
    "robstride": RobStrideSerial,
}
