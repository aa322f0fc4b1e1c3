"""Test what the simulated servos show when a gate of the Feetech driver is taken out."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech import protocol as p
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import FeetechRig, Rig
from tests.drivers.without_gates import Row, assert_complete, judge

ELBOW, JAW = 3, 6


class ServoBench:
    """The driver's wire on simulated servos, in virtual time. Feetech's and Dynamixel's differ in ``error_of``."""

    def __init__(self, rig: Rig, error_of: Callable[[Any], str]) -> None:
        self.rig = rig
        self.driver: Driver = rig.driver
        self.period_s = 0.0  # The period of the stream; 0 for a single command.
        self._error_of = error_of

    async def cycles(self, count: int, target: tuple[float, ...] = ()) -> None:
        for _ in range(count):
            if target:
                await self.rig.wire.write(target, Permission())
            self.observation = await self.rig.wire.read()
            await trio.sleep(1 / 30)

    async def state(self) -> GateState:
        await self.cycles(10)
        now_ns = self.rig.clock.now_ns()
        seen = self.observation
        return GateState(now_ns, seen, seen.position, now_ns, self.period_s > 0, self.period_s)

    async def send(self, values: tuple[float, ...]) -> None:
        await self.cycles(90, values)

    def fault(self) -> str:
        """Return the error of each servo in its own words; ``silent`` for a servo that does not answer."""
        rows = [
            f"{servo.id} {'silent' if servo.fault is Fault.OFF else self._error_of(servo)}"
            for servo in self.rig.bus.servos
            if servo.fault is Fault.OFF or self._error_of(servo)
        ]
        return ", ".join(rows)


def words(servo: Any) -> str:
    return p.error_words(servo.error)


async def without_power(bench: ServoBench) -> None:
    bench.rig.bus.set_fault(Fault.OFF, ELBOW)
    await bench.cycles(30)


async def over_voltage(bench: ServoBench) -> None:
    bench.rig.servo(ELBOW).voltage_v = 9.5
    await bench.cycles(20)


async def hot(bench: ServoBench) -> None:
    bench.rig.servo(ELBOW).temperature_c = 75
    await bench.cycles(20)


async def overloaded(bench: ServoBench) -> None:
    """Press the jaw against its stop until its servo lets go."""
    bench.rig.servo(JAW).write(p.GOAL_POSITION.address, p.GOAL_POSITION.encode(0))
    await bench.cycles(120)
    assert not bench.rig.bus.plant.torque(JAW - 1)


async def streamed(bench: ServoBench) -> None:
    bench.period_s = 0.05


def narrow(rig: FeetechRig) -> FeetechRig:
    """Set the highest position of the first servo to 40 degrees."""
    servo = rig.bus.servos[0]
    servo.put(p.MAX_POSITION, 2503)
    return rig


AT_TOP_SPEED = "a servo goes to each goal that it gets, at its top speed. It has no fault for a far one"

ROWS: tuple[Row[ServoBench], ...] = (
    Row(
        "outside_reported_range",
        {"shoulder_pan": 60.0},
        no_fault="a servo takes a goal beyond its limits for the limit, without an error",
    ),
    Row("stale", {"elbow_flex": 5.0}, "3 silent", prepare=without_power),
    Row("voltage", {"elbow_flex": 5.0}, "3 voltage", prepare=over_voltage, also=("motor_fault",)),
    Row("temperature", {"elbow_flex": 5.0}, "3 overheat", prepare=hot, also=("motor_fault",)),
    Row("motor_fault", {"gripper": 50.0}, "6 overload", prepare=overloaded),
    Row("too_fast", {"shoulder_pan": 80.0}, no_fault=AT_TOP_SPEED, prepare=streamed),
    Row("jumps", {"shoulder_pan": 100.0}, no_fault=AT_TOP_SPEED),
)


def on_servos(
    test: Callable[[ServoBench], Awaitable[None]], make: Callable[[], Rig], error_of: Callable[[Any], str]
) -> None:
    async def main() -> None:
        await test(ServoBench(await make().armed(), error_of))

    virtual(main)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_servos_show_their_own_fault_without_the_gate(
    row: Row[ServoBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    limited = row.gate == "outside_reported_range"

    async def test(bench: ServoBench) -> None:
        await judge(row, bench, monkeypatch)
        if limited:
            assert bench.rig.servo(1).aimed_rad == pytest.approx(0.698, abs=0.01), "it stops at its limit"

    on_servos(test, lambda: narrow(FeetechRig()) if limited else FeetechRig(), words)


def test_each_gate_has_a_row() -> None:
    async def test(bench: ServoBench) -> None:
        assert_complete(bench.driver, ROWS)

    on_servos(test, FeetechRig, words)
