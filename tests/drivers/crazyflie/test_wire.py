"""Test the wire on a firmware in memory: its packets, its feed, and which rows it accepts."""

from __future__ import annotations

import pytest
import trio
from trio.testing import MockClock

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.crazyflie import protocol as p
from strands_actors.drivers.crazyflie.protocol import Bit
from strands_actors.drivers.crazyflie.robots import TABLES
from strands_actors.drivers.crazyflie.session import CrazyflieSession, handshake
from strands_actors.drivers.crazyflie.twin.firmware import Firmware
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .virtual import Air, Flight, VirtualClock, fly, take_off


def test_saf_004_without_a_feed_nothing_is_repeated_and_the_firmware_takes_over(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.feeds = False
        sent = len(flight.setpoints())
        await trio.sleep(3.0)
        assert len(flight.setpoints()) == sent, "the wire repeats nothing by itself"
        assert abs(flight.height_m) < 0.02, "the drone is level, then its motors are off"

    fly(script, monkeypatch)


def test_a_takeoff_is_flown_by_setpoints_under_the_watchdog(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        assert len(flight.setpoints()) > 30, "each tick of the watchdog re-sends the setpoint"
        assert not any(packet[:1] == b"\x8c" for packet in flight.air.sent), "the high-level commander is not used"

    fly(script, monkeypatch)


def test_a_takeoff_that_loses_its_feed_comes_down(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        async with trio.open_nursery() as nursery:
            nursery.start_soon(flight.wire.perform, "takeoff", {"height": 1.0}, flight.permit)
            await trio.sleep(1.3)
            flight.feeds = False
            assert flight.height_m > 0.2
            nursery.cancel_scope.cancel()
        await trio.sleep(3.0)
        assert abs(flight.height_m) < 0.02

    fly(script, monkeypatch)


@pytest.mark.parametrize("delay_s", [0.1, 0.3, 0.45])
def test_saf_005_a_row_from_before_a_takeoff_drops_no_hover_in_the_air(
    monkeypatch: pytest.MonkeyPatch, delay_s: float
) -> None:
    """It rises faster than its rows arrive. The row that is read when it is up still shows the floor; on the
    second takeoff it shows the landing."""

    async def script(flight: Flight) -> None:
        notes: list[str] = []
        monkeypatch.setattr(flight.air.firmware, "_note", notes.append)
        async with trio.open_nursery() as nursery:
            flight.air.delays, flight.air.delay_s = nursery, delay_s
            await trio.sleep(1.0)
            for _ in range(2):
                answer = await flight.wire.perform("takeoff", {"height": 0.2, "duration": 0.5}, flight.permit)
                assert not isinstance(answer, Refused), answer
                assert flight.height_m > 0.15
                answer = await flight.wire.perform("land", {"duration": 0.5}, flight.permit)
                assert not isinstance(answer, Refused), answer
            flight.air.delays = None
        assert notes == [], "the drone's watchdog did not act"
        flight.never_fell()

    fly(script, monkeypatch)


def test_a_hover_that_never_rose_is_not_re_sent_and_not_reported_as_landed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        fed_s: list[float] = []

        def lose(packet: bytes) -> bool:
            is_hover = packet[:2] == b"\x7c\x0a"
            if is_hover:
                fed_s.append(trio.current_time())
            return is_hover

        flight.air.lose = lose
        answer = await flight.wire.perform("takeoff", {"height": 0.2, "duration": 0.5}, flight.permit)
        assert isinstance(answer, Refused) and "the drone does not fly" in answer.text
        assert fed_s[-1] - fed_s[0] < 0.5 + 0.3

    fly(script, monkeypatch)


def test_two_equal_requests_are_both_answered() -> None:
    async def main() -> None:
        air = Air(Firmware(TABLES.table("crazyflie"), trio.current_time))
        session = CrazyflieSession(air, VirtualClock())  # type: ignore[arg-type]
        answers: list[Bit | None] = []

        async def ask(within_s: float) -> None:
            answers.append(await session.supervisor(within_s))

        async with trio.open_nursery() as nursery:
            await nursery.start(_serve, session)
            air.silent = True
            for within_s in (0.1, 2.0, 3.0):
                nursery.start_soon(ask, within_s)
            await trio.sleep(0.2)
            assert answers == [None], "only the waiting call gets the answer"
            air.silent = False
            await trio.sleep(0.3)
            assert answers == [None, *2 * (Bit.CAN_BE_ARMED | Bit.TRAJECTORY_FINISHED,)]
            nursery.cancel_scope.cancel()

    trio.run(main, clock=MockClock(autojump_threshold=0))


async def _serve(session: CrazyflieSession, task_status: trio.TaskStatus[None]) -> None:
    task_status.started()
    await session.serve()


def test_saf_012_an_unknown_battery_prevents_a_takeoff(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.mute = lambda packet: packet[:2] == b"\x5e\x02"
        await trio.sleep(2.5)
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(answer, Refused) and answer.code == "battery" and "reported its battery" in answer.text
        assert p.ARM not in flight.air.sent

    fly(script, monkeypatch)


def test_saf_012_an_unknown_height_prevents_a_takeoff(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.mute = lambda packet: packet[:2] == b"\x5e\x01"
        await trio.sleep(0.7)
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(answer, Refused) and answer.code == "stale"
        assert p.ARM not in flight.air.sent

    fly(script, monkeypatch)


def test_saf_012_a_log_that_repeats_its_rows_is_stale_and_then_a_lost_link(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        say, stuck = flight.air.say, dict[bytes, bytes]()

        def repeat(*packets: bytes) -> None:
            say(*(stuck.setdefault(one[:2], one) if one[:1] == b"\x5e" else one for one in packets))

        monkeypatch.setattr(flight.air, "say", repeat)
        await trio.sleep(0.7)
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(answer, Refused) and answer.code == "stale"
        await trio.sleep(0.7)
        with pytest.raises(WireDown, match="repeats one report"):
            await flight.wire.read()

    fly(script, monkeypatch)


def test_saf_012_a_row_that_comes_late_is_no_reading_and_the_robots_clock_may_wrap() -> None:
    def row(stamp_ms: int, z_m: float) -> bytes:
        values = p.FLIGHT.layout.pack(z_m, *6 * (0.0,), 0)
        return p.encode(p.Port.LOG, 2, bytes((p.FLIGHT.number,)) + stamp_ms.to_bytes(3, "little") + values)

    async def main() -> None:
        session = CrazyflieSession(Air(Firmware(TABLES.table("crazyflie"), trio.current_time)), VirtualClock())  # type: ignore[arg-type]

        async def heard(stamp_ms: int, z_m: float) -> tuple[float, float]:
            """Return the accepted height and its age, a tenth of a second later."""
            await trio.sleep(0.1)
            session.link.say(row(stamp_ms, z_m))  # type: ignore[attr-defined]
            session.take_waiting()
            assert session.flight is not None
            return session.flight.z_m, round(session.age_s(), 3)

        last_ms = p.STAMP_WRAP_MS - 1
        assert await heard(last_ms, 0.25) == (0.25, 0.0)
        assert await heard(last_ms - 50, 0.5) == (0.25, 0.1)
        assert await heard(last_ms, 0.25) == (0.25, 0.2)
        assert await heard(49, 0.75) == (0.75, 0.0)
        assert await heard(last_ms, 0.25) == (0.75, 0.1)

    trio.run(main, clock=MockClock(autojump_threshold=0))


def test_saf_012_connecting_waits_for_rows_that_go_on() -> None:
    async def main() -> None:
        firmware = Firmware(TABLES.table("crazyflie"), trio.current_time)
        air = Air(firmware)
        stuck: dict[bytes, bytes] = {}

        async def live() -> None:
            while True:
                await trio.sleep(0.05)
                firmware.pass_time()
                air.say(*(stuck.setdefault(row[:2], row) for row in firmware.reports()))

        async with trio.open_nursery() as nursery:
            nursery.start_soon(live)
            with pytest.raises(WireDown, match="no log data arrives"):
                await handshake(CrazyflieSession(air, VirtualClock()), 0.05)  # type: ignore[arg-type]
            nursery.cancel_scope.cancel()

    trio.run(main, clock=MockClock(autojump_threshold=0))


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
        assert flight.air.sent[before] == p.STOP, "the stop is sent at once"
        assert (Bit.LOCKED in flight.air.firmware.bits) is (safe_state == "off")
        await trio.sleep(1.0)
        assert abs(flight.height_m) < 0.02

    fly(script, monkeypatch)


def test_saf_019_a_hold_starts_no_motor_on_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        flight.air.firmware.supervisor.armed = True
        await flight.wire.make_safe("hold")
        assert not flight.wire.hold_failed, "a drone on the floor counts as held"
        await trio.sleep(1.0)
        assert not any(packet[:2] == b"\x7c\x0a" for packet in flight.air.sent)

    fly(script, monkeypatch)


def test_saf_002_a_silent_drone_lands_and_gets_no_setpoint_after_that(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        monkeypatch.setattr(flight.air, "say", lambda *rows: None)
        await trio.sleep(0.6)
        await flight.wire.make_safe("hold")
        assert flight.wire.hold_failed
        with pytest.raises(PermitDenied, match="stopped in the meantime"):
            await flight.wire.write((0.1, 0.0, 0.0, 0.0, 0.0, 0.0), flight.permit)

    fly(script, monkeypatch)


def test_a_hover_that_fell_is_not_fed_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        await take_off(flight)
        flight.air.firmware.supervisor.armed = False  # as its supervisor may decide
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


def test_saf_009_a_waiting_stop_prevents_a_takeoff(monkeypatch: pytest.MonkeyPatch) -> None:
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


# -- spinning up, and arming again


@pytest.mark.parametrize("spin_up_s", [0.0, 0.5, 1.8])
def test_a_rise_begins_after_the_motors_have_spun_up(monkeypatch: pytest.MonkeyPatch, spin_up_s: float) -> None:
    """A rise that began earlier would begin with a jump, to the height that the setpoint has by then."""

    async def script(flight: Flight) -> None:
        hovers: list[Bit] = []

        def note(packet: bytes) -> bool:
            if packet[:2] == b"\x7c\x0a":
                hovers.append(flight.air.firmware.bits)
            return False

        flight.air.lose = note
        began_s = trio.current_time()
        answer = await flight.wire.perform("takeoff", {"height": 1.0, "duration": 2.0}, flight.permit)
        assert not isinstance(answer, Refused), answer
        assert hovers and all(Bit.CAN_FLY in bits for bits in hovers)
        assert trio.current_time() - began_s > spin_up_s + 2.0
        assert max(speed for _, speed in flight.track) < 0.6

    fly(script, monkeypatch, spin_up_s=spin_up_s)


def test_motors_that_do_not_spin_up_are_disarmed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        answer = await flight.wire.perform("takeoff", {}, flight.permit)
        assert isinstance(answer, Refused) and answer.code is Code.NOT_ARMED and "did not spin up" in answer.text
        assert flight.air.sent[-3:] == [p.STOP, p.YIELD, p.DISARM]
        assert not any(packet[:2] == b"\x7c\x0a" for packet in flight.air.sent)
        assert Bit.ARMED not in flight.air.firmware.bits and abs(flight.height_m) < 0.02

    fly(script, monkeypatch, spin_up_s=10.0)


def test_saf_009_a_stop_while_motors_spin_up_prevents_the_takeoff(monkeypatch: pytest.MonkeyPatch) -> None:
    async def script(flight: Flight) -> None:
        async with trio.open_nursery() as nursery:

            async def take_off_in_vain() -> None:
                with pytest.raises(PermitDenied):
                    await flight.wire.perform("takeoff", {}, flight.permit)

            nursery.start_soon(take_off_in_vain)
            await trio.sleep(0.5)
            flight.permit.denied = "a stop is waiting"
        assert not any(packet[:2] == b"\x7c\x0a" for packet in flight.air.sent)

    fly(script, monkeypatch, spin_up_s=1.5)


def test_a_drone_that_was_just_disarmed_takes_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The firmware checks a drone that was disarmed, and refuses to arm it until it has."""

    async def script(flight: Flight) -> None:
        firmware = flight.air.firmware
        firmware.receive(p.ARM)
        await trio.sleep(0.2)
        firmware.receive(p.DISARM)
        while Bit.ARMED in firmware.bits:
            await trio.sleep(0.01)
            firmware.pass_time()
        assert Bit.CAN_BE_ARMED not in firmware.bits
        await take_off(flight)

    fly(script, monkeypatch)


@pytest.mark.parametrize("safe_state", ["limp", "land"])
def test_a_drone_that_was_stopped_is_not_locked_later(monkeypatch: pytest.MonkeyPatch, safe_state: str) -> None:
    """The firmware ages the setpoint that switches motors off. Alone, it would lock the drone when it is armed."""

    async def script(flight: Flight) -> None:
        await take_off(flight)
        assert all(report.safe for report in await flight.wire.make_safe(safe_state))
        await trio.sleep(4.0)
        assert Bit.CAN_BE_ARMED in flight.air.firmware.bits
        flight.air.firmware.receive(p.ARM)
        await trio.sleep(1.0)
        assert Bit.CAN_FLY in flight.air.firmware.bits
        await flight.wire.arm(flight.permit)
        await take_off(flight)

    fly(script, monkeypatch)
