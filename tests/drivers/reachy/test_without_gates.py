"""Test what the simulated daemon shows when a gate of Reachy's driver is taken out.

The daemon accepts any number and reports success. Its only own fault is that it ignores commands while a move runs.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.drivers.common.twin import WireLog
from strands_actors.drivers.reachy.body import Move
from strands_actors.drivers.reachy.driver import Reachy
from strands_actors.drivers.reachy.twin import ReachyTwin, serve_twin
from strands_actors.drivers.reachy.wire import ReachyWire
from strands_actors.kernel.clock import NS, MonotonicClock
from tests.drivers.reachy.test_gates import ASLEEP
from tests.drivers.reachy.test_stop import FAR, Free, wired
from tests.drivers.without_gates import Row, assert_complete, judge

PATIENCE_S = 20.0


class Bench:
    def __init__(self, twin: ReachyTwin, wire: ReachyWire) -> None:
        self.driver: Driver = Reachy("reachy_mini", "192.0.2.1", Reachy.resolve("reachy_mini", {}))
        self.twin = twin
        self.wire = wire
        self.late_s = 0.0  # Time that the newest reading needed on its way.
        self._clock = MonotonicClock()
        self._ignored = False

    async def state(self) -> GateState:
        seen = await self.wire.read()
        now_ns = self._clock.now_ns() + round(self.late_s * NS)
        return GateState(now_ns, seen, self.driver.first_target(seen), now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        sent_ns = self._clock.now_ns()
        await self.wire.write(values, Free())
        with trio.fail_after(PATIENCE_S):
            while self.wire._unanswered is not None:  # noqa: ASYNC110
                await trio.sleep(0.01)
        await trio.sleep(0.1)  # The answer to a move is judged a moment later.
        self._ignored = self.wire._ignored_ns > sent_ns

    async def shows(self, sensor: str, value: float) -> None:
        """Wait until the driver has observed this value."""
        with trio.fail_after(PATIENCE_S):
            while (await self.wire.read()).sensors.get(sensor) != (value,):  # noqa: ASYNC110
                await trio.sleep(0.02)

    def fault(self) -> str:
        """Return the daemon's answer to the last command, if it is not success."""
        return "ignored" if self._ignored else ""


@asynccontextmanager
async def bench() -> AsyncIterator[Bench]:
    """Yield the driver's wire on a daemon, over sockets."""
    twin = ReachyTwin("reachy_mini")
    server = serve_twin(twin, WireLog(None))
    try:
        async with trio.open_nursery() as nursery:
            server.plug()
            nursery.start_soon(server.serve)
            with trio.fail_after(3 * PATIENCE_S):
                async with wired(server.address) as wire:
                    one = Bench(twin, wire)
                    await one.shows("motor_mode", 1.0)
                    yield one
            nursery.cancel_scope.cancel()
    finally:
        server.close()


async def motors_off(bench: Bench) -> None:
    bench.twin.body.set_mode("disabled")
    await bench.shows("motor_mode", 0.0)


async def others_move(bench: Bench) -> None:
    bench.twin.body.play(Move("b9cbfc2f-79b0-4181-bce4-000000000001", [(FAR, 30.0)]))
    await bench.shows("others_move", 1.0)


async def ignored_before(bench: Bench) -> None:
    await others_move(bench)
    await bench.wire.write((*(await bench.state()).target[:9], 0.0), Free())
    await bench.shows("ignored", 1.0)


async def late(bench: Bench) -> None:
    bench.late_s = 0.7


async def asleep(bench: Bench) -> None:
    bench.twin.body.position = bench.twin.body.target = ASLEEP
    with trio.fail_after(PATIENCE_S):
        while (await bench.wire.read()).position[5] > -49.0:  # noqa: ASYNC110
            await trio.sleep(0.02)


ANY_NUMBER = "the daemon accepts any number, and reports success"
ROLL = {"head_roll": 5.0}

ROWS: tuple[Row[Bench], ...] = (
    Row(
        "motors_on",
        ROLL,
        no_fault="the daemon accepts commands with the motors off, and reports success. Nothing moves",
        prepare=motors_off,
    ),
    Row("heeded", ROLL, "ignored", prepare=ignored_before, also=("would_be_heeded",)),
    Row("would_be_heeded", ROLL, "ignored", prepare=others_move),
    Row(
        "stale",
        ROLL,
        no_fault="the daemon does not know on which reading a command is based",
        prepare=late,
    ),
    Row(
        "past_range",
        {"antenna_left": 170.0},
        no_fault=f"{ANY_NUMBER}. A head beyond its range ends in a wrong pose",
    ),
    Row(
        "asleep",
        ROLL,
        no_fault="the daemon does not move the head out of a pose that it cannot reach, and reports no error",
        prepare=asleep,
    ),
    Row("twisted", {"head_yaw": 100.0}, no_fault=f"{ANY_NUMBER}. The head stops at the body's stop"),
    Row(
        "too_fast",
        {"antenna_left": 140.0, "duration": 0.1},
        no_fault=f"{ANY_NUMBER}. The motors reach the target later than the move's end",
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_daemon_shows_its_own_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        async with bench() as one:
            await judge(row, one, monkeypatch)
            if row.gate == "motors_on":
                assert one.twin.body.position[1] == pytest.approx(0.0), "nothing moves"

    trio.run(main)


def test_each_gate_has_a_row() -> None:
    assert_complete(Reachy("reachy_mini", "192.0.2.1", {}), ROWS)
