"""A serial adapter in memory: open files, duplicates of their descriptors, an exclusive lock, a cable
to pull.

Descriptors are real (each of an empty file in memory), so that the code that duplicates, sends and
closes them runs unchanged.
"""

from __future__ import annotations

import heapq
import itertools
import os
from collections.abc import Callable, Iterable

import trio

from strands_actors.contract.wire import WireDown

from .exhaustion import open_file
from .world import Process, World

Peer = Callable[[bytes, "str"], Iterable[tuple[float, bytes]]]
"""Called with the bytes that a process writes and with its role. Returns replies: seconds until each
arrives, and its bytes."""


class OpenFile:
    """An open file, which duplicates of its descriptor share."""

    def __init__(self) -> None:
        self.coming: list[tuple[float, int, bytes]] = []
        self.handles: list[SimPort] = []
        self.gone = False  # the cable was pulled
        self.locked = True


class SerialLine:
    """One adapter at one path."""

    def __init__(self, world: World, path: str, peer: Peer) -> None:
        self.world = world
        self.path = path
        self.plugged = True
        self._peer = peer
        self._order = itertools.count()
        self._files: dict[int, OpenFile] = {}  # by inode
        self._open: OpenFile | None = None

    # -- calls of the tree

    def open(self, path: str, baud: int) -> SimPort:
        """As ``open_serial``."""
        open_file(self.world.current, path)
        if not self.plugged:
            raise WireDown(
                f"{path}: cannot open at {baud} baud (no such file). Check port=, and which program uses it"
            )
        if self._open is not None and self._open.handles and self._open.locked:
            raise WireDown(f"{path}: in use. End that first, or give another port=")
        fd = os.memfd_create("serial")
        file = self._open = self._files[os.fstat(fd).st_ino] = OpenFile()
        return SimPort(self, file, fd, self.world.current, owner=True)

    def adopt(self, fd: int) -> SimPort:
        """As ``adopt_serial``."""
        return SimPort(self, self._files[os.fstat(fd).st_ino], fd, self.world.current, owner=False)

    def write(self, port: SimPort, data: bytes) -> None:
        now_s = self.world.now_s
        for delay_s, reply in self._peer(data, port.process.role):
            heapq.heappush(port.file.coming, (now_s + delay_s, next(self._order), reply))
        for handle in port.file.handles:
            if handle is not port:
                handle.process.post(handle.rouse)

    # -- the cable

    def pull(self) -> None:
        self.plugged = False
        if self._open is not None:
            self._open.gone = True
            for handle in self._open.handles:
                handle.process.post(handle.rouse)
            self._open = None

    def put_back(self) -> None:
        self.plugged = True


class SimPort:
    """A ``BytePort``. It ends with its process, as descriptors do."""

    def __init__(self, line: SerialLine, file: OpenFile, fd: int, process: Process, owner: bool) -> None:
        self.line = line
        self.file = file
        self.process = process
        self.name = line.path
        self._fd = fd
        self._owner = owner
        self._news = trio.Event()
        file.handles.append(self)
        process.at_end.append(self._drop)

    def write(self, data: bytes) -> None:
        if self.process.dead:
            return
        self._check()
        self.line.write(self, data)

    async def read(self) -> bytes:
        while True:
            await trio.lowlevel.checkpoint()
            self._check()
            if data := self._due():
                return data
            self._news = trio.Event()
            if coming := self.file.coming:
                self.line.world.at(coming[0][0], lambda: self.process.post(self.rouse))
            await self._news.wait()

    def take(self) -> bytes:
        self._check()
        return self._due()

    def discard_input(self) -> None:
        self.take()

    def discard_output(self) -> None:
        self._check()

    async def hung_up(self) -> None:
        while not self.file.gone:
            self._news = trio.Event()
            await self._news.wait()

    def rouse(self) -> None:
        self._news.set()

    def fileno(self) -> int:
        return self._fd

    def close(self) -> None:
        if self._fd >= 0 and not self.process.dead:
            if self._owner:
                self.file.locked = False
            self._drop()

    def _drop(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self.file.handles.remove(self)

    def _due(self) -> bytes:
        data, coming, now_s = b"", self.file.coming, self.line.world.now_s
        while coming and coming[0][0] <= now_s:
            data += heapq.heappop(coming)[2]
        return data

    def _check(self) -> None:
        if self._fd < 0 or self.file.gone:
            why = "the port is closed. Reconnect" if self._fd < 0 else "the port is gone. Check cable and power"
            raise WireDown(f"{self.name}: {why}")
