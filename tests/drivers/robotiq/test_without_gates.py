"""Test what the simulated gripper shows when a gate of the Robotiq driver is taken out."""

from __future__ import annotations

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.robotiq import protocol as p
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.robotiq.gates import FORCE, POSITION, SPEED
from strands_actors.drivers.robotiq.twin import twin_of
from tests.drivers.without_gates import Row, assert_complete, judge

READ_S = 0.02


class Bench:
    """The driver, and the simulated gripper, which the bench reads 50 times a second in virtual time."""

    def __init__(self, gflt: int = p.NO_FAULT) -> None:
        self.driver: Driver = Robotiq("robotiq_2f85", "192.0.2.10", {})
        self.now_s = 100.0
        self.twin = twin_of("robotiq_2f85", lambda: self.now_s, activated=True, gflt=gflt)
        self.hears = True  # False: the gripper's answers do not arrive.
        self.run(READ_S)

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / READ_S)):
            self.now_s += READ_S
            self.twin.gripper.note_request()
            if self.hears:
                self.seen, self.seen_s = self.twin.status(), self.now_s

    async def state(self) -> GateState:
        seen, seen_ns = self.seen, round(self.seen_s * 1e9)
        closed = (seen.position / p.TOP,)
        sensors = {"activation": (float(seen.activation),), "fault": (float(seen.fault),)}
        observed = Observation(seen_ns, closed, (seen_ns,), sensors=sensors)
        return GateState(round(self.now_s * 1e9), observed, closed, seen_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        """Write the registers of a setpoint, and read the gripper for half a second."""
        position, speed, force = (p.counts_of(values[slot]) for slot in (POSITION, SPEED, FORCE))
        self.before = self.twin.gripper.position
        self.twin.write(0, p.Command(go_to=True, position=position, speed=speed, force=force).registers())
        self.run(0.5)

    def fault(self) -> str:
        """Return the fault that the gripper reports, with the state of its activation."""
        status = self.twin.status()
        return f"{p.fault_words(status.fault)}, gSTA {status.activation}" if status.fault else ""


async def lost_its_power(bench: Bench) -> None:
    """Let the power fail and return, unseen: the last reading is from before."""
    bench.hears = False
    bench.twin.power_cycle()
    bench.run(0.4)


async def reset(bench: Bench) -> None:
    bench.twin.write(0, p.RESET.registers())
    bench.run(0.1)
    assert bench.fault() == ""


async def released(bench: Bench) -> None:
    bench.twin.write(0, p.Command(go_to=True, position=200).registers())
    bench.run(2.0)
    bench.twin.write(0, p.Command(release=True).registers())
    bench.run(10.0)


async def releasing(bench: Bench) -> None:
    bench.twin.write(0, p.Command(go_to=True, position=200).registers())
    bench.run(2.0)
    bench.twin.write(0, p.Command(release=True).registers())
    bench.run(0.5)


async def hot(bench: Bench) -> None:
    assert bench.fault().startswith("over temperature")


HALF = {"gripper": 0.5}
ACTIVATES = "action delayed, activation is not finished (gFLT 5), gSTA 1"
"""Every setpoint has the activation bit set. So it activates a gripper that is not, over the whole stroke."""

ROWS: tuple[Row[Bench], ...] = (
    Row("stale", HALF, ACTIVATES, prepare=lost_its_power),
    Row("activated", HALF, ACTIVATES, prepare=reset),
    Row("fault_free", HALF, "automatic release is done (gFLT 15)", prepare=released),
    Row("fault_free", HALF, "automatic release is running (gFLT 11)", prepare=releasing),
    Row("fault_free", HALF, "over temperature (gFLT 8)", prepare=hot),
)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.gate}-{row.prepare.__name__}")
def test_the_gripper_shows_its_own_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(gflt=p.OVER_TEMPERATURE if row.prepare is hot else p.NO_FAULT)
    trio.run(judge, row, bench, monkeypatch)
    if row.gate == "fault_free":
        assert bench.twin.gripper.position <= bench.before, "a gripper with a fault does not follow a setpoint"
    else:
        assert bench.twin.gripper.position > 100, "the activation closes the fingers, whatever the setpoint"


def test_each_gate_has_a_row() -> None:
    assert_complete(Bench().driver, ROWS)
