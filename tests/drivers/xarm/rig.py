"""The twin's controller behind connections in memory, for the wire in virtual time."""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Faults
from strands_actors.drivers.xarm import reports as r
from strands_actors.drivers.xarm.driver import XArm
from strands_actors.drivers.xarm.stop_channel import XArmStopChannel
from strands_actors.drivers.xarm.twin import ControlSession, controller_of
from strands_actors.drivers.xarm.twin.publisher import Publisher
from strands_actors.drivers.xarm.wire import XArmWire
from strands_actors.kernel.clock import NS, Clock
from tests.drivers.common.memory_port import Permission, virtual

PORT = "192.0.2.1:502"


class TrioClock(Clock):
    def now_ns(self) -> int:
        return round(trio.current_time() * NS)


class Written(NamedTuple):
    t_s: float
    kind: str
    body: bytes


class World:
    """One arm. ``options`` are those of its twin."""

    def __init__(self, **options: object) -> None:
        self.controller = controller_of("xarm7", now_s=trio.current_time, **options)  # type: ignore[arg-type]
        self.faults = Faults()
        self.reports = Publisher(self.controller, self.faults)
        self.written: list[Written] = []
        self.connections: list[ControlStream] = []
        self.deaf = False  # it answers no request
        self.mute = False  # it sends no report
        self.no_rich = False
        self.gone = False
        self.full = False  # it accepts no further connection
        self.clients = 8  # of its control port, at once
        self.replies = 0  # number of replies that were read
        self.on_reply: Callable[[int], None] = lambda count: None
        self.driver = XArm("xarm7", PORT, {})

    def wire(self) -> XArmWire:
        return XArmWire(self.driver.config, TrioClock(), self.open_stream)

    def stop_channel(self) -> XArmStopChannel:
        return XArmStopChannel(self.driver.config, (), TrioClock(), self.open_stream)

    async def open_stream(self, host: str, port: int) -> ControlStream | ReportStream:
        await trio.lowlevel.checkpoint()
        assert host == "192.0.2.1"
        if self.gone or self.full or (self.no_rich and port == r.RICH_PORT):
            raise WireDown(f"{host}:{port}: cannot connect")
        if port == 502:
            if sum(not connection.closed for connection in self.connections) >= self.clients:
                raise WireDown(f"{host}:{port}: cannot connect")
            self.connections.append(ControlStream(self))
            return self.connections[-1]
        return ReportStream(self, port)

    def kinds(self, *without: str) -> list[str]:
        return [entry.kind for entry in self.written if entry.kind not in without]

    def bodies(self, kind: str) -> list[bytes]:
        return [entry.body for entry in self.written if entry.kind == kind]


class ControlStream:
    def __init__(self, world: World) -> None:
        self._world = world
        self._session = ControlSession(world.controller, world.faults)
        self._coming: deque[tuple[float, bytes]] = deque()
        self._news = trio.Event()
        self.closed = ""

    def write(self, data: bytes) -> None:
        self._check()
        world = self._world
        world.controller.tick()
        for exchange in self._session.receive(data, None):
            world.written.append(Written(trio.current_time(), exchange.kind, exchange.request[6:]))
            for reply in () if world.deaf else exchange.replies:
                self._coming.append((trio.current_time() + 0.001 + reply.late_s, reply.data))
                self._news.set()

    async def read(self) -> bytes:
        while True:
            self._check()
            if self._coming:
                await trio.sleep_until(self._coming[0][0])
                return self._heard(self._coming.popleft()[1])
            self._news = trio.Event()
            await self._news.wait()

    def read_waiting(self) -> bytes | None:
        self._check()
        if self._coming and self._coming[0][0] <= trio.current_time():
            return self._heard(self._coming.popleft()[1])
        return None

    def say(self, data: bytes) -> None:
        """Send bytes that were not requested."""
        self._coming.append((trio.current_time(), data))
        self._news.set()

    def _heard(self, data: bytes) -> bytes:
        self._world.replies += 1
        self._world.on_reply(self._world.replies)
        return data

    def close(self) -> None:
        self.closed = self.closed or "reset"

    def close_in_order(self) -> None:
        self.closed = "in order"

    def _check(self) -> None:
        if self.closed or self._world.gone:
            raise WireDown("the connection is gone")


class ReportStream:
    def __init__(self, world: World, port: int) -> None:
        self._world = world
        self._port = port
        self._due_s = trio.current_time() + 0.001

    async def read(self) -> bytes:
        while True:
            await trio.sleep_until(max(self._due_s, trio.current_time()))
            if (data := self.read_waiting()) is not None:
                return data
            await trio.sleep(0.001)

    def read_waiting(self) -> bytes | None:
        world = self._world
        if world.gone:
            raise WireDown("the connection is gone")
        if world.mute or trio.current_time() < self._due_s:
            return None
        self._due_s = trio.current_time() + (0.01 if self._port == r.REAL_PORT else 0.2)
        world.controller.tick()
        return world.reports._packed(self._port)

    def close(self) -> None:
        pass

    def close_in_order(self) -> None:
        pass


def in_virtual_time(test: Callable[..., Awaitable[None]]) -> Callable[..., None]:
    @functools.wraps(test)
    def run(*args: Any, **kwargs: Any) -> None:
        virtual(functools.partial(test, *args, **kwargs))

    return run


async def armed(world: World) -> XArmWire:
    wire = world.wire()
    await wire.open()
    await wire.arm(Permission())
    return wire


async def cycle(wire: XArmWire, cycles: int = 1) -> None:
    for _ in range(cycles):
        await trio.sleep(0.01)
        await wire.read()


def stepped(world: World, rad: float) -> tuple[float, ...]:
    at = world.controller.plant.position_rad
    return (at[0] + rad, *at[1:])


class Stoppable:
    """A permit that can be withdrawn at any time."""

    def __init__(self) -> None:
        self.gone = False

    def check(self) -> None:
        if self.gone:
            raise PermitDenied
