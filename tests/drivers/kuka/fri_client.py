"""An independent FRI client, written from the field numbers. It shares no code with driver or twin.

It answers every cycle. It mirrors the position when asked to, and otherwise moves towards a goal by a limited
step per cycle.
"""

from __future__ import annotations

import socket
import struct
import time
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Any

from strands_actors.kernel.health.realtime import WIRE_PRIORITY, run_first, run_like_others

MONITORING, COMMAND = 0x245142, 0x34001


def varint(number: int) -> bytes:
    out = b""
    while number > 127:
        out += bytes([number % 128 + 128])
        number //= 128
    return out + bytes([number])


def parse(data: bytes) -> dict[int, list[Any]]:
    """Return the values of each field number: ints, 64-bit floats, or bytes."""
    fields: dict[int, list[Any]] = {}
    at = 0

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            value += (data[at] % 128) << shift
            shift += 7
            at += 1
            if data[at - 1] < 128:
                return value

    while at < len(data):
        key = number()
        value: Any
        if key % 8 == 0:
            value = number()
        elif key % 8 == 1:
            (value,) = struct.unpack_from("<d", data, at)
            at += 8
        elif key % 8 == 2:
            size = number()
            value = data[at : at + size]
            at += size
        else:
            raise AssertionError(f"wire type {key % 8}")
        fields.setdefault(key // 8, []).append(value)
    return fields


def joints(field: bytes) -> list[float]:
    """Return the repeated doubles in field 1, packed or not."""
    values = parse(field).get(1, [])
    if values and isinstance(values[0], bytes):
        return list(struct.unpack(f"<{len(values[0]) // 8}d", values[0]))
    return values


def io_of(field: bytes) -> tuple[str, float]:
    """Return name and value of one input or output."""
    fields = parse(field)
    return fields[1][0].decode(), (fields[5] if 5 in fields else fields[4])[0]


def answer(
    sequence: int, reflected: int, position: Sequence[float] = (), levels: Mapping[str, float] | None = None
) -> bytes:
    def part(number: int, body: bytes) -> bytes:
        return varint(number * 8 + 2) + varint(len(body)) + body

    header = b"\x08" + varint(COMMAND) + b"\x10" + varint(sequence) + b"\x18" + varint(reflected)
    message = part(1, header)
    content = part(1, b"".join(b"\x09" + struct.pack("<d", rad) for rad in position)) if position else b""
    for name, level in (levels or {}).items():  # analog outputs
        content += part(5, part(1, name.encode()) + b"\x10\x02\x18\x01\x29" + struct.pack("<d", level))
    return message + (part(2, content) if content else b"")


class Client:
    """Answer every sender at ``port``, which both ends use.

    Within the block the thread gets real-time priority if the system permits it. At 2 ms, 22 ms without a
    processor end a session.
    """

    def __init__(self, port: int) -> None:
        self.sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.sock.bind(("127.0.0.1", port))
        self.sock.settimeout(10.0)
        self.states: list[int] = []
        self.sample_ms = 0
        self.measured: list[float] = []
        self.commanded: list[float] = []
        self.ios: dict[str, float] = {}
        self.outputs: dict[str, float] = {}
        self._sequence = 0

    def cycle(self, goal: Sequence[float] = (), step_rad: float = 0.0) -> int:
        """Answer one message, and return the session's state."""
        data, peer = self.sock.recvfrom(4096)
        said = parse(data)
        header, connection = parse(said[1][0]), parse(said[4][0])
        assert header[1] == [MONITORING]
        (state,) = connection[1]
        (self.sample_ms,) = connection[3]
        self.measured = joints(parse(said[3][0])[1][0])
        self.ios = dict(map(io_of, parse(said[3][0]).get(8, [])))
        if state == 3:
            self.commanded = joints(parse(said[5][0])[1][0])
        elif state == 4:
            wanted = goal or self.commanded
            self.commanded = [
                now + max(-step_rad, min(step_rad, to - now))
                for now, to in zip(self.commanded, wanted, strict=True)
            ]
        position = self.commanded if state >= 3 else ()
        self.sock.sendto(answer(self._sequence, header[2][0], position, self.outputs), peer)
        self._sequence += 1
        if not self.states or self.states[-1] != state:
            self.states.append(state)
        return int(state)

    def until(self, state: int, within_s: float = 20.0) -> None:
        deadline_s = time.monotonic() + within_s
        while self.cycle() != state:
            assert time.monotonic() < deadline_s, f"not in state {state}: {self.states}"

    def __enter__(self) -> Client:
        run_first(WIRE_PRIORITY)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        run_like_others()
        self.sock.close()
