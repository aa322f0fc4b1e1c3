"""Simulate TCP between the processes of a tree and one controller, in memory.

Streams keep their order. A direction that is cut delays its data until it is mended. A reset ends a
stream. When a process is killed, the data that it has written and that the cable has not carried
yet is lost. The controller still reads the data that its system has received, before or after the
end of the stream.
"""

from __future__ import annotations

import heapq
import os
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, Protocol

import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.ports.tcp_stall import STALLED_S

from .exhaustion import open_file
from .hostile_peer import HostilePeer
from .kinds import PEER
from .plan import Event
from .robot_model import Effect, nothing, put
from .world import Process, World

OURS = "192.0.2.1"
CONNECT_S = 0.5
"""The timeout of ``open_tcp``."""
LATE_S = 0.06
AGAIN_S = 0.2
"""Longest time from mending a direction until its delayed data is sent again [assumed]."""


class Piece(NamedTuple):
    """The data of one ``write``.

    Attributes:
        left_s: When it was written.
    """

    left_s: float
    role: str  # of the process
    data: bytes


class Hearer(Protocol):
    """The controller's side of one connection."""

    def hear(self, piece: Piece) -> None: ...

    def ended(self) -> None: ...


class TcpNetwork:
    """The network of one controller. Its public attributes are its faults."""

    def __init__(self, world: World, accept: Callable[[SimStream], Hearer]) -> None:
        self.world = world
        self.streams: list[SimStream] = []  # open at the controller
        self.stalled = False  # the controller neither reads nor sends
        self.late_s = 0.0
        self.mute = False
        self.peer = HostilePeer(world.rng("peer"))
        self._accept = accept
        self._cut: dict[str, bool] = {"out": False, "in": False}
        self._rng = world.rng("network")
        self._descriptors: dict[SimStream, int] = {}
        self._shared: dict[int, SimStream] = {}  # by inode

    async def open(self, host: str, port: int) -> SimStream:
        """Connect, as ``open_tcp`` does."""
        process, name = self.world.current, f"{host}:{port}"
        open_file(process, name)
        await trio.sleep(self._way_s())
        if self.unreachable:
            await trio.sleep(CONNECT_S)
            raise WireDown(f"{name}: cannot connect (no answer within {CONNECT_S:g} s)")
        return self.connect(name, port)

    @property
    def unreachable(self) -> bool:
        return self._cut["out"] or self._cut["in"]

    def connect(self, name: str, port: int) -> SimStream:
        """Connect the present process at once."""
        stream = SimStream(self, self.world.current, name, port)
        self.streams.append(stream)
        stream.hearer = self._accept(stream)
        if stream.left == 0:
            stream.end_by_robot()
        return stream

    def descriptor_of(self, stream: SimStream) -> int:
        """Return a real descriptor (of an empty file in memory) that stands for a connection."""
        if stream not in self._descriptors:
            fd = self._descriptors[stream] = os.memfd_create("stream")
            self._shared[os.fstat(fd).st_ino] = stream
            self.world.descriptors.append(fd)
        return self._descriptors[stream]

    def stream_of(self, fileno: int) -> SimStream:
        """Return the connection for which this descriptor, or a duplicate of it, stands."""
        return self._shared[os.fstat(fileno).st_ino]

    def is_cut(self, way: str) -> bool:
        return self._cut[way]

    def cut(self, *ways: str) -> None:
        """Cut directions: ``out`` is to the controller, ``in`` is from it."""
        for way in ways:
            self._cut[way] = True

    def mend(self, *ways: str) -> None:
        for way in ways:
            if self._cut[way]:
                self._cut[way] = False
                for stream in list(self.streams):
                    stream.flush(way, AGAIN_S * self._rng.random())

    def go_on(self) -> None:
        """End a stall. The controller reads the waiting data of each connection, in a drawn order."""
        if self.stalled:
            self.stalled = False
            waiting = list(self.streams)
            self._rng.shuffle(waiting)
            for stream in waiting:
                stream.take_up()

    def reset(self) -> None:
        """The controller ends every connection."""
        for stream in list(self.streams):
            stream.end_by_robot()

    def effect(self, event: Event) -> Effect | None:
        """Return the effect of a fault of the network or its peer; None if it has no such fault."""
        match event.kind:
            case "pull":
                return lambda: self.cut("out", "in"), lambda: self.mend("out", "in")
            case "hold requests":
                return lambda: self.cut("out"), lambda: self.mend("out")
            case "hold replies":
                return lambda: self.cut("in"), lambda: self.mend("in")
            case "stall":
                return lambda: setattr(self, "stalled", True), self.go_on
            case "late":
                return put(self, "late_s", LATE_S, 0.0)
            case "mute":
                return put(self, "mute", True, False)
            case "reset":
                return self.reset, nothing
        return put(self.peer, "kind", event.kind, "") if event.kind in PEER else None

    def mend_all(self) -> None:
        """Undo every fault."""
        self.mend("out", "in")
        self.go_on()
        self.late_s, self.mute, self.peer.kind = 0.0, False, ""

    def forget(self, stream: SimStream) -> None:
        if stream in self.streams:
            self.streams.remove(stream)
            stream.hearer.ended()

    def _way_s(self) -> float:
        return 50e-6 + 150e-6 * self._rng.random()

    def due_s(self, last_s: float, more_s: float = 0.0) -> float:
        """Return when data that is sent now arrives. It never overtakes earlier data."""
        late_s = self.late_s * self._rng.random() if self.late_s else 0.0
        return max(last_s, self.world.now_s + self._way_s() + late_s + more_s)


class SimStream:
    """A connection. It replaces a ``TcpPort``, and the controller uses it as its side."""

    def __init__(self, network: TcpNetwork, process: Process, name: str, port: int) -> None:
        self.network = network
        self.process = process
        self.name = name
        self.port = port
        self.left = network.peer.heard_before_reset()
        """Pieces that the controller reads before it resets the connection; None if it never does."""
        self.hearer: Hearer
        self._answers = network.peer.stream()
        self._closed = False
        self._gone = False  # the controller has ended it, and its end has arrived
        self._unsent: deque[Piece | None] = deque()  # None: the end
        self._untaken: deque[Piece | None] = deque()  # held while the controller stalls
        self._unheard: deque[bytes | None] = deque()  # held while ``in`` is cut
        self._coming: list[tuple[float, int, bytes]] = []
        self._number = 0
        self._arrives_s = self._comes_s = 0.0
        self._dropped_s = float("inf")  # when it was closed with a reset
        self._news = trio.Event()
        self._reader: Process | None = None  # the process that waits for data
        self._resent = 0  # pieces that the system sends again, and that have not arrived yet
        self._let_go = False  # this descriptor is closed
        self._duplicates = 0
        process.at_end.append(self._die)

    # -- the side of the process

    @property
    def own_host(self) -> str:
        return OURS

    @property
    def peer_host(self) -> str:
        return self.name.rpartition(":")[0]

    def write(self, data: bytes, late_s: float = 0.0) -> None:
        """Write data.

        Args:
            late_s: Time for which the system of either side delays the data.
        """
        self._check_descriptor()
        self.write_by(self.process, data, late_s)

    def write_by(self, process: Process, data: bytes, late_s: float = 0.0) -> None:
        if process.dead:
            return
        self._check()
        self._put(Piece(self.network.world.now_s, process.role, data), late_s)

    async def read(self) -> bytes:
        self._check_descriptor()
        return await self.read_by(self.process)

    async def read_by(self, process: Process) -> bytes:
        while True:
            await trio.lowlevel.checkpoint()
            data = self.read_waiting()
            if data is not None:
                return data
            self._news = trio.Event()
            self._reader = process
            try:
                if self._coming:
                    self.network.world.at(self._coming[0][0], self._wake)
                await self._news.wait()
            finally:
                self._reader = None

    def read_waiting(self) -> bytes | None:
        data, coming, now_s = b"", self._coming, self.network.world.now_s
        while coming and coming[0][0] <= now_s:
            data += heapq.heappop(coming)[2]
        if data:
            return data
        self._check()
        return None

    def close(self) -> None:
        """Close with a reset. Data that was not sent yet is discarded."""
        if not self.process.dead:
            self._release(self._drop)

    def close_in_order(self) -> None:
        if not self.process.dead:
            self._release(self._end)

    def _die(self) -> None:
        self._release(self._drop)

    def _release(self, end: Callable[[], None]) -> None:
        """Close this descriptor. With the last one the connection ends."""
        if not self._let_go:
            self._let_go = True
            self.process.resources.close_file()
            self._end_without_descriptors(end)

    def _end_without_descriptors(self, end: Callable[[], None]) -> None:
        if self._let_go and not self._duplicates and not self._closed:
            end()

    def _drop(self) -> None:
        self._dropped_s = self.network.world.now_s
        self._unsent.clear()
        self._end()

    def _end(self) -> None:
        self._closed = True
        if self._reader is not None and self._reader is self.network.world.running:
            self._news.set()
        else:
            self._wake()
        if self._gone:
            self.network.forget(self)
        elif not self.network.is_cut("out") or self._unsent:
            self._put(None)
        # Otherwise the cable is cut and the end is lost. The controller keeps a half-open connection.

    def _check_descriptor(self) -> None:
        if self._let_go and not self.process.dead:
            raise WireDown(f"{self.name}: the connection is closed. Reconnect")

    def _check(self) -> None:
        if self._closed or self._gone:
            why = "the connection is closed. Reconnect" if self._closed else "the connection is gone. Check cable"
            raise WireDown(f"{self.name}: {why}")

    def _wake(self) -> None:
        if self._reader is not None and not self._reader.dead:
            self._reader.post(self._news.set)

    # -- descriptors that other processes share

    def fileno(self) -> int:
        """Return a descriptor that can be passed to another process, which adopts it."""
        return self.network.descriptor_of(self)

    def duplicate(self) -> None:
        self._duplicates += 1

    def close_duplicate(self) -> None:
        self._duplicates -= 1
        self._end_without_descriptors(self._drop)

    def reset_if_stalled(self) -> bool:
        """Reset the connection if the controller's system does not acknowledge its data."""
        oldest = next((piece for piece in self._unsent if piece is not None), None)
        late = oldest is not None and self.network.world.now_s - oldest.left_s >= STALLED_S
        if self._closed or not (late or self._resent):
            return False
        self.reset()
        return True

    def reset(self) -> None:
        """Reset the connection for every process that has it open."""
        if not self._closed:
            self._drop()

    # -- the cable

    def _put(self, piece: Piece | None, more_s: float = 0.0, again_s: float = 0.0) -> None:
        """Send data to the controller.

        Args:
            more_s: Time for which the system of either side delays it.
            again_s: When the system sends it again, after the cable was mended.
        """
        if self.network.is_cut("out"):
            self._unsent.append(piece)
            return
        self._arrives_s = self.network.due_s(self._arrives_s, more_s)
        self._resent += again_s > 0.0

        def arrive() -> None:
            self._resent -= again_s > 0.0
            if piece is None or again_s <= self._dropped_s:
                self._arrive(piece)

        self.network.world.at(self._arrives_s, arrive)

    def flush(self, way: str, pause_s: float) -> None:
        """Send the delayed data of a direction that was mended."""
        if way == "out":
            unsent, self._unsent = self._unsent, deque()
            again_s = self.network.world.now_s + pause_s
            for piece in unsent:
                self._put(piece, pause_s, again_s)
        else:
            unheard, self._unheard = self._unheard, deque()
            for data in unheard:
                self._say(data, pause_s)

    def _arrive(self, piece: Piece | None) -> None:
        if self.network.stalled:
            self._untaken.append(piece)
        else:
            self._take(piece)

    def take_up(self) -> None:
        untaken, self._untaken = self._untaken, deque()
        for piece in untaken:
            self._take(piece)

    def _take(self, piece: Piece | None) -> None:
        if self not in self.network.streams:
            self.end_by_robot()  # The controller has no such connection.
        elif piece is None:
            self.network.forget(self)
        else:
            self.hearer.hear(piece)
            if self.left is not None:
                self.left -= 1
                if self.left <= 0:
                    self.end_by_robot()

    # -- the side of the controller

    def send(self, data: bytes) -> None:
        if not self.network.mute:
            for answer in self._answers.spoil(data):
                self._say(answer)

    def end_by_robot(self) -> None:
        self._untaken.clear()
        self.network.forget(self)
        self._say(None)

    def _say(self, data: bytes | None, more_s: float = 0.0) -> None:
        if self._closed:
            return
        network = self.network
        if network.is_cut("in"):
            if data is not None:  # A reset is sent once only.
                self._unheard.append(data)
            return
        self._comes_s = network.due_s(self._comes_s, more_s)
        if data is None:
            network.world.at(self._comes_s, self._lose)
            return
        self._number += 1
        heapq.heappush(self._coming, (self._comes_s, self._number, data))
        if self._reader is not None:
            network.world.at(self._comes_s, self._wake)

    def _lose(self) -> None:
        self._gone = True
        self._wake()
