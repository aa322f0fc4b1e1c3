"""How often a leader arm is read, and which readings become setpoints. In virtual time."""

from __future__ import annotations

import itertools
from typing import Any

import msgspec
import trio

from strands_actors.contract.axis import Axis
from strands_actors.kernel.clock import Clock
from strands_actors.supervisors import addresses
from strands_actors.supervisors.gate.messages import Acquire
from strands_actors.supervisors.root.messages import Operate, Rollout, TaskStatus
from strands_actors.teleoperation.actor import MOVED, Teleoperation
from strands_actors.teleoperation.sources import Reading
from strands_actors.testing import open_inline_tree, run_virtual
from tests.tree.writer import armed

from .test_engaging import LosesAnswers

PERIOD_NS = 10_000_000
HALF_NS = PERIOD_NS // 2
ROOM_NS = 1_000_000


class Leader:
    """An arm on a bus, whose first joint goes on by ``step`` with each reading."""

    READINGS = 2

    def __init__(self, axes: tuple[str, ...], clock: Clock) -> None:
        self._values = dict.fromkeys(axes, 0.0)
        self._clock = clock
        self.step = 0.0
        self.read_ns: list[int] = []

    async def open(self) -> None: ...

    async def read(self) -> Reading:
        first = next(iter(self._values))
        self._values = {**self._values, first: self._values[first] + self.step}
        self.read_ns.append(self._clock.now_ns())
        return Reading(self._clock.now_ns(), self._values)

    def close(self) -> None: ...


class Led(Teleoperation):
    def _source(self) -> Leader:
        self.leader = Leader(tuple(axis.key for axis in self._axes), self.context.clock)
        return self.leader


def test_an_arm_that_moves_is_followed_from_each_reading_and_one_at_rest_from_every_other() -> None:
    async def run() -> None:
        async with open_inline_tree() as tree:
            writer = await armed(tree)
            robot = tree.gate.address.split("/")[1]
            rollout = Rollout(robot, tree.driver.axes, "", PERIOD_NS / 1e9, 0.1, 60.0, over=writer.lease.id)
            told: list[TaskStatus] = []
            table = [Axis(key=key, unit="deg", low=-90.0, high=90.0, speed=100.0) for key in tree.driver.axes]
            actor = Led(rollout, told.append, {"type": "arm"}, msgspec.to_builtins(table), "absolute", "key")
            cell = tree.node.cell(addresses.of(robot).path("policy"), lambda: actor)
            clock = tree.node.clock
            async with trio.open_nursery() as nursery:
                nursery.start_soon(cell.run)
                await trio.sleep(0.01)
                gate: Any = LosesAnswers(actor._gate, Acquire, 0)
                actor._gate = gate
                ref = tree.node.ref(cell.address, Teleoperation)

                async def hold() -> None:
                    for held in itertools.chain([False], itertools.repeat(True)):
                        ref.tell(Operate(clock.now_ns(), held))
                        await trio.sleep(0.02)

                nursery.start_soon(hold)
                await trio.sleep(0.3)
                assert told[-1].teleop["state"] == "engaged", told[-1]
                gaps: dict[float, set[int]] = {}
                for step in (0.0, MOVED * 0.4, MOVED * 1.5):
                    actor.leader.step = step
                    await trio.sleep(0.03)
                    since_ns = clock.now_ns()
                    await trio.sleep(0.1)
                    times = [each.t_ns for each in tree.hardware.of("setpoint", since_ns)]
                    gaps[step] = {
                        round((late - soon) / HALF_NS) * HALF_NS for soon, late in itertools.pairwise(times)
                    }
                read = [late - soon for soon, late in itertools.pairwise(actor.leader.read_ns[-20:])]
                assert all(abs(gap - HALF_NS) < ROOM_NS for gap in read), "the arm is read twice a period"
                assert list(gaps.values()) == [{PERIOD_NS}, {PERIOD_NS}, {HALF_NS}], gaps
                nursery.cancel_scope.cancel()

    run_virtual(run)
