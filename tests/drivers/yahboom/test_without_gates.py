"""Test what the simulated robot shows when a gate of the M3 Pro's driver is taken out.

ROS topics have no answer: the robot's base and servos report no error at all. So each row gives a reason, and the
test shows that the robot still keeps its own limits.
"""

from __future__ import annotations

from contextlib import suppress

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import PermitDenied
from strands_actors.drivers.yahboom import messages as m
from strands_actors.drivers.yahboom.wire import YahboomWire
from strands_actors.kernel.clock import NS
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.without_gates import Row, assert_complete, judge
from tests.drivers.yahboom.rig import World, running


class Bench:
    def __init__(self, world: World, wire: YahboomWire) -> None:
        self.driver: Driver = world.driver
        self.world = world
        self._wire = wire
        self.refused = ""  # Why the wire itself sent nothing.

    async def state(self) -> GateState:
        seen = await self._wire.read()
        now_ns = round(trio.current_time() * NS)
        return GateState(now_ns, seen, self.driver.first_target(seen), now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        self.world.twin.mechanism.pass_time()
        try:
            await self._wire.write(values, Permission())
        except (PermitDenied, ValueError) as refused:
            self.refused = str(refused)
        with suppress(trio.TooSlowError), trio.fail_after(2.5):
            while True:
                await trio.sleep(0.05)
                self.world.twin.mechanism.pass_time()

    def fault(self) -> str:
        """Return the errors that rosbridge has sent to the driver."""
        return ", ".join(text for socket in self.world.sockets for text in socket.errors)


async def silent(bench: Bench) -> None:
    bench.world.mute.add(m.ODOMETRY)
    await trio.sleep(0.55)


async def with_unknown_servos(bench: Bench) -> None:
    """Take out the gate that follows ``whole_arm`` and relies on it: it cannot convert an unknown position."""
    bench.driver.gates = tuple(gate for gate in bench.driver.gates if gate.__name__ != "servo_range")


WHOLE = {"arm1": 0.0, "arm2": 2.5, "arm3": 0.0, "arm4": 0.0, "arm5": 0.0, "gripper": -0.1}

ROWS: tuple[Row[Bench], ...] = (
    Row(
        "silent",
        {"linear.x": 0.2},
        no_fault="the robot does not know that its odometry does not arrive. The wire sends nothing then",
        prepare=silent,
    ),
    Row(
        "whole_arm",
        {"arm1": 0.1},
        no_fault="the message has no word for an unknown servo. The wire cannot encode it, and sends nothing",
        prepare=with_unknown_servos,
    ),
    Row(
        "servo_range",
        WHOLE,
        no_fault="a servo goes to the end of its range [assumed], and no topic reports it",
        also=("past_range",),
    ),
    Row(
        "past_range",
        {"linear.x": 1.5},
        no_fault="the base drives at its top speed [assumed], and no topic reports it",
    ),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.gate)
def test_the_robot_shows_no_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    async def test() -> None:
        world = World()
        mechanism = world.twin.mechanism
        async with running(world) as wire:
            bench = Bench(world, wire)
            await judge(row, bench, monkeypatch)
            sent = world.kinds("setpoint")
            match row.gate:
                case "silent" | "whole_arm":
                    assert bench.refused and not sent
                case "servo_range":
                    assert sent and mechanism.degrees[1] == 180.0
                case _:
                    assert sent and mechanism.x_m == pytest.approx(1.0 * 0.3, abs=0.05)

    virtual(test)


def test_each_gate_has_a_row() -> None:
    async def test() -> None:
        assert_complete(World().driver, ROWS)

    virtual(test)
