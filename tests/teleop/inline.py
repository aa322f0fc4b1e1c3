"""Run a teleoperation of an armed robot in the loop of a test, in virtual time."""

from __future__ import annotations

from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import Any, Generic, NamedTuple, TypeVar

import msgspec
import trio

from strands_actors.contract.axis import Axis
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Message
from strands_actors.kernel.node import Ref
from strands_actors.supervisors import addresses
from strands_actors.supervisors.root.messages import Rollout, TaskStatus
from strands_actors.teleoperation.actor import Teleoperation
from strands_actors.testing import InlineTree, open_inline_tree
from tests.tree.writer import armed

PERIOD_S = 0.01
CHANNEL = "policy process 7"

ActorT = TypeVar("ActorT", bound=Teleoperation)


class GateOfPolicy:
    """The gate's reference in a policy process."""

    def __init__(self, gate: Ref) -> None:
        self._gate = gate

    async def ask(self, message: Any, deadline_s: float) -> Message | None:
        if "channel" in message.__struct_fields__:
            message = msgspec.structs.replace(message, channel=CHANNEL)
        return await self._gate.ask(message, deadline_s)


class Led(NamedTuple, Generic[ActorT]):
    tree: InlineTree
    actor: ActorT
    ref: Ref
    told: list[TaskStatus]

    @property
    def clock(self) -> Clock:
        return self.tree.node.clock


@asynccontextmanager
async def teleoperation(make: type[ActorT], source: Mapping[str, Any], kind: str) -> AsyncIterator[Led[ActorT]]:
    """Yield a teleoperation of the class ``make``. A test may replace its gate before the first request."""
    async with open_inline_tree() as tree, trio.open_nursery() as nursery:
        writer = await armed(tree)
        robot = tree.gate.address.split("/")[1]
        rollout = Rollout(robot, tree.driver.axes, "", PERIOD_S, 0.1, 60.0, over=writer.lease.id)
        told: list[TaskStatus] = []
        table = [Axis(key=key, unit="deg", low=-90.0, high=90.0, speed=100.0) for key in tree.driver.axes]
        actor = make(rollout, told.append, source, msgspec.to_builtins(table), kind, "key")
        cell = tree.node.cell(addresses.of(robot).path("policy"), lambda: actor)
        nursery.start_soon(cell.run)
        await trio.sleep(PERIOD_S)
        yield Led(tree, actor, tree.node.ref(cell.address, Teleoperation), told)
        nursery.cancel_scope.cancel()
