"""The wire on a firmware in memory: what it sends, when it is fed, and what it is told by whom."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Sequence

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie import wire as wire_module
from strands_actors.drivers.crazyflie.config import CrazyflieConfig, Endpoint
from strands_actors.drivers.crazyflie.links import Link
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.session import Session
from strands_actors.drivers.crazyflie.stopping import bring_down
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.drivers.crazyflie.wire import CrazyflieWire
from strands_actors.kernel.messages import Refused

CONFIG = CrazyflieConfig("crazyflie", "192.0.2.1", 20.0, (0.05, 2.0), 3.2)


class VirtualClock:
    """The loop's own time."""

    def now_ns(self) -> int:
        return round(trio.current_time() * 1e9)


class Allowed:
    def __init__(self) -> None:
        self.denied = ""

    def check(self) -> None:
        if self.denied:
            raise PermitDenied(self.denied)


class Air(Link):
    """A firmware at the other end. ``lose``: which of our packets do not arrive."""

    def __init__(self, firmware: Firmware) -> None:
        self.name = "memory"
        self.firmware = firmware
        self.sent: list[bytes] = []
        self.lose: Callable[[bytes], bool] = lambda packet: False
        self.silent = False
        self._send, self._receive = trio.open_memory_channel[bytes](10000)

    async def write(self, packet: bytes, permit: object = None) -> None:
        if permit is not None:
            permit.check()  # type: ignore[attr-defined]
        self.sent.append(packet)
        if not self.lose(packet):
            self.say(*self.firmware.hear(packet).replies)

    def say(self, *packets: bytes) -> None:
        for packet in packets:
            if not self.silent:
                self._send.send_nowait(packet)

    async def read(self) -> bytes:
        return await self._receive.receive()

    def read_waiting(self) -> bytes | None:
        try:
            return self._receive.receive_nowait()
        except trio.WouldBlock:
            return None

    def handover(self) -> Sequence[int]:
        return ()

    def close(self) -> None:
        pass


class Flight:
    """A wire that is open and armed, in virtual time; its watchdog feeds it."""

    def __init__(self, air: Air, wire: CrazyflieWire) -> None:
        self.air = air
        self.wire = wire
        self.permit = Allowed()
        self.feeds = True

    async def live(self) -> None:
        """Time passes for the robot, and the tree turns twenty times a second."""
        while True:
            await trio.sleep(0.05)
            self.air.firmware.pass_time()
            self.air.say(*self.air.firmware.rows())
            if self.feeds:
                try:
                    await self.wire.feed()
                    await self.wire.read()
                except WireDown:
                    self.feeds = False

    @property
    def height_m(self) -> float:
        return self.air.firmware.body.xyz_m[2]

    def setpoints(self) -> list[bytes]:
        return [packet for packet in self.air.sent if packet[:1] == b"\x7c"]


def fly(
    script: Callable[[Flight], Awaitable[None]], monkeypatch: pytest.MonkeyPatch, *, auto_arm: bool = False
) -> None:
    async def main() -> None:
        firmware = Firmware(TABLES.table("crazyflie"), trio.current_time, auto_arm=auto_arm)
        air = Air(firmware)

        async def open_link(endpoint: Endpoint) -> Link:
            return air

        monkeypatch.setattr(wire_module, "open_link", open_link)
        wire = CrazyflieWire(CONFIG, VirtualClock())  # type: ignore[arg-type]
        flight = Flight(air, wire)
        flight.feeds = False
        async with trio.open_nursery() as nursery:
            nursery.start_soon(flight.live)
            await wire.open()
            await nursery.start(wire.serve)
            await wire.arm(flight.permit)
            flight.feeds = True
            await script(flight)
            nursery.cancel_scope.cancel()

    trio.run(main, clock=MockClock(autojump_threshold=0))


async def take_off(flight: Flight) -> None:
    answer = await flight.wire.perform("takeoff", {}, flight.permit)
    assert not isinstance(answer, Refused), answer


def test_saf_004_without_a_feed_nothing_is_repeated_and_the_firmware_takes_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.feeds = False
        sent = len(flight.setpoints())
        await trio.sleep(3.0)
        assert len(flight.setpoints()) == sent, "the wire repeats nothing by itself"
        assert abs(flight.height_m) < 0.02, "level, then motors off"

    fly(script, monkeypatch)


def test_a_takeoff_is_flown_by_setpoints_under_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        assert len(flight.setpoints()) > 30, "each of them fed"
        assert not any(packet[:1] == b"\x8c" for packet in flight.air.sent), "not by the high-level commander"

    fly(script, monkeypatch)


def test_a_takeoff_that_loses_its_feed_comes_down(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(flight.wire.perform, "takeoff", {"height": 1.0}, flight.permit)
            await trio.sleep(1.0)
            flight.feeds = False
            assert flight.height_m > 0.2
            nursery.cancel_scope.cancel()
        await trio.sleep(3.0)
        assert abs(flight.height_m) < 0.02

    fly(script, monkeypatch)


def test_saf_002_a_hover_ends_with_the_order_to_land(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        reports = await flight.wire.make_safe("land")
        assert all(report.safe for report in reports)
        order = next(at for at, packet in enumerate(flight.air.sent) if packet == p.land(2.0))
        later = [packet for packet in flight.air.sent[order:] if packet[:1] == b"\x7c"]
        assert set(later) == {p.STOP}
        assert abs(flight.height_m) < 0.02
        with pytest.raises(PermitDenied):
            await flight.wire.write((0.1, 0.0, 0.0, 0.0, 0.5, 1.0), flight.permit)
        assert isinstance(await flight.wire.perform("takeoff", {}, flight.permit), Refused)

    fly(script, monkeypatch)


def test_saf_005_an_end_of_trajectory_from_before_cuts_no_motor(monkeypatch: pytest.MonkeyPatch) -> None:
    """The order to land is lost, and the supervisor still says that some trajectory is over."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.air.firmware._finished = True
        cut_at_m: list[float] = []

        def lose(packet: bytes) -> bool:
            if packet in (p.STOP, p.DISARM):
                cut_at_m.append(flight.height_m)
            return packet[:1] == b"\x8c" or packet == p.YIELD

        flight.air.lose = lose
        await flight.wire.make_safe("land")
        assert cut_at_m, "in the end its own watchdog has brought it down"
        assert max(cut_at_m) < 0.02, "no motor was cut in the air"

    fly(script, monkeypatch)


def test_a_lost_yield_is_said_again(monkeypatch: pytest.MonkeyPatch) -> None:
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

    fly(script, monkeypatch)


def test_a_drone_that_arms_by_itself_is_confirmed_when_it_flies_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        assert all(report.safe for report in await flight.wire.make_safe("land"))

    fly(script, monkeypatch, auto_arm=True)


@pytest.mark.parametrize("safe_state", ["limp", "off"])
def test_motors_off_and_locked(monkeypatch: pytest.MonkeyPatch, safe_state: str) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        before = len(flight.air.sent)
        reports = await flight.wire.make_safe(safe_state)
        assert all(report.safe for report in reports)
        assert flight.air.sent[before] == p.STOP, "at once"
        assert (Bit.LOCKED in flight.air.firmware.bits) is (safe_state == "off")
        await trio.sleep(1.0)
        assert abs(flight.height_m) < 0.02

    fly(script, monkeypatch)


def test_saf_019_a_hold_starts_no_motor_on_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.firmware.armed = True
        await flight.wire.make_safe("hold")
        assert not flight.wire.hold_failed, "what lies there holds"
        await trio.sleep(1.0)
        assert not any(packet[:2] == b"\x7c\x0a" for packet in flight.air.sent)

    fly(script, monkeypatch)


def test_saf_002_a_drone_that_is_not_heard_lands_and_takes_no_setpoint_after_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        monkeypatch.setattr(flight.air, "say", lambda *rows: None)
        await trio.sleep(0.6)
        await flight.wire.make_safe("hold")
        assert flight.wire.hold_failed
        with pytest.raises(PermitDenied, match="made safe since"):
            await flight.wire.write((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), flight.permit)

    fly(script, monkeypatch)


def test_a_hover_that_fell_is_not_fed_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.air.firmware.armed = False  # as its supervisor may decide
        await trio.sleep(1.0)
        sent = len(flight.setpoints())
        await trio.sleep(1.0)
        assert len(flight.setpoints()) == sent

    fly(script, monkeypatch)


def test_arming_not_confirmed_leaves_the_motors_off(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.lose = lambda packet: packet == p.ARM
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(answer, Refused) and "motors stay off" in answer.text
        assert flight.air.sent[-1] == p.DISARM
        assert not any(packet[:2] == b"\x7c\x0a" for packet in flight.air.sent)

    fly(script, monkeypatch)


def test_saf_009_a_stop_that_waits_lets_nothing_take_off(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.permit.denied = "a stop is waiting"
        with pytest.raises(PermitDenied):
            await flight.wire.perform("takeoff", {}, flight.permit)
        assert p.ARM not in flight.air.sent

    fly(script, monkeypatch)


def test_saf_012_a_silent_drone_is_a_lost_link(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.silent = True
        await trio.sleep(1.5)
        with pytest.raises(WireDown, match="silent"):
            await flight.wire.read()
        assert not any(report.safe for report in await flight.wire.make_safe("land"))

    fly(script, monkeypatch)


def test_a_wire_that_is_armed_finds_it_on_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        with pytest.raises(WireDown, match="in the air"):
            await flight.wire.arm(flight.permit)
        await flight.wire.make_safe("off")
        with pytest.raises(WireDown, match="Switch it off and on"):
            await flight.wire.arm(flight.permit)

    fly(script, monkeypatch)


def test_bringing_down_never_raises_and_ends_in_time() -> None:
    class Dead(Air):
        async def write(self, packet: bytes, permit: object = None) -> None:
            raise WireDown("the cable is out")

    async def main() -> None:
        air = Dead(Firmware(TABLES.table("crazyflie"), trio.current_time))
        began_s = trio.current_time()
        outcome = await bring_down(Session(air, VirtualClock()), "land")  # type: ignore[arg-type]
        assert outcome == (False, False, "the cable is out")
        assert trio.current_time() - began_s < 6.0

    trio.run(main, clock=MockClock(autojump_threshold=0))
