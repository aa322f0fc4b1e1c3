"""An independent, blocking Kortex client without any of the product's codec.

It is written from the field tables of the vendor's public protobuf definitions. The vendor's own client is on
no package index.
"""

from __future__ import annotations

import socket
import struct
from collections.abc import Iterable
from types import TracebackType

MAGIC = b"\x07xEtRoK\x07"

Fields = dict[int, list[int | bytes]]


class KortexError(Exception):
    def __init__(self, code: int, sub: int) -> None:
        super().__init__(f"error {code}, sub error {sub}")
        self.code, self.sub = code, sub


def varint(value: int) -> bytes:
    out = b""
    while True:
        value, low = value >> 7, value & 127
        out += bytes([low | (128 if value else 0)])
        if not value:
            return out


def blob(number: int, data: bytes) -> bytes:
    return varint(number << 3 | 2) + varint(len(data)) + data


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def real(field: int, value: float) -> bytes:
    return varint(field << 3 | 5) + struct.pack("<f", value)


def read(data: bytes) -> Fields:
    found: Fields = {}
    at = 0

    def take_varint() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at, value, shift = at + 1, value | (byte & 127) << shift, shift + 7
            if byte < 128:
                return value

    while at < len(data):
        key = take_varint()
        if key & 7 == 0:
            value: int | bytes = take_varint()
        elif key & 7 == 5:
            value, at = struct.unpack_from("<I", data, at)[0], at + 4
        else:
            assert key & 7 == 2, f"wire type {key & 7}"
            size = take_varint()
            value, at = data[at : at + size], at + size
        found.setdefault(key >> 3, []).append(value)
    return found


def real_of(found: Fields, field: int) -> float:
    bits = found[field][0]
    assert isinstance(bits, int)
    return float(struct.unpack("<f", struct.pack("<I", bits))[0])


def joint_speeds(deg_s: Iterable[float]) -> bytes:
    """Return ``JointSpeeds``."""
    joints = (number(1, joint) + real(2, speed) for joint, speed in enumerate(deg_s))
    return b"".join(blob(1, joint) for joint in joints)


def inside(fields: Fields, *path: int) -> Fields:
    """Return the fields of a message in a message."""
    for field in path:
        value = fields[field][0]
        assert isinstance(value, bytes)
        fields = read(value)
    return fields


def whole(fields: Fields, field: int, default: int = 0) -> int:
    value = fields.get(field, [default])[0]
    assert isinstance(value, int)
    return value


def messages(fields: Fields, field: int) -> list[Fields]:
    return [read(value) for value in fields.get(field, ()) if isinstance(value, bytes)]


class Client:
    """One connection.

    ``session`` is the number that the base gave it. ``notifications`` has the function and the fields of each
    notification that arrived before a response.
    """

    def __init__(self, address: str) -> None:
        host, _, port = address.partition(":")
        self.socket = socket.create_connection((host, int(port)), 10.0)
        self.session = 0
        self.notifications: list[tuple[int, Fields]] = []
        self._number = 0

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.socket.close()

    def log_in(self, username: str = "admin", password: str = "admin", session_ms: int = 60_000) -> Client:
        payload = blob(1, username.encode()) + number(2, session_ms) + blob(3, password.encode()) + number(4, 2000)
        self.call(0x10001, payload)
        return self

    def call(self, function: int, payload: bytes = b"") -> Fields:
        """Return the fields of the answer.

        Raises:
            KortexError: The base refused the call.
        """
        self._number += 1
        self.socket.sendall(self.frame(function, payload))
        while True:
            info, message, service, size, body = self._frame()
            if info >> 24 & 15 != 5:
                break
            self.notifications.append((service & 0xFFF_FFFF, read(body)))
        assert info >> 28 == 1 and info >> 24 & 15 == 3, "version 1, a response"
        assert (message & 0xFFFF, service, size) == (self._number, 1 << 28 | function, len(body))
        if info & 0xFFFF:
            raise KortexError(info >> 12 & 15, info & 0xFFF)
        self.session = message >> 16
        return read(body)

    def _frame(self) -> tuple[int, int, int, int, bytes]:
        head = self._exactly(12)
        assert head[:8] == MAGIC
        frame = read(self._exactly(struct.unpack(">I", head[8:])[0]))
        (body,) = frame[2]
        assert isinstance(body, bytes)
        info, message, service, size = (whole(inside(frame, 1), at) for at in (1, 2, 3, 4))
        return info, message, service, size, body

    def frame(self, function: int, payload: bytes) -> bytes:
        words = (1 << 28 | 1 << 24, self.session << 16 | self._number, 1 << 28 | function, len(payload))
        header = b"".join(bytes([at << 3 | 5]) + struct.pack("<I", word) for at, word in enumerate(words, 1))
        body = blob(1, header) + blob(2, payload)
        return MAGIC + struct.pack(">I", len(body)) + body

    def send_joint_speeds(self, *deg_s: float) -> None:
        """Send the speeds of the first joints. The others get no speed."""
        self.call(0x20084, joint_speeds((*deg_s, *[0.0] * (7 - len(deg_s)))))

    def refresh_feedback(self) -> tuple[int, list[tuple[float, float]]]:
        """Return the arm's state, and position and velocity of each actuator, in degrees."""
        found = self.call(0x30003)
        (base,) = found[2]
        assert isinstance(base, bytes)
        state = read(base)[2][0]
        assert isinstance(state, int)
        actuators = [read(one) for one in found[3] if isinstance(one, bytes)]
        return state, [(real_of(one, 4), real_of(one, 5)) for one in actuators]

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            more = self.socket.recv(count - len(data))
            if not more:
                raise ConnectionError("the base closed the connection")
            data += more
        return data
