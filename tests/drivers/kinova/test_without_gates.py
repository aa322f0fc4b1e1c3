"""Test what the simulated base shows when a gate or a condition of the Kinova driver is taken out."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.kinova.driver import Kinova
from strands_actors.drivers.kinova.gates import BASE
from strands_actors.drivers.kinova.protocol import ArmState, ServoingMode, sub_error_name
from strands_actors.drivers.kinova.speeds import Course
from tests.drivers.without_gates import Row, assert_complete, judge

from .kortex_client import joint_speeds
from .world import EXECUTE_ACTION, HOME, World, reach_angles

SPEEDS = 0x20084
PERIODS = 20
END_RAD = 2.09
"""The end of joint 6."""


class Bench:
    """The driver, and the simulated base with another client, in virtual time."""

    def __init__(self) -> None:
        arm = Kinova("kinova_gen3", "192.0.2.10", {})
        self.driver: Driver = arm
        self.config = arm.config
        self.world = World()
        self.age_s = 0.005  # Age of the newest feedback that the driver has.
        self.lost = ""  # The reason why the driver has stopped the arm by itself.
        self.refusal = ""
        self.target = self.position

    @property
    def position(self) -> tuple[float, ...]:
        return tuple(math.remainder(math.radians(angle), math.tau) for angle in self.world.degrees())

    async def state(self) -> GateState:
        base = self.world.base
        now_ns = round(self.world.now_s * 1e9)
        seen_ns = now_ns - round(self.age_s * 1e9)
        bank, _ = self.world.faults()
        observed = Observation(
            seen_ns,
            self.position,
            (seen_ns,) * 7,
            tuple(base.plant.velocity_rad_s),
            {"arm_state": (float(self.world.state()),), "fault_bank": (float(bank),)},
            {BASE: self.lost} if self.lost else {},
        )
        return GateState(now_ns, observed, self.target, now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        """Send the speeds towards the target for some periods, as the wire does."""
        course = Course(self.position, values[:7], self.world.now_s, self.config.period_s)
        for _ in range(PERIODS):
            self.turn(course.speeds(self.world.now_s, self.position, self.config.fastest_rad_s))

    def turn(self, rad_s: tuple[float, ...] | list[float]) -> None:
        """Send speeds, and let a control period pass."""
        error, sub_error = self.world.refusal(SPEEDS, joint_speeds(map(math.degrees, rad_s)))
        if error:
            self.refusal = f"SEND_JOINT_SPEEDS: {sub_error_name(sub_error)}"
        self.world.run(self.config.period_s)

    def fault(self) -> str:
        """Return the error of the speeds, or the faults of the base and its joints."""
        bank, joints = self.world.faults()
        return self.refusal or (f"fault banks {bank:x} {joints}" if bank or any(joints) else "")


async def in_fault(bench: Bench) -> None:
    bench.world.base.set_state(ArmState.IN_FAULT)


async def low_level(bench: Bench) -> None:
    bench.world.base.set_mode(ServoingMode.LOW_LEVEL)


async def stopped(bench: Bench) -> None:
    bench.lost = "stopped, because no new feedback arrived for 80 ms"


async def old(bench: Bench) -> None:
    bench.age_s = 0.5


async def near_its_end(bench: Bench) -> None:
    bench.world.watch_actions()
    bench.world.call(EXECUTE_ACTION, reach_angles((*HOME[:5], 119.5, HOME[6])))
    bench.world.finish()
    bench.target = bench.position
    assert 0.0 < END_RAD - bench.position[5] < 0.01


async def past_its_end(bench: Bench, values: tuple[float, ...]) -> None:
    """Send the speeds as the wire does, and see where the base stops the joint."""
    await bench.send(values)
    assert bench.position[5] == pytest.approx(END_RAD, abs=3e-3)


async def at_once(bench: Bench, values: tuple[float, ...]) -> None:
    """Send the speeds that the command needs. The driver's wire would lower them."""
    bench.turn(values[7:])


HERE = {"joint_1": 0.001}
ROWS: tuple[Row[Bench], ...] = (
    Row("base_ready", HERE, "ROBOT_IN_FAULT (22)", prepare=in_fault),
    Row("single_level", HERE, "WRONG_MODE (75)", prepare=low_level),
    Row(
        "commanded",
        HERE,
        no_fault="the base knows nothing of the driver's own stop: it takes the next speeds",
        prepare=stopped,
    ),
    Row(
        "stale",
        HERE,
        no_fault="the base does not know on which feedback a speed is based",
        prepare=old,
    ),
    Row(
        "past_range",
        {"joint_6": END_RAD + 0.01},
        no_fault="the base stops the joint at its limit, and reports no fault",
        prepare=near_its_end,
        send=past_its_end,
    ),
    Row("too_fast", {"joint_1": 0.05}, "LARGE_SPEED (60)", send=at_once),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_base_shows_its_own_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    trio.run(judge, row, Bench(), monkeypatch)


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
