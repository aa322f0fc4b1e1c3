"""A robot that walks, or whose joints are commanded, with its network in memory, in virtual time.

The twin's own computer, with its log of the wire, is behind our own links.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Driver
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.common.twin import WireLog as TwinLog
from strands_actors.drivers.unitree import link as link_module
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.robots import model_of
from strands_actors.drivers.unitree.twin import UnitreeServer, UnitreeTwinOptions
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Acquire, Lease, Perform, Resume, Setpoint
from strands_actors.testing import WireLog
from strands_actors.testing.inline import InlineTree, open_inline_tree

TICK_S = 0.01
Deliver = Callable[[memoryview, bytes, int], None]


class Bus:
    """Topics in memory. With ``deaf`` everything that is written to the robot is lost."""

    def __init__(self) -> None:
        self.readers: dict[str, list[Deliver]] = {}
        self.deaf = False


class Writer:
    matched = 1
    has_parted = False

    def __init__(self, bus: Bus, topic: str) -> None:
        self._bus, self._topic = bus, topic

    def write(self, payload: bytes) -> int:
        if self._bus.deaf and self._topic.endswith("request"):
            return 1
        for deliver in list(self._bus.readers.get(self._topic, ())):
            deliver(memoryview(payload), b"", round(trio.current_time() * NS))
        return 1

    write_stop = write


class Reader:
    matched = 1


class Participant:
    """The stand-in for a participant on a network."""

    peers = 1

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._own: list[tuple[str, Deliver]] = []

    def writer(self, topic: str, type_name: str, **_: Any) -> Writer:
        return Writer(self._bus, topic)

    def reader(self, topic: str, type_name: str, on_sample: Deliver, **_: Any) -> Reader:
        self._bus.readers.setdefault(topic, []).append(on_sample)
        self._own.append((topic, on_sample))
        return Reader()

    def poll(self) -> None:
        pass

    async def run(self, task_status: trio.TaskStatus[None] = trio.TASK_STATUS_IGNORED) -> None:
        task_status.started()
        await trio.sleep_forever()

    async def wait_matched(self, *endpoints: Writer | Reader, n: int = 1) -> None:
        await trio.lowlevel.checkpoint()

    def close(self) -> None:
        for topic, deliver in self._own:
            self._bus.readers[topic].remove(deliver)
        self._own = []


class World:
    def __init__(
        self,
        directory: Path,
        monkeypatch: pytest.MonkeyPatch,
        robot: str = "unitree_go2",
        level: str = "sport",
        **options: Any,
    ) -> None:
        path = directory / "wire.ndjson"
        path.touch()
        self.log = WireLog(path)
        self.bus = Bus()
        self._at_s = 0.0
        self.peaks: dict[str, float] = {}
        """Greatest values that a test has seen."""
        monkeypatch.setattr(link_module, "Participant", lambda *_, **__: Participant(self.bus))
        # The worst case: the robot keeps a velocity for ever.
        given = UnitreeTwinOptions(**{"keeps_s": 0.0, **options})
        self.server = UnitreeServer(model_of(robot), TwinLog(str(path)), given)
        self.server.make_endpoints(Participant(self.bus))  # type: ignore[arg-type]
        assert self.server.onboard.gait is not None
        self.gait = self.server.onboard.gait
        # A robot whose joints are commanded sends 500 states a second. Each state of a robot that walks comes with
        # a SportModeState.
        self._tick_s, self._ticks = (TICK_S, 10) if level == "sport" else (0.002, 1)
        driver_class = get_native_driver_class(robot)
        assert driver_class is not None and issubclass(driver_class, Driver)
        self.driver = driver_class.for_level(robot, {"level": level})(robot, "127.0.0.77", {})

    async def live(self) -> None:
        tick = 0
        while True:
            tick += self._ticks
            now_ns = round(trio.current_time() * NS)
            self.server.advance(now_ns / NS)
            self.server.send_due(tick, now_ns)
            await trio.sleep(self._tick_s)

    def asked(self, since_s: float = 0.0) -> list[int]:
        """Return the requests to the sport service, in order."""
        entries = (entry for entry in self.log.entries(round(since_s * NS)) if entry.sender == "host")
        return [rpc.decode_request(entry.data).api for entry in entries if entry.kind != "read"]

    @asynccontextmanager
    async def tree(self) -> AsyncIterator[Commander]:
        """Yield the holder of the lease of a connected and armed robot."""
        await trio.sleep(1.0)  # at the time 0 the code would count everything as just tried
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self.live)
            await trio.sleep(0.1)
            async with open_inline_tree(driver=self.driver, clock=VirtualClock()) as tree:
                commander = Commander(tree)
                await commander.resume()
                yield commander
            nursery.cancel_scope.cancel()


class Commander:
    """The holder of a tree's lease."""

    def __init__(self, tree: InlineTree) -> None:
        self.tree = tree
        self.lease = Lease(0, 0)

    async def resume(self) -> None:
        await self.tree.gate.ask(Resume("test"), 10.0)
        await self.tree.until("armed")
        await self.acquire()

    async def acquire(self) -> None:
        """Take the lease again, after a hold or a stop."""
        lease = await self.tree.gate.ask(Acquire("test", again=self.lease.id), 1.0)
        assert isinstance(lease, Lease), lease
        self.lease = lease

    async def move(self, lifetime_s: float = 0.3, **action: Any) -> Message | None:
        deadline_ns = round((trio.current_time() + lifetime_s) * NS)
        setpoint = Setpoint(self.lease.id, self.lease.epoch, deadline_ns, action, 0.0, False)
        return await self.tree.gate.ask(setpoint, 1.0)

    async def do(self, service: str) -> Message | None:
        return await self.tree.gate.ask(self.perform(service), 20.0)

    def perform(self, service: str) -> Perform:
        return Perform(self.lease.id, self.lease.epoch, service, {})
