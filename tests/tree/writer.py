"""A writer for tests of the tree: holds a lease and sends setpoints through the gate."""

from __future__ import annotations

from typing import Any

from strands_actors.runtime.messages import Message
from strands_actors.supervisors.messages import Acquire, Lease, Resume, Resumed, Setpoint
from strands_actors.testing import InlineTree


class Writer:
    def __init__(self, tree: InlineTree, name: str = "writer") -> None:
        self.tree = tree
        self.name = name
        self.ref = tree.node.ref(tree.gate.address, sender=f"strands/test/{name}")
        self.lease = Lease(0, 0)

    async def acquire(self) -> Message | None:
        answer = await self.ref.ask(Acquire(self.name), 1.0)
        if isinstance(answer, Lease):
            self.lease = answer
        return answer

    def setpoint(
        self, ttl_s: float = 0.1, latched: bool = False, period_s: float = 0.02, **action: Any
    ) -> Setpoint:
        deadline_ns = self.tree.node.clock.now_ns() + round(ttl_s * 1e9)
        period_s = 0.0 if latched else period_s
        return Setpoint(self.lease.id, self.lease.epoch, deadline_ns, action, period_s, latched)

    async def send(self, ttl_s: float = 0.1, latched: bool = False, **action: Any) -> Message | None:
        return await self.ref.ask(self.setpoint(ttl_s, latched, **action), 1.0)


async def armed(tree: InlineTree, name: str = "writer") -> Writer:
    """A writer with the lease, on an armed robot."""
    answer = await tree.gate.ask(Resume("test"), 1.0)
    assert isinstance(answer, Resumed), answer
    writer = Writer(tree, name)
    assert isinstance(await writer.acquire(), Lease)
    return writer
