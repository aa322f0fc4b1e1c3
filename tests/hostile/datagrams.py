"""A socket for datagrams in memory, with a hostile peer.

It makes the same changes as a ``HostileStream``, one datagram at a time. In a flood, one task step finds
datagrams without end. Each further step first waits ``READ_S``, the cost of reading.

A datagram has no connection. So a reset means that the robot begins a new session.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

import trio

from .peer import HostilePeer, HostileStream

ROOM = 256
"""Number of datagrams that a socket keeps for a process that does not read."""


class Datagrams:
    """The two ends of a socket: a queue towards the host, and ``receive``, which takes the host's datagrams."""

    def __init__(self, receive: Callable[[bytes], None]) -> None:
        self._receive = receive
        self._waiting: deque[bytes] = deque()
        self._arrived = trio.Event()

    def put(self, data: bytes) -> None:
        if len(self._waiting) < ROOM:
            self._waiting.append(data)
            self._arrived.set()

    def write(self, data: bytes) -> None:
        self._receive(data)

    async def read(self) -> bytes:
        await trio.lowlevel.checkpoint()
        while not self._waiting:
            self._arrived = trio.Event()
            await self._arrived.wait()
        return self._waiting.popleft()

    def read_waiting(self) -> bytes | None:
        return self._waiting.popleft() if self._waiting else None

    def close(self) -> None:
        """Do nothing, because others may use the same socket."""


class HostileSocket(HostileStream):
    def __init__(self, peer: HostilePeer, inner: Datagrams, restart: Callable[[], None]) -> None:
        super().__init__(peer, inner)
        self._restart = restart
        self._parked: deque[bytes] = deque()
        self._flooded_in = -1  # the task step that may go on reading a flood

    def receive(self) -> bytes | None:
        """Return a waiting datagram, or None. Never wait."""
        if self._parked:
            return self._parked.popleft()
        if self._floods() and self.peer.step != self._flooded_in:
            return None
        return self.read_waiting()

    async def readable(self) -> None:
        """Wait for a datagram. The next task step finds it."""
        if not self._parked:
            self._parked.append(await self.read())
        self._flooded_in = self.peer.step

    def _flood(self) -> bytes:
        self._flooded += 1
        if self._flooded % 8 == 0 and (data := self._waiting()):
            return data
        return self.peer.word

    def _told(self, data: bytes) -> bytes:
        left = self.peer.reset_after - self._heard
        if len(data) <= left:
            return super()._told(data)
        self.gone = True
        self._check()
        return data[: max(0, int(left))]

    def _check(self) -> None:
        if self.gone:
            self.gone = False
            self._heard = 0
            self._older.clear()
            self._coming.clear()
            self._halved = False
            self._restart()
            self.peer.join(self)
