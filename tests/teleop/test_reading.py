"""The rate at which a leader arm is read, and the readings that become setpoints, in virtual time."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Message
from strands_actors.supervisors.gate.messages import Setpoint
from strands_actors.supervisors.root.messages import Operate
from strands_actors.teleoperation.actor import MOVED, Teleoperation
from strands_actors.teleoperation.sources import Reading
from strands_actors.testing import InlineTree, run_virtual
from strands_actors.testing.fake import Written

from .inline import PERIOD_S, GateOfPolicy, teleoperation

PERIOD_NS = round(PERIOD_S * 1e9)
HALF_NS = PERIOD_NS // 2
ROOM_NS = 1_000_000
ANSWERS_NS = 17_000_000


class Leader:
    """An arm on a bus. Its first joint advances by ``step`` with each reading."""

    READINGS = 2

    def __init__(self, axes: tuple[str, ...], clock: Clock) -> None:
        self._values = dict.fromkeys(axes, 0.0)
        self._clock = clock
        self.step = 0.0
        self.told: list[tuple[int, float]] = []
        """Time and first joint of each reading."""

    async def open(self) -> None: ...

    async def read(self) -> Reading:
        first = next(iter(self._values))
        self._values = {**self._values, first: self._values[first] + self.step}
        self.told.append((self._clock.now_ns(), self._values[first]))
        return Reading(self._clock.now_ns(), self._values)

    def close(self) -> None: ...


class ArmLed(Teleoperation):
    def _source(self) -> Leader:
        self.leader = Leader(tuple(axis.key for axis in self._axes), self.context.clock)
        return self.leader


class Slow(GateOfPolicy):
    """A gate that answers a setpoint after ``answers_s``."""

    answers_s = 0.0

    async def ask(self, message: Any, deadline_s: float) -> Message | None:
        answer = await super().ask(message, deadline_s)
        if isinstance(message, Setpoint):
            await trio.sleep(self.answers_s)
        return answer


class Engaged(NamedTuple):
    tree: InlineTree
    leader: Leader
    gate: Slow

    async def sent(self) -> list[Written]:
        """Return the setpoints of 0.1 s."""
        await trio.sleep(0.03)
        since_ns = self.tree.node.clock.now_ns()
        await trio.sleep(0.1)
        return self.tree.hardware.of("setpoint", since_ns)

    async def sent_ns(self) -> list[int]:
        return [each.t_ns for each in await self.sent()]

    def reads(self) -> list[int]:
        return _gaps([at_ns for at_ns, _ in self.leader.told[-20:]])


def _gaps(times_ns: list[int]) -> list[int]:
    return [late - soon for soon, late in itertools.pairwise(times_ns)]


@asynccontextmanager
async def engaged() -> AsyncIterator[Engaged]:
    async with teleoperation(ArmLed, {"type": "arm"}, "absolute") as led, trio.open_nursery() as nursery:
        gate: Any = Slow(led.actor._gate)
        led.actor._gate = gate

        async def hold() -> None:
            for held in itertools.chain([False], itertools.repeat(True)):
                led.ref.tell(Operate(led.clock.now_ns(), held))
                await trio.sleep(0.02)

        nursery.start_soon(hold)
        await trio.sleep(0.3)
        assert led.told[-1].teleop["state"] == "engaged", led.told[-1]
        yield Engaged(led.tree, led.actor.leader, gate)
        nursery.cancel_scope.cancel()


def test_an_arm_that_moves_is_followed_from_each_reading_and_one_at_rest_from_every_other() -> None:
    async def run() -> None:
        async with engaged() as led:
            gaps: dict[float, set[int]] = {}
            for step in (0.0, MOVED * 0.4, MOVED * 1.5):
                led.leader.step = step
                gaps[step] = {round(gap / HALF_NS) * HALF_NS for gap in _gaps(await led.sent_ns())}
            assert all(abs(gap - HALF_NS) < ROOM_NS for gap in led.reads()), "the arm is read twice a period"
            assert list(gaps.values()) == [{PERIOD_NS}, {PERIOD_NS}, {HALF_NS}], gaps

    run_virtual(run)


def test_a_gate_that_answers_late_does_not_keep_the_arm_from_being_read() -> None:
    async def run() -> None:
        async with engaged() as led:
            led.gate.answers_s = ANSWERS_NS / 1e9
            led.leader.step = MOVED * 1.5
            sent = await led.sent()
            assert all(abs(gap - HALF_NS) < ROOM_NS for gap in led.reads()), led.reads()
            gaps = _gaps([each.t_ns for each in sent])
            assert all(abs(gap - ANSWERS_NS) <= ROOM_NS for gap in gaps), gaps
            for each in sent:
                newest = [value for at_ns, value in led.leader.told if at_ns <= each.t_ns][-2:]  # one is on its way
                assert any(each.values[0] == pytest.approx(value) for value in newest), "the newest is sent"

    run_virtual(run)
