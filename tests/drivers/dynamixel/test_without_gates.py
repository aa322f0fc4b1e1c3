"""Test what the simulated servos show when a gate of the Dynamixel driver is taken out."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors.drivers.common.dynamixel import table as t
from tests.drivers.feetech.test_without_gates import (
    AT_TOP_SPEED,
    JAW,
    ServoBench,
    hot,
    on_servos,
    streamed,
    without_power,
)
from tests.drivers.servo.rig import DynamixelRig
from tests.drivers.without_gates import Row, assert_complete, judge


def words(servo: Any) -> str:
    return t.error_words(servo.get(t.HARDWARE_ERROR))


async def over_voltage(bench: ServoBench) -> None:
    bench.rig.servo(3).voltage_v = 9.5
    await bench.cycles(20)


async def overloaded(bench: ServoBench) -> None:
    """Press the jaw against its stop until its servo lets go."""
    jaw = bench.rig.servo(JAW)
    jaw.put(t.GOAL_POSITION, 6000)
    jaw._apply()
    await bench.cycles(120)
    assert not bench.rig.bus.plant.torque(JAW - 1)


ROWS: tuple[Row[ServoBench], ...] = (
    # In extended position mode a servo takes any goal. It presses the joint against its stop.
    Row("outside_reported_range", {"shoulder_pan": 185.0}, "1 overload"),
    Row("stale", {"elbow_flex": 5.0}, "3 silent", prepare=without_power),
    Row("voltage", {"elbow_flex": 5.0}, "3 voltage", prepare=over_voltage, also=("motor_fault",)),
    Row("temperature", {"elbow_flex": 5.0}, "3 overheat", prepare=hot, also=("motor_fault",)),
    Row("motor_fault", {"gripper": 50.0}, "6 overload", prepare=overloaded),
    Row("too_fast", {"shoulder_pan": 80.0}, no_fault=AT_TOP_SPEED, prepare=streamed),
    Row("jumps", {"shoulder_pan": 100.0}, no_fault=AT_TOP_SPEED),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_servos_show_their_own_fault_without_the_gate(
    row: Row[ServoBench], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def test(bench: ServoBench) -> None:
        await judge(row, bench, monkeypatch)

    most_deg = 360 if row.gate == "outside_reported_range" else 90
    on_servos(test, lambda: DynamixelRig(max_jump=most_deg), words)


def test_each_gate_has_a_row() -> None:
    async def test(bench: ServoBench) -> None:
        assert_complete(bench.driver, ROWS)

    on_servos(test, DynamixelRig, words)
