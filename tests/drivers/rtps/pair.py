"""Two participants without sockets, in virtual time, with a network between them that a test may disturb."""

from __future__ import annotations

import heapq
import itertools
import struct
import zlib
from collections.abc import Callable, Iterable, Sequence

from strands_actors.drivers.common.rtps import wire_types
from strands_actors.drivers.common.rtps.discovery import ParticipantData
from strands_actors.drivers.common.rtps.engine import Engine
from strands_actors.drivers.common.rtps.wire_types import Address, Buffer

MS = 1_000_000
TICK_NS = 50 * MS
TRAVEL_NS = 100_000
A, B, C = "10.0.0.1", "10.0.0.2", "10.0.0.3"

Fate = Callable[[bytes], Iterable[tuple[int, bytes]]]
"""The fate of a datagram: delay in ns and bytes of everything that arrives."""


def undisturbed(datagram: bytes) -> Iterable[tuple[int, bytes]]:
    return ((TRAVEL_NS, datagram),)


class Network:
    """Carries datagrams between engines. A receiver gets a buffer that is reused afterwards."""

    def __init__(self) -> None:
        self.now_ns = 0
        self.fate: Fate = undisturbed
        self.engines: dict[str, Engine] = {}
        self.sent: list[tuple[bytes, Address]] = []
        self.keep_sent = False
        self._ticks: dict[str, int] = {}
        self._order = itertools.count()
        self._travelling: list[tuple[int, int, str, Address, bytes]] = []

    def participant(self, host: str, others: Sequence[str], lease_s: float = 10.0) -> Engine:
        def send(parts: Sequence[Buffer], address: Address) -> bool:
            datagram = b"".join(parts)
            if self.keep_sent:
                self.sent.append((datagram, address))
            for delay, arrived in self.fate(datagram):
                self.arrive(host, address, arrived, delay)
            return True

        prefix = wire_types.VENDOR + zlib.crc32(host.encode()).to_bytes(10, "big")
        data = ParticipantData(prefix, ((host, 7410),), ((host, 7411),), lease_s)
        engine = self.engines[host] = Engine(data, [(other, 7410) for other in others], send)
        return engine

    def arrive(self, sender: str, address: Address, datagram: bytes, delay: int = TRAVEL_NS) -> None:
        item = (self.now_ns + delay, next(self._order), sender, address, datagram)
        heapq.heappush(self._travelling, item)

    def run(self, seconds: float) -> None:
        end = self.now_ns + round(seconds * 1e9)
        while True:
            tick = (self.now_ns // TICK_NS + 1) * TICK_NS
            due = min(tick, end)
            while self._travelling and self._travelling[0][0] <= due:
                self.now_ns, _, sender, address, datagram = heapq.heappop(self._travelling)
                if engine := self.engines.get(address[0]):
                    buffer = bytearray(datagram)
                    engine.receive(memoryview(buffer), (sender, 7410), self.now_ns)
                    buffer[:] = b"\xa5" * len(buffer)
            self.now_ns = due
            if due == end:
                return
            for engine in self.engines.values():
                engine.tick(self.now_ns)

    def drop_all(self) -> None:
        self._travelling.clear()


class Log:
    """The samples that a reader received: copies, in order."""

    def __init__(self) -> None:
        self.payloads: list[bytes] = []
        self.writers: list[bytes] = []

    def __call__(self, payload: memoryview, writer: bytes, t_ns: int) -> None:
        self.payloads.append(bytes(payload))
        self.writers.append(writer)


HEAD = b"\x00\x01\x00\x00"
"""The encapsulation header of a payload."""


def payloads(*numbers: int) -> list[bytes]:
    return [HEAD + number.to_bytes(4, "little") for number in numbers]


class Pair:
    """Participants A and B. A writes ``rt/t`` to B."""

    def __init__(
        self, reliable: bool = True, transient_local: bool = False, depth: int = 8, lease_s: float = 10.0
    ) -> None:
        self.network = Network()
        self.a = self.network.participant(A, [B], lease_s)
        self.b = self.network.participant(B, [])
        self.log = Log()
        self.writer = self.a.writer("rt/t", "T_", reliable, transient_local, depth)
        self.qos = (reliable, transient_local)

    def read(self) -> None:
        self.reader = self.b.reader("rt/t", "T_", *self.qos, self.log)
        self.network.run(0.5)
        assert self.writer.matched == self.reader.matched == 1

    def write(self, *numbers: int, then_s: float = 0.0) -> None:
        for payload in payloads(*numbers):
            self.writer.write(payload)
        self.network.run(then_s)


_NAME = struct.Struct("<16sII")


def sample(topic: str, number: int, size: int = 64) -> bytes:
    """Return a payload that identifies itself: encapsulation, topic, number, filling, checksum."""
    body = _NAME.pack(topic.encode(), number, size) + bytes(number + at & 0xFF for at in range(min(size, 64)))
    body += bytes(max(0, size - 64))
    return HEAD + body + zlib.crc32(body).to_bytes(4, "little")


def number_of(payload: bytes, topic: str) -> int | None:
    """Return the number of an intact sample; None if the checksum does not match.

    Raises:
        AssertionError: It is an intact sample of another topic.
    """
    if len(payload) < 4 + _NAME.size + 4:
        return None
    name, number, size = _NAME.unpack_from(payload, 4)
    body, checksum, padding = (
        payload[4 : 4 + _NAME.size + size],
        payload[4 + _NAME.size + size : 8 + _NAME.size + size],
        payload[8 + _NAME.size + size :],
    )
    if payload[:4] != HEAD or padding.strip(b"\x00") or len(padding) > 3:
        return None
    if zlib.crc32(body).to_bytes(4, "little") != checksum:
        return None
    assert name.rstrip(b"\x00").decode() == topic
    return int(number)
