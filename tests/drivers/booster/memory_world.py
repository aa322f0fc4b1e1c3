"""A T1 with its network in memory, in virtual time: the twin's own computer is behind our own links."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors.drivers.booster import link as link_module
from strands_actors.drivers.booster.driver import BoosterDriver
from strands_actors.drivers.booster.robots import model_of
from strands_actors.drivers.booster.twin.server import BoosterServer, BoosterTwinOptions
from strands_actors.drivers.common.twin import WireLog as TwinLog
from strands_actors.kernel.clock import NS, VirtualClock
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Acquire, Lease, Perform, Resume, Setpoint
from strands_actors.testing import WireLog
from strands_actors.testing.inline import InlineTree, open_inline_tree
from tests.drivers.unitree.walking_world import Bus, Participant

TICK_S = 0.002


class World:
    """A T1 and its driver."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        path = directory / "wire.ndjson"
        path.touch()
        self.log = WireLog(path)
        bus = Bus()
        monkeypatch.setattr(link_module, "Participant", lambda *_, **__: Participant(bus))
        self.server = BoosterServer(model_of("booster_t1"), TwinLog(str(path)), BoosterTwinOptions())
        self.server.make_endpoints(Participant(bus))  # type: ignore[arg-type]
        self.onboard = self.server.onboard
        self.driver = BoosterDriver("booster_t1", "127.0.0.77", {})
        self.peaks: dict[str, float] = {}
        """Greatest values that a test has seen."""

    async def live(self) -> None:
        tick = 0
        while True:
            tick += 1
            now_ns = round(trio.current_time() * NS)
            self.server.advance(now_ns / NS)
            self.server.send_due(tick, now_ns)
            await trio.sleep(TICK_S)

    @asynccontextmanager
    async def tree(self) -> AsyncIterator[Holder]:
        """Yield the holder of the lease of a connected and armed robot."""
        await trio.sleep(1.0)  # At the time 0 the code would count everything as just tried.
        async with trio.open_nursery() as nursery:
            nursery.start_soon(self.live)
            await trio.sleep(0.1)
            async with open_inline_tree(driver=self.driver, clock=VirtualClock()) as tree:
                yield await Holder.of(tree)
            nursery.cancel_scope.cancel()


class Holder:
    """The holder of a tree's lease."""

    def __init__(self, tree: InlineTree, lease: Lease) -> None:
        self._tree = tree
        self._lease = lease

    @classmethod
    async def of(cls, tree: InlineTree) -> Holder:
        await tree.gate.ask(Resume("test"), 10.0)
        await tree.until("armed")
        lease = await tree.gate.ask(Acquire("test"), 1.0)
        assert isinstance(lease, Lease), lease
        return cls(tree, lease)

    async def acquire(self) -> None:
        """Take the lease again, which ends while the test does nothing."""
        lease = await self._tree.gate.ask(Acquire("test", again=self._lease.id), 1.0)
        assert isinstance(lease, Lease), lease
        self._lease = lease

    async def command(self, action: dict[str, Any]) -> Message | None:
        """Send a setpoint for the arms."""
        deadline_ns = round((trio.current_time() + 0.3) * NS)
        setpoint = Setpoint(self._lease.id, self._lease.epoch, deadline_ns, action, 0.0, False)
        return await self._tree.gate.ask(setpoint, 1.0)

    async def do(self, service: str, **arguments: Any) -> Message | None:
        request = Perform(self._lease.id, self._lease.epoch, service, arguments)
        return await self._tree.gate.ask(request, 20.0)
