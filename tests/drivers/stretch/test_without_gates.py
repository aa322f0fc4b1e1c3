"""Test what the simulated robot shows when a gate or condition of the Stretch driver is taken out."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec
import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.drivers.common.dynamixel.servo import Servo
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.config import LEFT, RIGHT
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.drivers.stretch.parameters import Motor, parameters_of
from strands_actors.kernel.clock import VirtualClock
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.without_gates import Row, assert_complete, judge

from . import rig as ports
from .rig import Rig

PAN_ID = 11
PERIOD_S = 0.05


class Bench:
    """The driver's wire on the simulated robot, in virtual time."""

    def __init__(self, rig: Rig) -> None:
        self.rig = rig
        self.world = rig.world
        self.driver: Driver = Stretch("stretch3", "", {})
        self.wire = rig.wire()
        self.clock = VirtualClock()
        self.events = 0  # Events of contact of the arm before the gate was taken out.

    async def cycles(self, seconds: float, values: tuple[float, ...] = ()) -> Observation:
        for _ in range(round(seconds / PERIOD_S)):
            if values:
                await self.wire.write(values, Permission())
            await trio.sleep(PERIOD_S)
            self.observation = await self.wire.read()
        return self.observation

    async def state(self) -> GateState:
        seen = await self.cycles(PERIOD_S)
        now_ns = self.clock.now_ns()
        return GateState(now_ns, seen, seen.position, now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        """Send a setpoint as the wire does, for so long that the lift reaches an end of its travel."""
        await self.cycles(8.0, values)

    def fault(self) -> str:
        """Return the events that boards and servos report: stopped motors, contacts, errors of hardware."""
        rows = []
        for name, motor in self.world.steppers.items():
            status = motor.status()
            rows += [f"{name} runstop"] if status.has(p.Diag.RUNSTOP) else []
            rows += [f"{name} contacts"] if status.contacts else []
        for bus in self.world.chains:
            errors = {servo.id: t.error_words(servo.get(t.HARDWARE_ERROR)) for servo in bus.servos}
            rows += [f"{number} {words}" for number, words in errors.items() if words]
        return ", ".join(rows)

    def pan(self) -> Servo:
        servo = self.world.chains[1].servos[0]
        assert servo.id == PAN_ID
        return servo


async def pressed(bench: Bench) -> None:
    bench.world.set_runstop(True)


async def met_an_obstacle(bench: Bench) -> None:
    bench.world.set_contact("arm", True)
    candidate = bench.driver.parse({"arm": 0.4}, await bench.state())
    await bench.cycles(0.5, candidate.values)  # type: ignore[union-attr]
    assert bench.fault() == "arm contacts"
    bench.events = bench.world.steppers["arm"].contacts


async def mute(bench: Bench) -> None:
    """Let the answers of the lift's board get lost, but not for so long that the link counts as lost."""
    bench.rig.mute.add(ports.LIFT)
    await bench.cycles(0.3)


async def without_reading(bench: Bench, values: tuple[float, ...]) -> None:
    await bench.wire.write(values, Permission())
    await trio.sleep(2.0)
    bench.world.pass_time()
    assert bench.world.metres("lift") > 0.5


async def over_voltage(bench: Bench) -> None:
    bench.pan().voltage_v = 15.0
    await bench.cycles(3.0)


async def hot(bench: Bench) -> None:
    bench.pan().temperature_c = 75
    await bench.cycles(3.0)


async def overloaded(bench: Bench) -> None:
    """Jam the head, and let its servo turn against this until it lets go."""
    bench.world.chains[1].plant.set_stuck(0, True)
    candidate = bench.driver.parse({"head_pan": -1.0}, await bench.state())
    await bench.cycles(3.0, candidate.values)  # type: ignore[union-attr]
    bench.world.chains[1].plant.set_stuck(0, False)
    assert not bench.pan().energised


async def not_homed(bench: Bench) -> None:
    bench.world.set_homed("lift", False)


async def once(bench: Bench, values: tuple[float, ...]) -> None:
    """Send a twist once. Without its watchdog a wheel keeps this velocity."""
    await bench.wire.write(values, Permission())
    await bench.cycles(3.0)
    for wheel in (LEFT, RIGHT):
        assert bench.world.metres_per_s(wheel) == pytest.approx(0.1, abs=1e-3)
        assert bench.world.steppers[wheel].mode == p.Mode.VELOCITY_PROFILE


async def at_full_speed(bench: Bench, values: tuple[float, ...]) -> None:
    await bench.cycles(5.0, values)
    assert bench.world.metres_per_s(LEFT) == pytest.approx(0.4, abs=1e-3)


ROWS: tuple[Row[Bench], ...] = (
    Row("_runstop", {"lift": 0.6}, "lift runstop", prepare=pressed),
    Row("_stopped_itself", {"arm": 0.45}, "arm contacts", prepare=met_an_obstacle, also=("motor_fault",)),
    Row("soft_limits", {"wrist_yaw": 5.0}, "13 overload"),
    Row(
        "soft_limits",
        {"lift": 1.2},
        no_fault="a board takes a goal beyond its limits of motion for the limit, without an error",
    ),
    Row(
        "stale",
        {"lift": 0.6},
        no_fault="a board does not know which of its reports a command is based on",
        prepare=mute,
        send=without_reading,
    ),
    Row("voltage", {"head_pan": 0.2}, "11 voltage", prepare=over_voltage, also=("motor_fault",)),
    Row("temperature", {"head_pan": 0.2}, "11 overheat", prepare=hot, also=("motor_fault",)),
    Row("motor_fault", {"head_pan": 0.2}, "11 overload", prepare=overloaded),
    # Its encoder counts from where it was switched on. So the lift goes past its stop, where it meets a contact.
    Row("homed", {"lift": 0.9}, "lift contacts", prepare=not_homed),
    Row(
        "wheel_speeds",
        {"vx": 0.4},
        no_fault="a board has no limit of a wheel's speed: the limit is one of the vendor's software",
        send=at_full_speed,
    ),
    Row(
        "wheel_watchdog",
        {"vx": 0.1},
        no_fault="nothing then stops a wheel whose commands end: it keeps the last velocity",
        send=once,
    ),
)


def without_watchdog(motor: Motor) -> Motor:
    gains = motor.gains._replace(config=motor.gains.config & ~int(p.Config.VELOCITY_WATCHDOG))
    return msgspec.structs.replace(motor, gains=gains)


def rig_for(row: Row[Bench]) -> Rig:
    if row.gate != "wheel_watchdog":
        return Rig()
    shipped = parameters_of("stretch3")
    return Rig(left=without_watchdog(shipped.left), right=without_watchdog(shipped.right))


def on_robot(make: Callable[[], Rig], test: Callable[[Bench], Any]) -> None:
    async def main() -> None:
        bench = Bench(make())
        await bench.wire.open()
        await bench.wire.arm(Permission())
        await test(bench)

    virtual(main)


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.gate}-{next(iter(row.action))}")
def test_the_robot_shows_its_own_fault_without_the_gate(row: Row[Bench], monkeypatch: pytest.MonkeyPatch) -> None:
    async def test(bench: Bench) -> None:
        await judge(row, bench, monkeypatch)
        if row.action == {"lift": 1.2}:
            assert bench.world.metres("lift") == pytest.approx(1.1, abs=1e-3), "it stops at its limit"
        if row.gate == "_stopped_itself":
            assert bench.world.steppers["arm"].contacts > bench.events, "it pushes once more"
        if row.gate == "_runstop":
            assert bench.world.metres("lift") == pytest.approx(0.5, abs=1e-3), "the board ignores the goal"
        if row.gate == "homed":
            assert bench.world.metres("lift") == pytest.approx(1.1, abs=1e-3), "it is at its upper stop"

    on_robot(lambda: rig_for(row), test)


def test_each_gate_and_condition_has_a_row() -> None:
    assert_complete(Stretch("stretch3", "", {}), ROWS)
