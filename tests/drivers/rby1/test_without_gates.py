"""Test the fault that the simulated robot shows when a gate or a condition of the RB-Y1 driver is taken out.

The robot's own fault is the finish code in its feedback to our command. Each row takes one gate out, and sends the
command that the gate refuses, as the wire does.
"""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.drivers.rby1.commands import Finish, JointPosition, encode_command
from strands_actors.drivers.rby1.driver import RBY1
from strands_actors.drivers.rby1.protocol import Manager, ManagerOrder
from strands_actors.drivers.rby1.twin.requests import Request
from strands_actors.drivers.rby1.wire import RBY1Wire
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.without_gates import Row, assert_complete, judge

from .rig import PORT, TrioClock, World, armed


class Bench:
    """The driver's wire on a robot, in virtual time."""

    def __init__(self, world: World, wire: RBY1Wire) -> None:
        self.driver: Driver = world.driver
        self.world = world
        self.wire = wire
        self.late_s = 0.0  # time that the newest reading needed on its way
        self.target: tuple[float, ...] = ()  # of the last command; empty before the first

    async def state(self) -> GateState:
        await trio.sleep(0.03)
        observed = await self.wire.read()
        now_ns = TrioClock().now_ns() + round(self.late_s * 1e9)
        target = self.target or self.driver.first_target(observed)
        return GateState(now_ns, observed, target, now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        await self.wire.write(values, Permission())
        await trio.sleep(0.5)
        await self.wire.read()

    def fault(self) -> str:
        """Return the robot's feedback to our commands, if it has ended one of them before its time."""
        return self.wire.session.lost


class Other:
    """A second client of the robot."""

    def finished(self, reason: Finish) -> None: ...


async def on_a_new_stream(bench: Bench, values: tuple[float, ...]) -> None:
    """Send a command although the robot has dropped the one before. The wire itself would refuse it."""
    session = bench.wire.session
    session.drop_stream()
    session.lost = ""
    session.send(session.command(values))
    await trio.sleep(0.1)
    await bench.wire.read()


async def pressed(bench: Bench) -> None:
    bench.world.controller.press(True)


async def failed(bench: Bench) -> None:
    bench.world.controller.fail(Manager.MAJOR_FAULT)


async def head_off(bench: Bench) -> None:
    assert bench.world.controller.servo_off("head_1")


async def disabled(bench: Bench) -> None:
    bench.world.controller.order_manager(ManagerOrder.DISABLE)


async def preempted(bench: Bench) -> None:
    await bench.wire.write(bench.driver.first_target(await bench.wire.read()), Permission())
    command = encode_command({"head": JointPosition((0.1, 0.1), 1.0, 60.0)}, 50)
    assert bench.world.controller.command(Other(), Request.decode(command)) is None
    await trio.sleep(0.05)
    await bench.wire.read()
    assert "PREEMPTED" in bench.fault()


async def late(bench: Bench) -> None:
    bench.late_s = 0.2


async def near_its_end(bench: Bench) -> None:
    """Bring the torso near the end of its range, in small steps."""
    observed = await bench.wire.read()
    target = list(bench.driver.first_target(observed))
    for _ in range(30):
        target[0] = min(0.25, target[0] + 0.02)
        await bench.wire.write(tuple(target), Permission())
        await trio.sleep(0.02)
        await bench.wire.read()
    bench.target = tuple(target)


async def far_ahead(bench: Bench) -> None:
    """Let the last target lead the head by as much as the gate allows, as after quick small steps."""
    observed = await bench.wire.read()
    target = list(bench.driver.first_target(observed))
    target[20] += 3.14 * 0.19
    bench.target = tuple(target)


HERE = {"head_0": 0.01}
ROWS: tuple[Row[Bench], ...] = (
    Row("released", HERE, "CONTROL_MANAGER_IDLE", prepare=pressed, also=("powered", "enabled")),
    Row("faultless", HERE, "CONTROL_MANAGER_FAULT", prepare=failed, also=("enabled",)),
    Row("powered", HERE, "CONTROL_MANAGER_IDLE", prepare=head_off, also=("enabled",)),
    Row("enabled", HERE, "CONTROL_MANAGER_IDLE", prepare=disabled),
    Row("obeying", HERE, "PREEMPTED", prepare=preempted, send=on_a_new_stream),
    Row(
        "stale",
        HERE,
        no_fault="the robot does not know on which of its states a command is based",
        prepare=late,
    ),
    Row("past_own_range", {"torso_0": 0.27}, "INITIALIZED_FAILED", prepare=near_its_end),
    Row(
        "too_fast",
        {"head_0": 0.4},
        no_fault="the robot takes a target at any distance. The joint turns at its own speed, and arrives later",
    ),
    Row(
        "runs_ahead",
        {"head_0": 3.14 * 0.19 + 0.05},
        no_fault="the robot compares no target with the joint's position. The joint follows at its own speed",
        prepare=far_ahead,
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_robot_shows_its_own_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        async with World().living() as world:
            await judge(row, Bench(world, await armed(world)), monkeypatch)

    virtual(main)


def test_a_joint_that_is_sent_too_far_turns_no_faster_than_it_can() -> None:
    """The reason why the robot needs no fault for such a target."""

    async def main() -> None:
        async with World().living() as world:
            wire = await armed(world)
            target = list(world.driver.first_target(await wire.read()))
            target[20] += 1.0
            await wire.write(tuple(target), Permission())
            await trio.sleep(0.1)
            assert 0.1 < world.controller.plant.position_rad[20] < 0.35

    virtual(main)


def test_each_gate_has_a_row() -> None:
    assert_complete(RBY1("rby1", PORT, {}), ROWS)
