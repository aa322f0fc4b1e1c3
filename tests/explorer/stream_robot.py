"""Model a robot by a twin that serves connections: TCP, TLS or unix sockets, and any protocol over them.

The handlers of the twin's own server run in a simulated process, ``robot``. A stall freezes that process.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import deque
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import trio

from strands_actors.drivers.common.ports import tcp_port
from strands_actors.drivers.common.twin import alarm, grpc, server, websocket
from strands_actors.drivers.common.twin.server import Frost
from strands_actors.drivers.common.twin.tcp import ClientGone, Connection, Handler

from .plan import Event
from .robot_model import Effect, Seam
from .tcp_network import OURS, Piece, SimStream, TcpNetwork
from .twin_robot import TwinRobot
from .world import Process, World

TICK_S = 0.01
TIMED = (alarm, grpc, server, websocket)
"""Modules of all twins that use ``time``."""


class RobotEnd(Connection):
    """The robot's end of a connection, as a handler of the twin's server gets it, and the log of that handler."""

    def __init__(self, robot: StreamRobot, stream: SimStream) -> None:
        self._robot = robot
        self._stream = stream
        self._pieces: deque[Piece] = deque()
        self._piece: Piece | None = None  # the one that is being handled
        self._closed = False
        self._news = trio.Event()
        self.log = self  # type: ignore[assignment]
        self.frost = Frost()
        self.late_s = 0.0

    # -- the network's view

    def hear(self, piece: Piece) -> None:
        self._pieces.append(piece)
        self._wake()

    def ended(self) -> None:
        self._closed = True
        self._wake()

    def _wake(self) -> None:
        self._robot.process.post(lambda: self._news.set())

    # -- the handler's view

    @property
    def peer_host(self) -> str:
        return OURS

    @property
    def takes(self) -> bool:
        return True

    async def receive(self) -> tuple[int, bytes]:
        await trio.lowlevel.checkpoint()
        while not self._pieces:
            if self._closed:
                raise ClientGone
            self._news = trio.Event()
            await self._news.wait()
        self._piece = self._pieces.popleft()
        return round(self._robot.now_s() * 1e9), self._piece.data

    def send(self, data: bytes) -> None:
        if not self._closed and data:
            self._stream.send(self._robot.spoil(data))

    offer = send

    def abort(self) -> None:
        if not self._closed:
            self._stream.end_by_robot()

    hang_up = abort

    # -- the log's view

    def write(self, t_ns: int, sender: str, frames: Any, safe_state: str | None = None) -> None:
        if sender != "host":
            return
        assert self._piece is not None
        for kind, _ in frames:
            self._robot.note_frame(kind, safe_state, self._piece.role, self._piece.left_s)


class StreamRobot(TwinRobot):
    """A robot behind connections.

    Attributes:
        OPENERS: Functions that open something else than ``open_tcp`` does, with their module. They get an address,
            or a path, as their first arguments.
        process: The simulated process of the twin.
    """

    OPENERS: ClassVar[tuple[tuple[ModuleType, str], ...]] = ()

    def __init__(self, world: World, robot: str) -> None:
        super().__init__(world, robot)
        self.network = TcpNetwork(world, self._accept)
        self._handler = self.handler()
        self.process = world.start("robot", self._main, None)

    @abstractmethod
    def handler(self) -> Handler:
        """Return the function of the twin's server that serves one connection."""

    def seams(self) -> tuple[Seam, ...]:
        return (
            *super().seams(),
            *tcp_seams(self.network),
            *((module, name, self._open) for module, name in self.OPENERS),
            *((module, "time", self.time) for module in TIMED),
            (server, "new_alarm", alarm.TrioAlarm),
        )

    def effect(self, event: Event) -> Effect | None:
        if event.kind == "stall":
            return self._stall, self._go_on
        return self.network.effect(event) or super().effect(event)

    def mend(self) -> None:
        super().mend()
        self._go_on()
        self.network.mend_all()
        assert not self.process.dead, "the twin has failed"

    def brown_out(self) -> None:
        super().brown_out()
        self.network.reset()

    def _stall(self) -> None:
        self.network.stalled = True
        self.process.freeze()

    def _go_on(self) -> None:
        self.process.go_on()
        self.network.go_on()

    async def _open(self, where: str, port: int = 0, *others: Any, **named: Any) -> SimStream:
        return await self.network.open(where, port)

    def _accept(self, stream: SimStream) -> RobotEnd:
        end = RobotEnd(self, stream)
        self.process.post(lambda: self._nursery.start_soon(self._serve, end))
        return end

    # -- the process of the twin

    async def _main(self, process: Process) -> None:
        async with trio.open_nursery() as self._nursery:
            while True:
                await trio.sleep(TICK_S)
                self.pass_time()
                self.look()

    async def _serve(self, end: RobotEnd) -> None:
        try:
            await self._handler(end)
        except* ClientGone:
            pass
        finally:
            end.abort()


def tcp_seams(network: TcpNetwork) -> tuple[Seam, ...]:
    """Return the replacements that let ``open_tcp`` connect to this network. All else of it is the product's."""

    async def look_up(host: str, port: int) -> list[Any]:
        return [(0, 0, 0, "", (host, port))]

    async def connect(sock: object, address: tuple[str, int]) -> SimStream:
        return await network.open(*address)

    return (
        (tcp_port, "look_up", look_up),
        (tcp_port, "socket", SimpleNamespace(socket=lambda *_: None)),
        (tcp_port, "_connect", connect),
        (tcp_port, "TcpPort", lambda stream, name: stream),
    )
