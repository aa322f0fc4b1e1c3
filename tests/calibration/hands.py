"""A person at a twin: moves the joints that a calibration asks for, and confirms."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any

import trio

from strands_actors.contract.loading import load
from strands_actors.drivers import get_native_driver_class, leader_name, list_leaders
from strands_actors.drivers.common.kit.calibration import MotorCalibration
from strands_actors.drivers.common.ports.serial_port import BytePort, open_serial
from strands_actors.drivers.common.servo.axes import COUNTS_PER_RADIAN
from strands_actors.drivers.common.servo.calibrating import Plan, Proposal, Registers, calibrate
from strands_actors.drivers.common.servo.setup import Setup
from strands_actors.drivers.common.servo.sweep import HALF_TURN, Sweep
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing import Twin

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
ENDS = (0.0, 0.4)
"""Where the stops of all joints are, in radians. A small range is swept quickly."""
STILL, STILL_COUNTS = 4, 1
"""A joint is at rest when it has moved by at most so many counts in so many readings."""


def class_of(robot: str) -> Any:
    return get_native_driver_class(robot) if leader_name(robot) is None else list_leaders()[robot]


def setup_of(robot: str, port: str, open_port: Callable[[str, int], BytePort] = open_serial) -> Setup[Any]:
    driver_class = class_of(robot)
    driver = driver_class(robot, port, driver_class.resolve(robot, {}))
    setup: Setup[Any] = load(driver_class.SETUP)(driver.config, MonotonicClock(), open_port)
    return setup


def plan_of(robot: str, ends: tuple[float, float] = ENDS, accepted: tuple[str, ...] = ()) -> Plan:
    """Return the plan of a robot with stops at ``ends``."""
    driver_class = class_of(robot)
    table = driver_class.TABLES.robots[robot]
    whole_turn, inverted = table.get("whole_turn", ()), table.get("inverted", ())
    return Plan(dict.fromkeys(JOINTS, ends), whole_turn, inverted, driver_class.MAX_OFFSET, accepted)


class Hands:
    """Moves each joint to both of its ends when it is asked for.

    Args:
        twin: The robot.
        ends: Angles to which every joint is moved, in radians.
        confirms: The answer to the result.
    """

    def __init__(self, twin: Twin, ends: tuple[float, ...] = ENDS, confirms: bool = True) -> None:
        self._twin = twin
        self._ends = ends
        self._confirms = confirms
        self._recent: list[dict[str, int]] = []
        self._shown = trio.Event()
        self.asked: list[str] = []
        self.proposal: Proposal | None = None

    async def ready(self, text: str) -> None:
        self.asked.append(text)
        *_, (joint, motion) = re.findall(r"move (\w+) (from|both)", text)
        middle = (sum(self._ends) / len(self._ends),) if motion == "both" else ()
        for angle in (*self._ends, *middle):
            await trio.to_thread.run_sync(lambda to=angle: self._twin.move_by_hand(**{joint: to}))
            await self._rest()

    async def _rest(self) -> None:
        self._recent.clear()
        with trio.fail_after(60.0):
            while len(self._recent) < STILL + 2 or not self._is_still():
                await self._shown.wait()

    def _is_still(self) -> bool:
        last = self._recent[-STILL:]
        return all(max(row[key] for row in last) - min(row[key] for row in last) <= STILL_COUNTS for key in last[0])

    def show(self, sweep: Sweep, joint: str, expected: int | None) -> None:
        self._recent.append(dict(sweep.now))
        self._shown.set()
        self._shown = trio.Event()

    async def confirm(self, proposal: Proposal) -> bool:
        self.proposal = proposal
        return self._confirms


def sweep(
    robot: str,
    twin: Twin,
    hands: Hands,
    plan: Plan | None = None,
    keep: Callable[[Registers], None] = lambda registers: None,
    open_port: Callable[[str, int], BytePort] = open_serial,
) -> Proposal:
    """Calibrate a twin, and return the result."""

    async def run(setup: Setup[Any]) -> Proposal:
        return await calibrate(setup, hands, plan or plan_of(robot), keep)

    proposal: Proposal = at_servos(robot, twin, run, open_port)
    return proposal


def at_servos(
    robot: str,
    twin: Twin,
    work: Callable[[Setup[Any]], Any],
    open_port: Callable[[str, int], BytePort] = open_serial,
) -> Any:
    """Run an async function with the servos of a twin, and return its result."""
    setup = setup_of(robot, twin.port, open_port)

    async def main() -> Any:
        try:
            return await work(setup)
        finally:
            setup.close()

    return trio.run(main)


def registers_of(robot: str, twin: Twin) -> dict[str, Mapping[str, int]]:
    """Return the registers of all servos of a twin."""

    async def read(setup: Setup[Any]) -> dict[str, Mapping[str, int]]:
        await setup.open()
        return {axis.key: (await setup.read_state(axis)).registers for axis in setup.axes}

    found: dict[str, Mapping[str, int]] = at_servos(robot, twin, read)
    return found


def calibrate_as_built_first(twin: Twin) -> None:
    """Write the registers of an SO-101 that was calibrated when all its servos were built in as in its table."""
    low, high = (round(2048 + end * COUNTS_PER_RADIAN) for end in ENDS)
    offset = (low + high) // 2 - HALF_TURN

    async def write(setup: Setup[Any]) -> None:
        await setup.open()
        for axis in setup.axes:
            present = (await setup.read_state(axis)).registers
            motor = MotorCalibration(axis.id, 0, offset, low - offset, high - offset)
            await setup.write_registers(axis, setup.registers_of(axis, motor, present))

    at_servos("so101", twin, write)
