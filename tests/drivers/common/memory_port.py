"""For wires in virtual time: a port in memory with its peer, and a permit to write."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Awaitable, Callable, Iterable

import trio
from trio.testing import MockClock

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Robot

Peer = Callable[[bytes], Iterable[tuple[float, bytes]]]
"""Takes bytes of the master. Returns pairs of delay in seconds and bytes."""


class MemoryPort:
    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self.written: list[tuple[float, bytes]] = []
        self.unplugged = False
        self.closed = False
        self._coming: list[tuple[float, int, bytes]] = []
        self._order = itertools.count()

    def write(self, data: bytes) -> None:
        self._check()
        now = trio.current_time()
        self.written.append((now, data))
        for delay_s, reply in self.peer(data):
            heapq.heappush(self._coming, (now + delay_s, next(self._order), reply))

    async def read(self) -> bytes:
        self._check()
        if not self._coming:
            await trio.sleep_forever()
        await trio.sleep_until(self._coming[0][0])
        return heapq.heappop(self._coming)[2]

    def take(self) -> bytes:
        self._check()
        data = b""
        while self._coming and self._coming[0][0] <= trio.current_time():
            data += heapq.heappop(self._coming)[2]
        return data

    def discard_input(self) -> None:
        self.take()

    def discard_output(self) -> None:
        self._check()

    async def hung_up(self) -> None:
        await trio.sleep_forever()

    def fileno(self) -> int:
        return 99

    def close(self) -> None:
        self.closed = True

    def _check(self) -> None:
        if self.unplugged or self.closed:
            raise WireDown("memory port: the port is gone")


def servos(bus: Robot, bits_per_s: int = 1_000_000) -> Peer:
    """Return a peer with the twin's servos and the duration of their replies on a UART."""
    byte_s = 10 / bits_per_s

    def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
        for exchange in bus.receive(data, bits_per_s):
            at = len(exchange.request) * byte_s
            for reply in exchange.replies:
                took = reply.delay_s + len(reply.data) * byte_s
                if not reply.late_s:
                    at += took
                    took = 0.0
                yield at + took + reply.late_s, reply.data

    return peer


class Permission:
    """A permit that denies from check number ``denied_at`` on. It notes the amount written at each check."""

    def __init__(self, port: MemoryPort | None = None, denied_at: int | None = None) -> None:
        self.checks = 0
        self.written_before: list[int] = []
        self._port = port
        self._denied_at = denied_at

    def check(self) -> None:
        if self._port is not None:
            self.written_before.append(len(self._port.written))
        if self.checks == self._denied_at:
            raise PermitDenied
        self.checks += 1


def virtual(test: Callable[[], Awaitable[None]]) -> None:
    trio.run(test, clock=MockClock(autojump_threshold=0))
