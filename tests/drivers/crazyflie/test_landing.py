"""Test that the drone is on the floor before a motor is cut, from any height and with any packets
lost. The tests run on a firmware in memory."""

from __future__ import annotations

import struct

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.config import LANDING_M_S
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.session import CrazyflieSession
from strands_actors.drivers.crazyflie.stopping import bring_down
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.kernel.messages import Refused

from .virtual import LANDING, Air, Flight, VirtualClock, fly, take_off


@pytest.mark.parametrize("height_m", [0.3, 1.0, 2.0])
def test_saf_005_from_any_height_motors_are_cut_on_the_floor(
    monkeypatch: pytest.MonkeyPatch, height_m: float
) -> None:
    async def script(flight: Flight) -> None:
        answer = await flight.wire.perform("takeoff", {"height": height_m, "duration": 0.5}, flight.permit)
        assert not isinstance(answer, Refused) and answer["duration"] == pytest.approx(2 * height_m, abs=0.02)
        assert max(climb for _, climb in flight.track) < 0.6, "the drone sinks no faster than a command allows"
        cut_at_m = flight.heights_of(p.STOP)
        began_s = trio.current_time()
        reports = await flight.wire.make_safe("land")
        assert all(report.safe for report in reports)
        assert max(cut_at_m) < 0.1
        assert trio.current_time() - began_s < height_m / LANDING_M_S + 1.0, (
            "the stop does not wait longer than the landing"
        )
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_002_a_hover_ends_with_the_order_to_land(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        reports = await flight.wire.make_safe("land")
        assert all(report.safe for report in reports)
        order = flight.air.sent.index(LANDING)
        later = [packet for packet in flight.air.sent[order:] if packet[:1] == b"\x7c"]
        assert set(later) == {p.STOP}
        assert abs(flight.height_m) < 0.02
        with pytest.raises(PermitDenied):
            await flight.wire.write((0.1, 0.0, 0.0, 0.0, 0.5, 1.0), flight.permit)
        assert isinstance(await flight.wire.perform("takeoff", {}, flight.permit), Refused)

    fly(script, monkeypatch)


def test_a_landing_service_is_no_faster_than_a_landing_may_be(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        for height_m, asked_s, takes_s in ((1.0, 0.5, 2.5), (0.5, 4.0, 4.0)):
            await flight.wire.perform("takeoff", {"height": height_m}, flight.permit)
            cut_at_m = flight.heights_of(p.STOP)
            answer = await flight.wire.perform("land", {"duration": asked_s}, flight.permit)
            assert answer == {"landed": True, "duration": pytest.approx(takes_s, abs=0.2)}
            assert max(cut_at_m) < 0.1
        flight.never_fell()

    fly(script, monkeypatch)


def test_a_landing_with_unknown_height_is_not_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.air.mute = lambda packet: packet[:1] == b"\x5e"  # rows of the log are lost; answers arrive
        await trio.sleep(0.6)
        cut_at_m = flight.heights_of(p.STOP)
        answer = await flight.wire.perform("land", {"duration": 0.5}, flight.permit)
        assert answer == {"landed": True, "velocity": LANDING_M_S}
        assert LANDING in flight.air.sent and max(cut_at_m) < 0.02, "the motors are cut only on the floor"
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_005_an_end_of_trajectory_from_before_cuts_no_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    """The order to land is lost, and the supervisor still reports the end of an earlier trajectory."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        assert Bit.TRAJECTORY_FINISHED in flight.air.firmware.bits
        cut_at_m: list[float] = []

        def lose(packet: bytes) -> bool:
            if packet in (p.STOP, p.DISARM):
                cut_at_m.append(flight.height_m)
            return packet[:1] == b"\x8c" or packet == p.YIELD

        flight.air.lose = lose
        await flight.wire.make_safe("land")
        assert cut_at_m, "in the end the drone's watchdog has cut the motors"
        assert max(cut_at_m) < 0.02, "no motor was cut in the air"

    fly(script, monkeypatch)


def test_a_lost_yield_is_sent_again(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        lost: list[bytes] = []

        def lose(packet: bytes) -> bool:
            if packet == p.YIELD and not lost:
                lost.append(packet)
                return True
            return False

        flight.air.lose = lose
        assert all(report.safe for report in await flight.wire.make_safe("land"))
        assert flight.air.sent.count(p.YIELD) >= 2
        flight.never_fell()

    fly(script, monkeypatch)


@pytest.mark.parametrize("lost", [1, 2])
def test_saf_005_a_lost_order_to_land_cuts_no_motor_by_a_yield(monkeypatch: pytest.MonkeyPatch, lost: int) -> None:
    """A drone that is ordered to yield without a plan switches its motors off."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        orders: list[bytes] = []

        def lose(packet: bytes) -> bool:
            orders.append(packet)
            return packet == LANDING and orders.count(LANDING) <= lost

        flight.air.lose = lose
        assert all(report.safe for report in await flight.wire.make_safe("land"))
        assert orders.count(LANDING) > lost
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_005_a_drone_with_a_link_in_one_direction_is_landed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.air.silent = True

        async def look() -> None:
            await trio.sleep(1.7)
            assert flight.height_m < 0.05, "the drone has landed before its watchdog would cut the motors"

        async with trio.open_nursery() as nursery:
            nursery.start_soon(look)
            assert not any(report.safe for report in await flight.wire.make_safe("land"))
        assert abs(flight.height_m) < 0.02
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_005_a_drone_that_answers_late_is_landed_and_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    """The answer comes later than the order to yield."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        async with trio.open_nursery() as nursery:
            flight.air.delays, flight.air.delay_s = nursery, 0.4
            cut_at_m = flight.heights_of(p.STOP)
            assert all(report.safe for report in await flight.wire.make_safe("land"))
            assert max(cut_at_m) < 0.1
            flight.air.delays = None
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_005_a_refused_landing_does_not_count_and_is_sent_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The drone hovers by the high-level commander, with its trajectory over."""

    async def script(flight: Flight) -> None:
        firmware, air = flight.air.firmware, flight.air
        flight.feeds = False
        for packet in (p.ARM, p.encode(8, 0, b"\7\0" + struct.pack("<ff?f", 1.0, 0.0, True, 2.0))):
            firmware.receive(packet)
            await trio.sleep(0.2)
        await trio.sleep(2.5)
        assert Bit.TRAJECTORY_FINISHED in firmware.bits and flight.height_m > 0.9

        def refuse(packet: bytes) -> bool:
            if packet == LANDING:
                air.say(packet[:4] + b"\x08")
            return packet == LANDING

        air.lose = refuse
        outcome = await bring_down(flight.wire.session, "land", 2.0)
        assert "refuses to land" in outcome.detail
        assert air.sent.count(LANDING) > 5
        assert p.STOP not in air.sent and p.DISARM not in air.sent and flight.height_m > 0.9
        air.lose = lambda packet: False
        assert all(report.safe for report in await flight.wire.make_safe("land"))
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_005_a_drone_that_lands_already_counts_as_ordered(monkeypatch: pytest.MonkeyPatch) -> None:
    """The root finds a drone in this state after a wire process was killed half-way."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.feeds = False
        for packet in (LANDING, p.YIELD):
            flight.air.firmware.receive(packet)
        await trio.sleep(0.5)
        assert flight.air.firmware.receive(LANDING).replies[0][-1] == 1
        cut_at_m = flight.heights_of(p.STOP)
        landing = flight.air.firmware.planner.flight
        assert all(report.safe for report in await flight.wire.make_safe("land"))
        assert flight.air.firmware.planner.flight is landing, "the first landing is flown to its end"
        assert max(cut_at_m) < 0.1
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_002_a_setpoint_that_comes_late_does_not_end_a_landing(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)

        async def late() -> None:
            await trio.sleep(0.5)
            flight.air.firmware.receive(p.hover(0.3, 0.0, 0.0, 0.5))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(late)
            assert all(report.safe for report in await flight.wire.make_safe("land"))
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_002_a_setpoint_that_comes_late_to_a_drone_that_is_not_heard_cuts_no_motor(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.feeds = False

        async def late() -> None:
            await trio.sleep(0.4)
            flight.air.silent = True
            flight.air.firmware.receive(p.hover(0.0, 0.0, 0.0, 0.5))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(late)
            assert not all(report.safe for report in await flight.wire.make_safe("land"))
        assert abs(flight.height_m) < 0.02
        flight.never_fell()

    fly(script, monkeypatch)


def test_saf_006_an_estop_during_a_landings_request_gets_its_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        landing = trio.CancelScope()

        async def land() -> None:
            with landing:
                await flight.wire.perform("land", {}, flight.permit)

        async with trio.open_nursery() as nursery:
            flight.air.delays, flight.air.delay_s = nursery, 0.06
            nursery.start_soon(land)
            await trio.sleep(0.08)
            assert flight.air.sent[-1] == p.SUPERVISOR_QUESTION.packet
            landing.cancel()  # as the tree does: the stop asks before the cancelled call has ended
            reports = await flight.wire.make_safe("off")
            flight.air.delays = None
        assert all(report.safe for report in reports)
        assert p.EMERGENCY_STOP in flight.air.sent and flight.air.firmware.locked

    fly(script, monkeypatch)


@pytest.mark.parametrize(("outlives_a_loss", "within_s"), [(True, 10.0), (False, 0.1)])
def test_bringing_down_never_raises_and_ends_in_time(outlives_a_loss: bool, within_s: float) -> None:
    """A link that may work again is tried for as long as a landing takes. Any other is given up."""

    class Dead(Air):
        async def write(self, packet: bytes, permit: object = None) -> None:
            raise WireDown("the cable is out")

    async def main() -> None:
        air = Dead(Firmware(TABLES.table("crazyflie"), trio.current_time))
        air.outlives_a_loss = outlives_a_loss
        began_s = trio.current_time()
        outcome = await bring_down(CrazyflieSession(air, VirtualClock()), "land")  # type: ignore[arg-type]
        assert outcome == (False, False, "not confirmed: the cable is out")
        assert trio.current_time() - began_s < within_s

    trio.run(main, clock=MockClock(autojump_threshold=0))
