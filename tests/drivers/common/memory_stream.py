"""A connection in memory between a wire and a twin's own server: two pipes, the host's end, the robot's end.

For tests in virtual time. A twin that answers each write at once needs only ``MemoryPort``.
"""

from __future__ import annotations

from collections import deque
from typing import Any

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.twin import ClientGone, Connection
from strands_actors.drivers.common.twin.server import Frost


class Pipe:
    """One direction of a connection: pieces in order, then the end."""

    def __init__(self) -> None:
        self._pieces: deque[bytes] = deque()
        self._news = trio.Event()
        self.closed = False

    def put(self, data: bytes) -> None:
        self._pieces.append(data)
        self._news.set()

    def close(self) -> None:
        """End it. The reader still gets the remaining pieces."""
        self.closed = True
        self._news.set()

    def waiting(self) -> bytes | None:
        return self._pieces.popleft() if self._pieces else None

    async def get(self) -> bytes:
        """Return the next piece, or empty bytes at the end."""
        await trio.lowlevel.checkpoint()
        while not self._pieces and not self.closed:
            self._news = trio.Event()
            await self._news.wait()
        return self._pieces.popleft() if self._pieces else b""


class MemoryStream:
    """The host's end, as an ``OrderlyStream``."""

    name = "the robot in memory"

    def __init__(self, to_robot: Pipe, to_host: Pipe) -> None:
        self._to_robot, self._to_host = to_robot, to_host

    def write(self, data: bytes) -> None:
        self._check()
        self._to_robot.put(data)

    async def read(self) -> bytes:
        data = await self._to_host.get()
        if not data:
            self._check(gone=True)
        return data

    def read_waiting(self) -> bytes | None:
        data = self._to_host.waiting()
        if data is None:
            self._check()
        return data

    def close(self) -> None:
        self._to_robot.close()
        self._to_host.close()

    close_in_order = close

    def _check(self, gone: bool = False) -> None:
        if gone or self._to_robot.closed:
            raise WireDown("memory stream: the connection is gone")


class MemoryConnection(Connection):
    """The robot's end, as the handler of a server gets it."""

    def __init__(self, to_robot: Pipe, to_host: Pipe, log: Any) -> None:
        self._to_robot, self._to_host = to_robot, to_host
        self.log = log
        self.frost = Frost()
        self.late_s = 0.0

    @property
    def peer_host(self) -> str:
        return "192.0.2.9"

    @property
    def takes(self) -> bool:
        return True

    async def receive(self) -> tuple[int, bytes]:
        data = await self._to_robot.get()
        if not data:
            raise ClientGone
        return round(trio.current_time() * 1e9), data

    def send(self, data: bytes) -> None:
        if not self._to_robot.closed:
            self._to_host.put(data)

    offer = send

    def abort(self) -> None:
        self._to_robot.close()
        self._to_host.close()

    def hang_up(self) -> None:
        self._to_host.close()
