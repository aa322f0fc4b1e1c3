"""Encode and decode CPX, the packets in which CRTP (the drone's own protocol) travels over TCP and serial
lines. A packet is two bytes of route and function, then the data. Pure: no I/O.

On TCP a frame is its length (16 bits) and the packet. On a serial line it is 0xFF, the length, the packet, and
the XOR of all these. A frame of length zero means "ready for the next frame". Both sides wait for it before
they send a frame.
"""

from __future__ import annotations

import enum
import functools
import operator

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

LONGEST = 100
"""Largest packet on a serial line, in bytes."""
START = 0xFF
READY = bytes((START, 0))


class Target(enum.IntEnum):
    STM32 = 1
    HOST = 3


class Function(enum.IntEnum):
    SYSTEM = 1
    CRTP = 3


BRIDGE = b"\x21\x01"
"""Request to the system: use CRTP over CPX from now on."""
CLIENT = b"\x20\x01"
"""Notice to the system: a client is there."""


def packet(function: Function, data: bytes, to_robot: bool = True) -> bytes:
    """Encode a CPX packet from the host to the robot, or with ``to_robot=False`` from the robot to the host."""
    source, destination = (Target.HOST, Target.STM32) if to_robot else (Target.STM32, Target.HOST)
    return bytes((source << 3 | destination, function)) + data


def parse(data: bytes) -> tuple[int, bytes]:
    """Return function and data of a packet. Raise ``MalformedFrame``."""
    if len(data) < 2:
        raise MalformedFrame(f"a CPX packet of {len(data)} bytes")
    if data[1] >> 6:
        raise MalformedFrame(f"CPX version {data[1] >> 6}, not 0")
    return data[1] & 0x3F, data[2:]


def tcp_frame(data: bytes) -> bytes:
    return len(data).to_bytes(2, "little") + data


def uart_frame(data: bytes) -> bytes:
    """Put a CPX packet into a frame for the serial line. Raise ``ValueError`` if the packet is too long."""
    if len(data) > LONGEST:
        raise ValueError(f"a CPX packet has at most {LONGEST} bytes, not {len(data)}")
    head = bytes((START, len(data))) + data
    return head + bytes((_xor(head),))


class TcpDecoder:
    """Decode the bytes of a TCP connection into CPX packets."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[bytes]:
        """Return the complete packets. Raise ``MalformedFrame`` for an impossible length, because then no later
        byte can be decoded."""
        self._buffer += data
        packets = []
        while len(self._buffer) >= 2:
            size = int.from_bytes(self._buffer[:2], "little")
            if size > LONGEST:
                raise MalformedFrame(f"a CPX packet has at most {LONGEST} bytes, not {size}")
            if len(self._buffer) < 2 + size:
                break
            packets.append(bytes(self._buffer[2 : 2 + size]))
            del self._buffer[: 2 + size]
        return packets


class UartDecoder:
    """Decode the bytes of a serial line into packets. An empty packet (``b""``) stands for "ready for the next
    frame". Invalid bytes are skipped and counted."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.damaged = 0

    def feed(self, data: bytes) -> list[bytes]:
        self._buffer += data
        packets: list[bytes] = []
        while self._buffer:
            start = self._buffer.find(START)
            if start:
                self.damaged += 1
                del self._buffer[: start if start > 0 else len(self._buffer)]
                continue
            if len(self._buffer) < 2:
                break
            size = self._buffer[1]
            if size > LONGEST:
                self.damaged += 1
                del self._buffer[0]
            elif size == 0:
                packets.append(b"")
                del self._buffer[:2]
            elif len(self._buffer) < size + 3:
                break
            elif _xor(self._buffer[: size + 2]) != self._buffer[size + 2]:
                self.damaged += 1
                del self._buffer[0]
            else:
                packets.append(bytes(self._buffer[2 : size + 2]))
                del self._buffer[: size + 3]
        return packets


def _xor(data: bytes | bytearray) -> int:
    return functools.reduce(operator.xor, data, 0)
