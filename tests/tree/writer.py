"""Helpers for tests of the tree: a writer with a lease, the setpoints on the wire, a frozen actor."""

from __future__ import annotations

from typing import Any

import trio

from strands_actors.contract.driver import HOLDING_REASONS, Driver, Reason
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Acquire, Lease, Resume, Resumed, Setpoint
from strands_actors.testing import FakeHardware, InlineTree
from strands_actors.testing.fake import HARDWARE, FakeDriver


class Writer:
    def __init__(self, tree: InlineTree, name: str = "writer") -> None:
        self.tree = tree
        self.name = name
        self.ref = tree.node.ref(tree.gate.address, sender=f"strands/test/{name}")
        self.lease = Lease(0, 0)

    async def acquire(self) -> Message | None:
        answer = await self.ref.ask(Acquire(self.name, again=self.lease.id), 1.0)
        if isinstance(answer, Lease):
            self.lease = answer
        return answer

    async def read_epoch(self) -> None:
        """Read the current epoch and keep the lease.

        A new acquisition during a hold would be answered only after the hold.
        """
        self.lease = Lease(self.lease.id, (await self.tree.status()).epoch)

    def setpoint(
        self, ttl_s: float = 0.1, latched: bool = False, period_s: float = 0.02, **action: Any
    ) -> Setpoint:
        deadline_ns = self.tree.node.clock.now_ns() + round(ttl_s * 1e9)
        period_s = 0.0 if latched else period_s
        return Setpoint(self.lease.id, self.lease.epoch, deadline_ns, action, period_s, latched)

    async def send(self, ttl_s: float = 0.1, latched: bool = False, **action: Any) -> Message | None:
        return await self.ref.ask(self.setpoint(ttl_s, latched, **action), 1.0)


async def armed(tree: InlineTree, name: str = "writer") -> Writer:
    """Arm the robot, and return a writer that has the lease."""
    answer = await tree.gate.ask(Resume("test"), 1.0)
    assert isinstance(answer, Resumed), answer
    writer = Writer(tree, name)
    assert isinstance(await writer.acquire(), Lease)
    return writer


def setpoints(tree: InlineTree, since_ns: int = 0) -> list[tuple[float, ...]]:
    return [written.values for written in tree.hardware.of("setpoint", since_ns)]


def freeze(tree: InlineTree, actor: str) -> None:
    """Freeze an actor. From its next message on it never answers."""
    cell = tree.node.cells[tree.gate.address.replace("gate", actor)]

    def deaf(_: int) -> bool:
        while cell.mailbox.pop() is not None:
            pass
        return True

    cell.work = deaf  # type: ignore[method-assign]
    cell._work_slowly = trio.sleep_forever  # type: ignore[method-assign]


def driver_of(
    hardware: FakeHardware, port: str, made_by: type[FakeDriver] = FakeDriver, usual: str = "stop"
) -> Driver:
    """Return a driver whose e-stop cuts the power, as that of a Reachy, a Spot or an RB-Y1 may.

    Args:
        usual: The safe state of all other stops. A hold stays a hold.
    """
    HARDWARE[port] = hardware
    driver = made_by("fake", port, {})
    del HARDWARE[port]
    driver.fallbacks = {
        reason: "hold" if reason in HOLDING_REASONS else "off" if reason is Reason.ESTOP else usual
        for reason in Reason
    }
    return driver
