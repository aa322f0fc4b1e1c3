"""A robot with hostile output, in virtual time.

A ``HostileStream`` stands between a wire and the twin's end of a connection in memory. The host's bytes reach
the twin. The twin's bytes are changed from ``HostilePeer.begin`` on, on every connection, also on those that
are opened later.

Time is simulated, and so is the cost of reading: an ``await read()`` takes ``READ_S``. A read that does not
wait costs nothing, so a loop of such reads is caught by counting. One task step that takes more than
``STEP_BYTES`` or ``STEP_READS`` raises ``Endless``, which nothing in the product catches.
"""

from __future__ import annotations

import math
import os
import random
from collections import deque
from collections.abc import Callable
from typing import Any

import trio
import trio.abc

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.twin import ClientGone

READ_S = 0.005
"""Time of one read in a flood: 0.2 MB/s, on a slow computer."""
CHUNK = 1024
STEP_BYTES = 512 * 1024
STEP_READS = 320
"""Limit of one task step. A turn takes 64 reads or 64 kB at most, on each of two or three connections."""
TAKEN_S = 0.001
"""Time in which a thawed robot reads the waiting messages of one connection."""
TRUE_EVERY = 8
"""In a flood, each read of this number returns the robot's own bytes."""

Change = Callable[[bytes], bytes]
Flood = bytes | Callable[[int], bytes]
"""A message to repeat, or a function that returns the message of each number."""


class Endless(BaseException):
    """One task step reads without end."""


class Steps(trio.abc.Instrument):
    """Count the steps of all tasks."""

    def __init__(self) -> None:
        self.count = 0

    def before_task_step(self, task: trio.lowlevel.Task) -> None:
        self.count += 1


class HostilePeer:
    """The changes to the output of one robot. All of its connections share them."""

    def __init__(self, steps: Steps, seed: int = 1) -> None:
        self.rng = random.Random(seed)
        self.kind = ""
        self.flood: Flood = b""  # repeated without end
        self.chunk = CHUNK  # bytes of the flood in one read; 0: one datagram
        self.word: Flood = b""  # the flood's content in one datagram
        self.change: Change = bytes
        self.deaf = False  # True: the host's bytes are garbled, too
        self.reset_after = math.inf  # bytes from the robot before a new connection is reset
        self.writes = 0  # number of writes since ``begin``
        self.frozen = False  # True: the host's bytes wait, on each connection
        self._steps = steps
        self._step = -1
        self._bytes = self._reads = 0
        self._streams: list[HostileStream] = []

    def join(self, stream: HostileStream) -> None:
        self._streams.append(stream)

    def begin(self, kind: str, flood: Flood = b"", change: Change = bytes, deaf: bool = False) -> None:
        self.kind, self.deaf, self.change, self.writes = kind, deaf, change, 0
        self.word = flood
        self.flood = flood * max(1, self.chunk // len(flood)) if isinstance(flood, bytes) and flood else flood
        self._wake()

    def end(self) -> None:
        """Make the robot honest again, and reset its old connections, which are useless now."""
        self.kind, self.flood, self.word, self.change, self.deaf = "", b"", b"", bytes, False
        self.reset_after = math.inf
        self.reset()

    def reset(self) -> None:
        """Reset every open connection."""
        for stream in self._streams:
            stream.gone = True
        self._wake()
        self._streams.clear()

    @property
    def waiting(self) -> int:
        """Return the number of writes that a frozen robot has not read yet."""
        return sum(len(stream.held) for stream in self._streams)

    def freeze(self) -> None:
        """Read nothing and send nothing until ``thaw``."""
        self.frozen = True
        for stream in self._streams:
            stream.is_known = True

    async def thaw(self, newest_first: bool) -> None:
        """Read the waiting bytes, one connection after the other.

        Connections that the robot had accepted come first, in the given order. Those that it still has to
        accept follow.
        """
        known = [stream for stream in self._streams if stream.is_known]
        for stream in [*(reversed(known) if newest_first else known), *self._streams]:
            if stream.thaw():
                await trio.sleep(TAKEN_S)
        self.frozen = False
        for stream in self._streams:  # those that were written to in the meantime
            stream.thaw()

    def garble(self, data: bytes) -> bytes:
        return self.rng.randbytes(len(data))

    @property
    def step(self) -> int:
        """Return the number of the running task step."""
        return self._steps.count

    def count(self, size: int) -> None:
        """Count a read that did not wait.

        Raises:
            Endless: The task step has read too much.
        """
        if self._step != self._steps.count:
            self._step, self._bytes, self._reads = self._steps.count, 0, 0
        self._bytes += size
        self._reads += 1
        if self._bytes > STEP_BYTES or self._reads > STEP_READS:
            raise Endless(f"{self._reads} reads, {self._bytes} bytes in one task step")

    def _wake(self) -> None:
        for stream in self._streams:
            stream.wake()


class HostileStream:
    """A changed stream between a wire and a stream in memory: bytes of a connection, or packets of a link."""

    def __init__(self, peer: HostilePeer, inner: Any) -> None:
        self.peer = peer
        self.inner = inner
        self.gone = False
        self._scope: trio.CancelScope | None = None
        self._coming: deque[tuple[float, bytes]] = deque()
        self._older: list[bytes] = []
        self._heard = self._flooded = 0
        self._halved = False
        self._fd = -1
        self.is_known = False  # the frozen robot had accepted it
        self.held: list[bytes] = []  # bytes that a frozen robot has not read yet
        self._is_closed = False
        peer.join(self)

    # -- as the host uses it

    def write(self, data: bytes) -> None:
        self._check()
        self.peer.writes += 1
        if self.peer.frozen:
            self.held.append(data)
        else:
            self._write(data)

    def thaw(self) -> bool:
        """Deliver the waiting bytes. Return True if there were any."""
        held, self.held = self.held, []
        try:
            for data in held:
                self._write(data)
        except WireDown:
            self.gone = True
        if held and self._is_closed:
            self.inner.close()
        return bool(held)

    def _write(self, data: bytes) -> None:
        try:
            self.inner.write(self.peer.garble(data) if self.peer.deaf else data)
        except ClientGone:  # the robot closes a connection that it cannot decode
            self.gone = True

    async def read(self) -> bytes:
        while True:
            self._check()
            if self._floods():
                await trio.sleep(READ_S)
                if self._floods():
                    return self._flood()
            if self._coming:
                with trio.CancelScope() as self._scope:
                    await trio.sleep_until(self._coming[0][0])
                if self._coming and self._coming[0][0] <= trio.current_time():
                    return self._coming.popleft()[1]
                continue
            data = b""
            with trio.CancelScope() as self._scope:
                data = await self.inner.read()
            self._scope = None
            if data and (chunk := self._told(data)):
                return chunk

    def read_waiting(self) -> bytes | None:
        self._check()
        if self._floods():
            data = self._flood()
            self.peer.count(len(data))
            return data
        if self._coming and self._coming[0][0] <= trio.current_time():
            return self._coming.popleft()[1]
        chunk = self._waiting()
        return (self._told(chunk) or None) if chunk else None

    def take(self) -> bytes:
        return self.read_waiting() or b""

    def discard_input(self) -> None:
        self._coming.clear()
        self.inner.discard_input()

    def wake(self) -> None:
        if self._scope is not None:
            self._scope.cancel()

    def fileno(self) -> int:
        """Return a descriptor that can be passed on. No process reads or writes it."""
        if self._fd < 0:
            self._fd = os.open(os.devnull, os.O_RDWR)
        return self._fd

    def close_in_order(self) -> None:
        if not self.held:
            self.inner.close_in_order()
        self._end()

    def close(self) -> None:
        if not self.held:  # otherwise a frozen robot finds the bytes first
            self.inner.close()
        self._end()

    def _end(self) -> None:
        self._is_closed = True
        self.wake()
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    # -- changes of the robot's output

    def size_of(self, data: bytes) -> int:
        """Return the size that counts towards a reset."""
        return len(data)

    def _waiting(self) -> bytes | None:
        if hasattr(self.inner, "read_waiting"):
            data: bytes | None = self.inner.read_waiting()
            return data
        return self.inner.take() or None

    def _floods(self) -> bool:
        return bool(self.peer.flood)

    def _flood(self) -> bytes:
        """Return the next piece. Every ``TRUE_EVERY``-th one is the robot's own."""
        self._flooded += 1
        if self._flooded % TRUE_EVERY == 0 and (data := self._waiting()):
            return data
        flood = self.peer.flood
        return flood if isinstance(flood, bytes) else flood(self._flooded)

    def _told(self, data: bytes) -> bytes:
        """Return the bytes that the host receives in place of ``data``."""
        self._heard += self.size_of(data)
        if self._heard > self.peer.reset_after:
            self.gone = True
            self._check()
        if self.gone:
            return b""
        match self.peer.kind:
            case "":
                self._older = [*self._older[-99:], data]
                return data
            case "garbled" | "garbled both ways":
                return self.peer.garble(data)
            case "half a frame":
                if self._halved:
                    return b""
                self._halved = True
                return data[: max(1, len(data) // 2)]
            case "one byte a second":
                last_s = self._coming[-1][0] if self._coming else trio.current_time()
                if len(self._coming) < 100:
                    self._coming.extend((last_s + 1.0 + at, data[at : at + 1]) for at in range(min(len(data), 20)))
                return b""
            case "older answers":
                return self.peer.rng.choice(self._older) if self._older else b""
            case _:
                return self.peer.change(data)

    def _check(self) -> None:
        if self.gone:
            self.inner.close()
            raise WireDown("the connection is gone (reset by the robot). Check cable and power, then reconnect")
