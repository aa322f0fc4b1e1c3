"""The twin's services behind connections in memory, for the wire in virtual time."""

from __future__ import annotations

import contextlib
import functools
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.twin import ClientGone
from strands_actors.drivers.common.twin.grpc import GrpcClient
from strands_actors.drivers.rby1.driver import RBY1
from strands_actors.drivers.rby1.robots import TABLES
from strands_actors.drivers.rby1.stop_channel import RBY1StopChannel
from strands_actors.drivers.rby1.twin.controller import Controller
from strands_actors.drivers.rby1.twin.parts import JointMove
from strands_actors.drivers.rby1.twin.requests import Request
from strands_actors.drivers.rby1.twin.service import RBY1Service
from strands_actors.drivers.rby1.wire import RBY1Wire
from strands_actors.kernel.clock import NS, Clock
from tests.drivers.common.memory_port import Permission, virtual

PORT = "192.0.2.1:50051"


class TrioClock(Clock):
    def now_ns(self) -> int:
        return round(trio.current_time() * NS)


class Written(NamedTuple):
    t_s: float
    kind: str
    data: bytes


class World:
    """One robot. ``options`` are those of the driver."""

    def __init__(self, **options: Any) -> None:
        self.controller = Controller(TABLES.table("rby1"), now_s=trio.current_time)
        self.service = RBY1Service(self.controller)
        self.written: list[Written] = []
        self.streams: list[Stream] = []
        self.frozen = False  # True: written bytes wait until it goes on
        self.gone = False
        self.driver = RBY1("rby1", PORT, options)

    def wire(self) -> RBY1Wire:
        return RBY1Wire(self.driver.config, TrioClock(), self.open_stream)

    def stop_channel(self) -> RBY1StopChannel:
        return RBY1StopChannel(self.driver.config, (), TrioClock(), self.open_stream)

    async def open_stream(self, host: str, port: int) -> Stream:
        await trio.lowlevel.checkpoint()
        if self.gone:
            raise WireDown(f"{host}:{port}: cannot connect")
        self.streams.append(Stream(self))
        return self.streams[-1]

    @contextlib.asynccontextmanager
    async def living(self) -> AsyncIterator[World]:
        """Advance the robot's time during the block."""
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self._live)
            yield self
            nursery.cancel_scope.cancel()

    async def _live(self) -> None:
        while True:
            if not self.frozen:
                self.service.tick()
                for stream in self.streams:
                    stream.flush()
            await trio.sleep(0.004)

    def go_on(self, streams: Iterable[Stream] | None = None) -> None:
        """Process the waiting bytes, one connection after the other, in this order."""
        self.frozen = False
        for stream in self.streams if streams is None else streams:
            stream.take_late()

    def kinds(self, *without: str) -> list[str]:
        return [entry.kind for entry in self.written if entry.kind not in without]

    def setpoints(self) -> list[bytes]:
        return [entry.data for entry in self.written if entry.kind == "setpoint"]


def moves(message: bytes) -> dict[str, JointMove]:
    """Decode a command that moves joints to positions, by part."""
    parts = Request.decode(message).parts
    return {name: part for name, part in parts.items() if isinstance(part, JointMove)}


class _Log:
    def __init__(self, world: World) -> None:
        self._world = world

    def write(
        self, t_ns: int, source: str, frames: Iterable[tuple[str, bytes]], safe_state: str | None = None
    ) -> None:
        if source == "host":
            self._world.written += [Written(trio.current_time(), kind, data) for kind, data in frames]


class Stream:
    """A connection in memory, and the service behind it."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.log = _Log(world)
        self.closed = ""
        self._late: list[bytes] = []
        self._coming: deque[bytes] = deque()
        self._news = trio.Event()
        self._client = GrpcClient(world.service, self, 1 << 20)  # type: ignore[arg-type]
        self.flush()

    # -- as the server sees it

    def send(self, data: bytes) -> None:
        self._coming.append(data)
        self._news.set()

    def abort(self) -> None:
        self.close()

    def flush(self) -> None:
        if not self.closed and not self._world.frozen:
            self._client.flush()

    def take_late(self) -> None:
        """Process the waiting bytes, even if the host is gone by now."""
        late, self._late = self._late, []
        for data in late:
            self._take(data)
        if self.closed:
            self._client.close()

    def _take(self, data: bytes) -> None:
        try:
            self._client.take(0, data)
        except ClientGone:
            self.close()
        self.flush()

    # -- as the host sees it

    def write(self, data: bytes) -> None:
        self._check()
        if self._world.frozen:
            self._late.append(data)
        else:
            self._take(data)

    async def read(self) -> bytes:
        while True:
            await trio.lowlevel.checkpoint()
            if (data := self.read_waiting()) is not None:
                return data
            self._news = trio.Event()
            await self._news.wait()

    def read_waiting(self) -> bytes | None:
        self._check()
        return self._coming.popleft() if self._coming else None

    def close(self) -> None:
        if not self.closed:
            self.closed = "reset"
            if not self._world.frozen:
                self._client.close()
        self._news.set()

    def close_in_order(self) -> None:
        self.closed = self.closed or "in order"

    def _check(self) -> None:
        if self.closed or self._world.gone:
            raise WireDown("the connection is gone")


Test = Callable[..., Awaitable[None]]


def in_a_world(test: Test) -> Callable[..., None]:
    """Run the test in virtual time, with a robot."""

    @functools.wraps(test)
    def run(**kwargs: Any) -> None:
        async def main() -> None:
            async with World().living() as world:
                await test(world, **kwargs)

        virtual(main)

    # pytest looks for fixtures in the signature, which must not have the world.
    del run.__wrapped__  # type: ignore[attr-defined]
    return run


def with_each(name: str, values: list[Any]) -> Callable[[Test], Callable[..., None]]:
    """Run the test as ``in_a_world`` does, once for each value."""

    def decorate(test: Test) -> Callable[..., None]:
        def run(value: Any) -> None:
            async def main() -> None:
                async with World().living() as world:
                    await test(world, value)

            virtual(main)

        run.__name__, run.__doc__ = test.__name__, test.__doc__  # type: ignore[attr-defined]
        return pytest.mark.parametrize("value", values)(run)

    return decorate


async def armed(world: World) -> RBY1Wire:
    wire = world.wire()
    await wire.open()
    await wire.arm(Permission())
    return wire


async def cycle(wire: RBY1Wire, cycles: int = 1) -> None:
    for _ in range(cycles):
        await trio.sleep(0.01)
        await wire.read()


def stepped(world: World, rad: float) -> tuple[float, ...]:
    at = world.controller.plant.position_rad
    return (at[0] + rad, *at[1:])
