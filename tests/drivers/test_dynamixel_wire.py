"""The Dynamixel wire against the twin: its servos in memory under virtual time, then its process on a pty."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Awaitable, Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
import trio
from memory_port import MemoryPort, servos
from trio.testing import MockClock

from strands_actors.drivers.common.half_duplex import QUIET_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.dynamixel import protocol, table, watchdog
from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.drivers.dynamixel.twin import DynamixelBus
from strands_actors.drivers.dynamixel.wire import DynamixelWire
from strands_actors.runtime.clock import MonotonicClock, VirtualClock
from strands_actors.runtime.contract import MotorReport, Observation, PermitDenied, WireDown
from strands_actors.testing.twin import Twin

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
VICTIM = 3  # elbow_flex
MOVED = (20.0, -10.0, 15.0, 10.0, -20.0, 40.0)


class Permission:
    """Denies from check number ``denied_at`` on, and notes how much had been written at each check."""

    def __init__(self, port: MemoryPort | None = None, denied_at: int | None = None) -> None:
        self.checks = 0
        self.written_before: list[int] = []
        self._port = port
        self._denied_at = denied_at

    def check(self) -> None:
        if self._port is not None:
            self.written_before.append(len(self._port.written))
        if self.checks == self._denied_at:
            raise PermitDenied
        self.checks += 1


class Rig:
    """A wire on the twin's servos, in memory."""

    def __init__(self, **options: Any) -> None:
        self.bus = DynamixelBus.for_robot("koch", now_s=trio.current_time)
        self.port = MemoryPort(servos(self.bus))
        self.driver = Dynamixel("koch", "memory", Dynamixel.resolve("koch", options))
        self.clock = VirtualClock()
        self.wire = DynamixelWire(self.driver, self.clock, lambda path, baud: self.port)

    async def armed(self) -> Rig:
        await self.wire.open()
        await self.wire.arm(Permission())
        self.port.written.clear()
        return self

    def servo(self, motor: int = VICTIM) -> Any:
        return next(servo for servo in self.bus.servos if servo.id == motor)

    def filter(self, passes: Callable[[protocol.Packet], bool]) -> None:
        """Requests that do not pass are lost on the way to the servos."""
        inner, decoder = self.port.peer, protocol.Decoder()

        def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
            for packet in decoder.feed(data):
                if passes(packet):
                    yield from inner(protocol.frame(*packet))

        self.port.peer = peer

    def requests(self, *kinds: str) -> list[protocol.Packet]:
        """What was written, in order, of the given kinds."""
        packets = protocol.Decoder().feed(b"".join(data for _, data in self.port.written))
        return [packet for packet in packets if not kinds or protocol.classify(packet) in kinds]

    def all_of(self, register: table.Register) -> list[int]:
        self.bus.pass_time()
        return [servo.get(register) for servo in self.bus.servos]

    def torque(self) -> list[int]:
        return self.all_of(table.TORQUE_ENABLE)

    async def cycles(self, count: int, write: bool = False) -> Observation:
        """What the tree does at 30 Hz."""
        for _ in range(count):
            if write:
                await self.wire.write(MOVED, Permission())
            seen = await self.wire.read()
            await trio.sleep(1 / 30)
        return seen


def virtual(test: Callable[[], Awaitable[None]]) -> None:
    trio.run(test, clock=MockClock(autojump_threshold=0))


def verdicts(reports: Iterable[MotorReport]) -> dict[str, bool]:
    return {report.axis: report.safe for report in reports}


# -- open


def test_open_tells_who_is_there_moves_nothing_and_rewrites_no_eeprom() -> None:
    async def main() -> None:
        rig = Rig()
        before = [bytes(servo.table[: table.EEPROM_END]) for servo in rig.bus.servos]
        facts = await rig.wire.open()
        assert facts["model"]["shoulder_pan"] == "XL430-W250"
        assert facts["model"]["gripper"] == "XL330-M288"
        assert facts["operating_mode"]["shoulder_pan"] == "extended position"
        assert facts["operating_mode"]["gripper"] == "current-based position"
        assert facts["return_delay_us"] == dict.fromkeys(JOINTS, 500)
        assert facts["energised"] == dict.fromkeys(JOINTS, False)
        assert facts["voltage_v"]["shoulder_pan"] == 12.0
        assert facts["bus_watchdog_s"] == pytest.approx(0.3)
        json.dumps(facts)
        assert rig.requests("setpoint", "enable", "safe", "other") == []
        assert [bytes(servo.table[: table.EEPROM_END]) for servo in rig.bus.servos] == before
        assert tuple(rig.wire.handover()) == (rig.port.fileno(),)

    virtual(main)


def test_servos_that_do_not_acknowledge_are_made_to() -> None:
    async def main() -> None:
        rig = Rig()
        for servo in rig.bus.servos:
            servo.put(table.STATUS_LEVEL, 0)
        await rig.wire.open()
        assert rig.all_of(table.STATUS_LEVEL) == [2] * 6

    virtual(main)


async def _refused(rig: Rig) -> str:
    with pytest.raises(WireDown) as down:
        await rig.wire.open()
    assert rig.port.closed, "a wire that did not open keeps no port"
    assert rig.torque() == [0] * 6
    return str(down.value)


def test_dead_double_and_foreign_servos_are_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        assert "elbow_flex (id 3) does not answer" in await _refused(rig)
        rig = Rig()
        rig.bus.set_fault(Fault.OFF)
        assert "no servo of koch answers on memory at 1000000 baud" in await _refused(rig)
        rig = Rig()
        rig.servo(4).put(table.ID, VICTIM)
        assert "elbow_flex (id 3) answers more than once" in await _refused(rig)
        rig = Rig()
        rig.servo(4).put(table.ID, 9)
        assert "id 9 is not of koch" in await _refused(rig)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "value", "says"),
    [
        (table.MODEL, 1190, "elbow_flex (id 3) is a XL330-M077, must be XL330-M288"),
        (table.MODEL, 4242, "elbow_flex (id 3) is a model 4242, must be XL330-M288"),
        (table.MODE, 1, "elbow_flex (id 3) is in mode 1 (velocity), must be 3, 4 or 5"),
    ],
)
def test_another_servo_is_refused(register: table.Register, value: int, says: str) -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(register, value)
        assert says in await _refused(rig)

    virtual(main)


def calibration() -> dict[str, dict[str, int]]:
    return {
        key: {"id": at, "drive_mode": 0, "homing_offset": 11 * at, "range_min": 700 + at, "range_max": 3300 + at}
        for at, key in enumerate(JOINTS, 1)
    }


def calibrate(rig: Rig) -> None:
    for servo, motor in zip(rig.bus.servos, calibration().values(), strict=True):
        servo.put(table.HOMING_OFFSET, motor["homing_offset"])
        servo.put(table.MIN_POSITION, motor["range_min"])
        servo.put(table.MAX_POSITION, motor["range_max"])


def test_the_calibrated_robot_is_accepted() -> None:
    async def main() -> None:
        rig = Rig(calibration=calibration())
        calibrate(rig)
        assert (await rig.wire.open())["calibration_source"] == "given as a dict"
        seen = await rig.wire.arm(Permission())
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(table.POSITION)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "value", "field"),
    [
        (table.HOMING_OFFSET, 1000, "homing_offset 33"),
        (table.MIN_POSITION, 1000, "range_min 703"),
        (table.MAX_POSITION, 1000, "range_max 3303"),
        (table.DRIVE_MODE, 1, "drive_mode 0"),
    ],
)
def test_the_file_of_another_robot_is_refused(register: table.Register, value: int, field: str) -> None:
    async def main() -> None:
        rig = Rig(calibration=calibration())
        calibrate(rig)
        rig.servo().put(register, value)
        assert f"calibration says {field} for elbow_flex, servo 3 has {value}" in await _refused(rig)

    virtual(main)


# -- arm


def test_arm_sets_the_goal_first_energises_one_by_one_and_arms_every_watchdog_last() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(table.GOAL_POSITION, 100)  # an old goal: energising on it would be a jump
        rig.port.written.clear()
        permission = Permission(rig.port)
        seen = await rig.wire.arm(permission)

        moving = rig.requests("safe", "enable", "setpoint", "config")
        assert [protocol.classify(packet) for packet in moving] == ["config", "safe", *["enable"] * 6, "config"]
        assert [packet.id for packet in moving[2:8]] == [1, 2, 3, 4, 5, 6]
        assert moving[-1].params == bytes((98, 0, 1, 0, 1, 15, 2, 15, 3, 15, 4, 15, 5, 15, 6, 15))
        assert rig.requests()[-1].params == bytes((98, 0, 1, 0, 1, 2, 3, 4, 5, 6)), "it is read back"
        assert rig.torque() == [1] * 6
        assert rig.all_of(table.BUS_WATCHDOG) == [watchdog.COUNTS] * 6
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(table.GOAL_POSITION)
        assert seen.faults == {}
        assert permission.checks == 8, "before the goals, each motor and the watchdogs"

    virtual(main)


@pytest.mark.parametrize("denied_at", range(8))
def test_a_stop_during_bring_up_wins(denied_at: int) -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        permission = Permission(rig.port, denied_at=denied_at)
        with pytest.raises(PermitDenied):
            await rig.wire.arm(permission)
        assert sum(rig.torque()) == max(0, denied_at - 1)
        assert len(rig.port.written) == permission.written_before[-1], "nothing after the denial"
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert rig.torque() == [0] * 6

    virtual(main)


def test_a_watchdog_that_does_not_arm_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: 0 if (address, data) == (98, b"\x0f") else keep(address, data)
        with pytest.raises(WireDown, match=r"bus watchdog of elbow_flex \(id 3\) is 0, must be 15"):
            await rig.wire.arm(Permission())

    virtual(main)


def test_a_latched_alert_is_not_energised() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(table.HARDWARE_ERROR, table.OVERLOAD_BIT)
        assert (await rig.wire.open())["hardware_alert"]["elbow_flex"] == "overload"
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) has overload latched.*reboot it with the arm"):
            await rig.wire.arm(Permission())
        assert rig.torque() == [0] * 6

    virtual(main)


def test_a_servo_that_refuses_torque_is_named_with_its_error() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: protocol.RESULT_FAIL if address == 64 else keep(address, data)
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) does not confirm torque on \(result fail\)"):
            await rig.wire.arm(Permission())

    virtual(main)


def test_arm_refuses_a_joint_that_rests_outside_in_every_mode() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(table.MODE, table.POSITION_MODE)
        rig.servo().put(table.MIN_POSITION, 2600)
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) rests .* deg outside its range"):
            await rig.wire.arm(Permission())
        rig = Rig()
        rig.servo().put(table.HOMING_OFFSET, 4096)  # a turn away
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) rests .* deg outside its range"):
            await rig.wire.arm(Permission())
        assert rig.torque() == [0] * 6

    virtual(main)


# -- read and write


def test_read_gives_every_row_in_the_drivers_units() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        seen = await rig.wire.read()
        now_ns = rig.clock.now_ns()
        assert seen.t_ns == now_ns and seen.stamp_ns == (now_ns,) * 6
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(table.POSITION)
        assert seen.sensors["voltage_v"] == (12.0, 12.0, 5.0, 5.0, 5.0, 5.0)
        assert [math.isnan(load) for load in seen.sensors["load_pct"]] == [False, False, True, True, True, True]
        assert [math.isnan(current) for current in seen.sensors["current_ma"]] == [True] * 2 + [False] * 4
        assert seen.faults == {}

    virtual(main)


def test_the_arm_goes_where_it_is_sent() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        seen = await rig.cycles(60, write=True)
        assert seen.position == pytest.approx(MOVED, abs=4.0)
        assert {protocol.classify(packet) for packet in rig.requests()} == {"setpoint", "read"}

    virtual(main)


def test_a_reply_with_an_error_number_is_dropped_and_reported_and_the_alert_bit_is_not() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        before = await rig.wire.read()
        servo = rig.servo()
        read = servo.read
        servo.read = lambda address, size: (protocol.RESULT_FAIL, b"\0" * size)
        seen = await rig.cycles(1)
        assert seen.faults == {"elbow_flex": "result fail"}
        assert seen.stamp_ns[VICTIM - 1] == before.stamp_ns[VICTIM - 1] < seen.stamp_ns[0]
        assert not rig.wire.session.bus.quiet, "it did answer"
        servo.read = read
        servo.put(table.HARDWARE_ERROR, table.VOLTAGE_BIT)
        servo.put(table.SHUTDOWN, 0)
        seen = await rig.wire.read()
        assert seen.stamp_ns[VICTIM - 1] == seen.t_ns, "its data is taken"
        seen = await rig.cycles(2)
        assert seen.faults == {"elbow_flex": "voltage"}, "and the alert was read and named"

    virtual(main)


def test_overload_is_named_with_the_limp_joint() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.servo().put(table.HARDWARE_ERROR, table.OVERLOAD_BIT)
        seen = await rig.cycles(3)
        assert seen.faults == {"elbow_flex": "overload, limp"}

    virtual(main)


def test_a_silent_servo_keeps_its_stamp_and_no_other_trips() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        before = await rig.wire.read()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        seen = await rig.cycles(90)
        assert seen.faults == {"elbow_flex": "silent"}
        assert seen.stamp_ns[VICTIM - 1] == before.stamp_ns[VICTIM - 1]
        assert (
            min(stamp for at, stamp in enumerate(seen.stamp_ns) if at != VICTIM - 1) > before.t_ns + 2_000_000_000
        )
        others = [count for motor, count in enumerate(rig.all_of(table.BUS_WATCHDOG), 1) if motor != VICTIM]
        assert others == [watchdog.COUNTS] * 5, "the quiet time is shorter than the watchdog's"
        assert watchdog.SECONDS > QUIET_S + 2 / 30

    virtual(main)


def test_a_bus_that_falls_silent_is_a_lost_link() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(Fault.OFF)
        with pytest.raises(WireDown, match="no servo of koch answers"), trio.fail_after(3):
            while True:
                await rig.wire.read()
                await trio.sleep(0.01)

    virtual(main)


# -- the bus watchdog


def test_nobody_speaks_and_the_firmware_stops_the_arm() -> None:
    """SAF-013: everything of ours is gone, a setpoint is under way."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.wire.write((120.0, 0.0, 0.0, 0.0, 0.0, 0.0), Permission())
        await trio.sleep(2.0)
        rig.bus.pass_time()
        assert rig.all_of(table.BUS_WATCHDOG) == [table.WATCHDOG_TRIPPED] * 6
        assert rig.torque() == [1] * 6
        moved_rad = rig.bus.plant.position_rad[0]
        assert moved_rad < watchdog.SECONDS * 6.39, "it did not go on to its goal"

    virtual(main)


def test_a_trip_is_a_fault_and_resume_clears_it_with_the_torque_off() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.wire.write(MOVED, Permission())
        await trio.sleep(0.4)
        seen = await rig.wire.read()
        assert seen.faults == dict.fromkeys(JOINTS, "bus watchdog"), "seen by the first reading after the silence"
        before = rig.all_of(table.GOAL_POSITION)
        await rig.wire.write((0.0,) * 6, Permission())
        assert rig.all_of(table.GOAL_POSITION) == before, "a goal is refused"

        assert all(verdicts(await rig.wire.make_safe("hold")).values()), "it holds already"
        assert rig.all_of(table.BUS_WATCHDOG) == [table.WATCHDOG_TRIPPED] * 6
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        rig.port.written.clear()
        seen = await rig.wire.arm(Permission())
        assert rig.all_of(table.BUS_WATCHDOG) == [watchdog.COUNTS] * 6
        assert seen.faults == {}
        assert (await rig.cycles(20)).faults == {}

    virtual(main)


def test_a_tripped_servo_that_kept_its_torque_loses_it_before_it_is_cleared() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await trio.sleep(0.4)
        rig.port.written.clear()
        await rig.wire.arm(Permission())
        kinds = [protocol.classify(packet) for packet in rig.requests() if protocol.classify(packet) != "read"]
        assert kinds == [*["safe"] * 6, "config", "safe", *["enable"] * 6, "config"]
        assert rig.torque() == [1] * 6

    virtual(main)


def test_an_arm_that_rests_or_holds_is_read_for_ever_and_does_not_trip() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        assert (await rig.cycles(90)).faults == {}
        await rig.cycles(10, write=True)
        assert all(verdicts(await rig.wire.make_safe("hold")).values())
        assert (await rig.cycles(90)).faults == {}
        assert rig.all_of(table.BUS_WATCHDOG) == [watchdog.COUNTS] * 6

    virtual(main)


def test_reads_alone_do_not_keep_a_setpoint_alive() -> None:
    """The writer and the gate that would have stopped it are gone; somebody still asks for readings."""

    async def main() -> None:
        rig = await Rig().armed()
        await rig.cycles(1, write=True)
        last = await rig.cycles(60)
        assert rig.all_of(table.BUS_WATCHDOG) == [table.WATCHDOG_TRIPPED] * 6
        age_s = (rig.clock.now_ns() - last.t_ns) / 1e9
        assert age_s > 1.0, "it says what it last knew, not that all is well"
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert (await rig.wire.read()).t_ns == rig.clock.now_ns()

    virtual(main)


def test_a_servo_that_did_not_take_the_hold_is_not_fed() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.cycles(3, write=True)
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: 0 if address == table.PROFILE_VELOCITY.address else keep(address, data)
        reports = await rig.wire.make_safe("hold")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        assert reports[VICTIM - 1].detail.startswith("goal is ")
        await rig.cycles(20)
        assert rig.all_of(table.BUS_WATCHDOG)[VICTIM - 1] == table.WATCHDOG_TRIPPED, "the firmware stopped it"

    virtual(main)


# -- safe


def test_limp_is_confirmed_motor_by_motor() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        began = trio.current_time()
        reports = await rig.wire.make_safe("limp")
        assert rig.port.written[0][0] == began, "the first frame waits for nothing"
        assert rig.port.written[0][1].startswith(protocol.RESYNC + protocol.LIMP)
        assert [report.id for report in reports] == [1, 2, 3, 4, 5, 6]
        assert all(report.safe and report.written and report.acknowledged for report in reports)
        assert rig.torque() == [0] * 6
        assert rig.requests("setpoint", "enable") == []

    virtual(main)


@pytest.mark.parametrize(
    ("fault", "detail"), [(Fault.OFF, "silent"), (Fault.DELAYED, "silent"), (Fault.GARBAGE, "bad reply")]
)
def test_stop_reaches_the_others_and_names_the_one(fault: Fault, detail: str) -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(fault, VICTIM)
        reports = await rig.wire.make_safe("limp")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        victim = reports[VICTIM - 1]
        assert (victim.written, victim.acknowledged, victim.detail) == (True, False, detail)

    virtual(main)


@pytest.mark.parametrize("error", [0, protocol.RESULT_FAIL])
def test_a_motor_that_stays_driven_is_named(error: int) -> None:
    async def main() -> None:
        rig = await Rig().armed()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: error if address == 64 else keep(address, data)
        victim = (await rig.wire.make_safe("limp"))[VICTIM - 1]
        assert (victim.safe, victim.acknowledged) == (False, True)
        assert victim.detail == ("refuses: result fail" if error else "still energised")

    virtual(main)


def test_a_motor_that_missed_the_broadcasts_is_reached_alone() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.filter(lambda packet: not (packet.id == protocol.BROADCAST and packet.code == protocol.WRITE))
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert rig.torque() == [0] * 6

    virtual(main)


def test_safe_frames_survive_half_a_setpoint() -> None:
    """The frame its writer did not finish takes bytes of ours for its own, wherever it was cut."""

    async def main() -> None:
        for torn in (
            protocol.goals(dict.fromkeys(range(1, 7), 3000)),
            protocol.hold(dict.fromkeys(range(1, 7), 9)),
        ):
            for cut in range(1, len(torn)):
                rig = await Rig().armed()
                rig.port.write(torn[:cut])
                rig.port.written.clear()
                assert all(verdicts(await rig.wire.make_safe("limp")).values()), cut
                assert rig.torque() == [0] * 6
                assert len(rig.port.written) == 5, "four frames of torque off and one question"

    virtual(main)


def test_hold_keeps_the_arm_where_it_is() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        seen = await rig.cycles(10, write=True)
        seen = await rig.wire.read()
        rig.port.written.clear()
        began = trio.current_time()
        reports = await rig.wire.make_safe("hold")
        assert all(report.safe for report in reports), reports
        at, first = rig.port.written[0]
        counts = {axis.id: axis.count(value) for axis, value in zip(rig.driver.joints, seen.position, strict=True)}
        assert at == began and first.startswith(protocol.RESYNC + protocol.hold(counts))
        assert rig.torque() == [1] * 6
        assert rig.requests("setpoint", "enable") == []
        rested = await rig.cycles(30)
        assert rested.position == pytest.approx(seen.position, abs=8.0)
        assert rested.faults == {}

    virtual(main)


@pytest.mark.parametrize("rung", ["hold", "limp"])
def test_a_dead_link_is_a_report_not_an_error(rung: str) -> None:
    async def main() -> None:
        rig = Rig()
        for report in await rig.wire.make_safe(rung):
            assert (report.written, report.safe, report.detail) == (False, False, "not connected")
        await rig.armed()
        rig.port.unplugged = True
        for report in await rig.wire.make_safe(rung):
            assert (report.written, report.acknowledged, report.safe) == (False, False, False)
            assert "the port is gone" in report.detail
        rig.wire.close()

    virtual(main)


# -- the twin's own process, on a pty


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("koch", tmp_path) as process:
        yield process


@pytest.mark.parametrize("rung", ["limp", "hold"])
def test_the_second_path_makes_the_robot_of_a_dead_owner_safe(twin: Twin, rung: str) -> None:
    async def main() -> None:
        driver = Dynamixel("koch", twin.port, Dynamixel.resolve("koch", {}))
        wire = driver.open_wire(MonotonicClock())
        await wire.open()
        await wire.arm(Permission())
        descriptors = [os.dup(fd) for fd in wire.handover()]
        os.write(wire.handover()[0], protocol.goals(dict.fromkeys(driver.ids, 3000))[:17])  # died in a frame
        os.close(wire.handover()[0])  # as the kernel does it: no goodbye

        second = driver.second_path(descriptors, MonotonicClock())
        before = len(list(twin.log.entries()))
        reports = await second.make_safe(rung)
        assert all(report.safe and report.written for report in reports), reports
        after = [entry for entry in list(twin.log.entries())[before:] if entry.sender == "host"]
        assert {entry.kind for entry in after} <= {"safe", "read", "other"}
        assert rung in {entry.rung for entry in after}
        second.close()

    trio.run(main)
