"""SAF-014: take each gate and each condition of the driver out, and look at the simulated drone.

Most gates have no counterpart in the firmware. It has no limit for a height or a speed, no memory of a command's
age, and flies on with an empty battery. But its supervisor lets no motor turn before arming, after a crash and
after an emergency stop.
"""

from __future__ import annotations

import math
from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

import pytest
import trio

from strands_actors.contract.driver import Driver, GateState
from strands_actors.drivers.crazyflie import driver as driver_module
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie import wire as wire_module
from strands_actors.drivers.crazyflie.driver import Crazyflie
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.kernel.messages import Refused
from tests.drivers.without_gates import Row, assert_complete, checks, judge

from .virtual import LANDING, Flight, fly, take_off

PERIOD_S, SENT_S = 0.05, 1.0
"""Period of a stream of setpoints, and how long it lasts."""


class Bench:
    """The driver, and a drone in memory that hovers at half a metre, in virtual time."""

    def __init__(self, flight: Flight) -> None:
        self.driver: Driver = Crazyflie("crazyflie", "192.0.2.1", Crazyflie.resolve("crazyflie", {}))
        self.flight = flight
        self.firmware = flight.air.firmware

    async def state(self) -> GateState:
        now_ns = round(trio.current_time() * 1e9)
        observation = await self.flight.wire.read()
        return GateState(now_ns, observation, observation.position, now_ns, False)

    async def send(self, values: tuple[float, ...]) -> None:
        for _ in range(round(SENT_S / PERIOD_S)):
            await self.flight.wire.write(values, self.flight.permit)
            await trio.sleep(PERIOD_S)

    def fault(self) -> str:
        """Return why the supervisor lets no motor turn. Empty if motors may turn."""
        bits = self.firmware.bits
        if Bit.CAN_FLY in bits:
            return ""
        reasons = [bit.name or "" for bit in (Bit.LOCKED, Bit.CRASHED, Bit.TUMBLED) if bit in bits]
        return ", ".join(reasons) or "NOT ARMED"


async def lock(bench: Bench) -> None:
    bench.firmware.receive(p.EMERGENCY_STOP)
    await trio.sleep(1.0)


async def tip_over(bench: Bench) -> None:
    bench.firmware.body.tip_over()
    await trio.sleep(1.0)


async def empty(bench: Bench) -> None:
    bench.firmware.battery_v = 3.0
    await trio.sleep(0.3)


async def hover_for_long(bench: Bench) -> None:
    await trio.sleep(31.0)


async def land(bench: Bench) -> None:
    for packet in (LANDING, p.YIELD):
        bench.firmware.receive(packet)
    await trio.sleep(2.5)
    bench.firmware.receive(p.DISARM)
    await trio.sleep(0.5)


async def silent(bench: Bench) -> None:
    bench.flight.air.mute = lambda packet: packet[:1] == b"\x5e"
    await trio.sleep(0.6)


def at(height_m: float) -> Callable[[Bench], Awaitable[None]]:
    async def fly_there(bench: Bench) -> None:
        for _ in range(round(6.0 / PERIOD_S)):
            await bench.flight.wire.write((0.0, 0.0, 0.0, 0.0, height_m, 1.0), bench.flight.permit)
            await trio.sleep(PERIOD_S)

    return fly_there


SLOW = {"vx": 0.1}
NO_LIMIT = "the firmware has no limit for this: it only limits the tilt with which it reaches a speed"

ROWS: tuple[Row[Bench], ...] = (
    Row("_locked", SLOW, "LOCKED", prepare=lock, also=("_flying",)),
    Row("_upset", SLOW, "CRASHED", prepare=tip_over, also=("_flying",)),
    Row(
        "battery",
        SLOW,
        no_fault="the firmware reports low power, and flies on until the voltage breaks down",
        prepare=empty,
    ),
    Row("hovering", SLOW, no_fault="the firmware hovers for as long as setpoints come", prepare=hover_for_long),
    Row("_flying", {"z": 0.5}, "NOT ARMED", prepare=land),
    Row("stale", SLOW, no_fault="the drone does not know which report a setpoint is based on", prepare=silent),
    Row("past_range", {"vx": 1.5}, no_fault=NO_LIMIT),
    Row("past_range", {"z": 2.5}, no_fault=NO_LIMIT),
    Row("within_heights", {"vz": 0.3}, no_fault=NO_LIMIT, prepare=at(2.03)),
    Row(
        "within_heights",
        {"vz": -0.3},
        no_fault="the firmware knows no floor: the drone stands there with turning motors",
        prepare=at(0.03),
    ),
)
NO_ROW = {"too_fast"}
"""Gates that refuse nothing, because the axes have no limit for a step: they are speeds, and a height that the
drone itself approaches at a limited speed."""


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row.gate}-{'-'.join(row.action)}")
def test_saf_014_without_the_gate_the_drone_shows_its_own_fault(
    row: Row[Bench], monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        await judge(row, Bench(flight), monkeypatch)

    fly(script, monkeypatch)


def test_each_gate_has_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    driver = Crazyflie("crazyflie", "192.0.2.1", Crazyflie.resolve("crazyflie", {}))
    assert set(checks(driver)) >= NO_ROW and all(math.isinf(axis.speed) for axis in driver.table)
    gates = tuple(gate for gate in driver.gates if gate.__name__ not in NO_ROW)
    monkeypatch.setattr(driver, "gates", gates)
    assert_complete(driver, ROWS)


# -- the checks of a takeoff


class Takeoff(NamedTuple):
    """A takeoff that one check refuses.

    Attributes:
        code: The refusal.
        prepare: Brings the drone into the state in which it is refused.
        own: The drone's own answer: a part of the refusal that it leads to. Empty if it takes off.
        no_fault: Why it takes off. Either this or ``own`` is given.
    """

    code: str
    prepare: Callable[[Flight], Awaitable[None]]
    own: str = ""
    no_fault: str = ""


async def locked(flight: Flight) -> None:
    flight.air.firmware.receive(p.EMERGENCY_STOP)
    await trio.sleep(0.3)


async def on_its_back(flight: Flight) -> None:
    flight.air.firmware.body.tip_over()
    await trio.sleep(1.5)


async def crashed(flight: Flight) -> None:
    """Fly, tip over, and stand up again."""
    await take_off(flight)
    firmware = flight.air.firmware
    firmware.body.tip_over()
    await trio.sleep(1.5)
    firmware.body.stand_up()
    await trio.sleep(1.5)
    assert Bit.CRASHED in firmware.bits and Bit.TUMBLED not in firmware.bits


async def with_an_empty_battery(flight: Flight) -> None:
    flight.air.firmware.battery_v = 3.0
    await trio.sleep(0.3)


async def tilted(flight: Flight) -> None:
    """Put the drone on a slope, which holds it."""
    firmware = flight.air.firmware
    half_rad = math.radians(20.0) / 2
    step = firmware.body.step

    def slope() -> None:
        if not firmware.motors_on:
            firmware.body.data.qpos[3:7] = (math.cos(half_rad), math.sin(half_rad), 0.0, 0.0)
            firmware.body.data.qvel[:] = 0.0
        step()

    firmware.body.step = slope  # type: ignore[method-assign]
    await trio.sleep(0.3)


NOT_CONFIRMED = "did not confirm arming"
TAKEOFFS = (
    Takeoff("locked", locked, NOT_CONFIRMED),
    Takeoff("tumbled", on_its_back, NOT_CONFIRMED),
    Takeoff("tumbled", crashed, NOT_CONFIRMED),
    Takeoff("battery", with_an_empty_battery, no_fault="the firmware arms with any voltage"),
    Takeoff("tilted", tilted, no_fault="the firmware arms up to a tilt of 60 degrees"),
)


@pytest.mark.parametrize("case", TAKEOFFS, ids=lambda case: case.prepare.__name__)
def test_saf_014_without_the_check_of_a_takeoff_the_drone_answers_itself(
    case: Takeoff, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(flight: Flight) -> None:
        await case.prepare(flight)
        refused = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(refused, Refused) and refused.code == case.code, refused
        sent = len(flight.setpoints())
        monkeypatch.setattr(wire_module, "takeoff_refusal", lambda *_: None)
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert bool(case.own) != bool(case.no_fault), "a row names the drone's answer, or why there is none"
        if case.own:
            assert isinstance(answer, Refused) and case.own in answer.text, answer
            assert set(flight.setpoints()[sent:]) <= {p.STOP} and not flight.air.firmware.motors_on
        else:
            assert not isinstance(answer, Refused), answer
            assert flight.height_m == pytest.approx(0.5, abs=0.06)

    fly(script, monkeypatch)


@pytest.mark.parametrize(("service", "arguments"), [("takeoff", {"height": 2.5}), ("takeoff", {"duration": 0.1})])
def test_saf_014_without_the_ranges_of_its_arguments_the_drone_flies_as_told(
    service: str, arguments: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The firmware has no limit for a height or a duration."""
    driver = Crazyflie("crazyflie", "192.0.2.1", Crazyflie.resolve("crazyflie", {}))
    assert driver.check_service(service, arguments) is not None
    monkeypatch.setattr(driver_module, "SERVICE_RANGES", {})
    assert driver.check_service(service, arguments) is None

    async def script(flight: Flight) -> None:
        answer = await flight.wire.perform(service, arguments, flight.permit)
        assert not isinstance(answer, Refused), answer
        assert flight.height_m == pytest.approx(arguments.get("height", 0.5), abs=0.06)

    fly(script, monkeypatch)
