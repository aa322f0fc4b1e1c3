"""The Feetech wire against the twin: its servos in memory under virtual time, then its process on a pty."""

from __future__ import annotations

import contextlib
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
from twin_process import TwinProcess, wait_until

from strands_actors.drivers.common.half_duplex import QUIET_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech import protocol
from strands_actors.drivers.feetech.driver import Feetech
from strands_actors.drivers.feetech.twin import FeetechBus
from strands_actors.drivers.feetech.wire import FeetechWire
from strands_actors.runtime.clock import MonotonicClock, VirtualClock
from strands_actors.runtime.contract import MotorReport, Observation, PermitDenied, WireDown

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
OTHERS = tuple(key for key in JOINTS if key != "elbow_flex")
VICTIM = 3  # elbow_flex


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

    def __init__(self, robot: str = "so101", **options: Any) -> None:
        self.bus = FeetechBus.for_robot(robot, now_s=trio.current_time)
        self.port = MemoryPort(servos(self.bus))
        self.driver = Feetech(robot, "memory", Feetech.resolve(robot, options))
        self.clock = VirtualClock()
        self.wire = FeetechWire(self.driver, self.clock, lambda path, baud: self.port)

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

    def torque(self) -> list[int]:
        return [servo.get(protocol.TORQUE_ENABLE) for servo in self.bus.servos]


def virtual(test: Callable[[], Awaitable[None]]) -> None:
    trio.run(test, clock=MockClock(autojump_threshold=0))


async def _until(wire: FeetechWire, true: Callable[[Observation], bool]) -> Observation:
    with trio.fail_after(20):
        while True:
            seen = await wire.read()
            if true(seen):
                return seen
            await trio.sleep(0.01)


def verdicts(reports: Iterable[MotorReport]) -> dict[str, bool]:
    return {report.axis: report.safe for report in reports}


# -- open


def test_open_tells_who_is_there_and_moves_nothing() -> None:
    async def main() -> None:
        rig = Rig()
        facts = await rig.wire.open()
        assert facts["model"] == dict.fromkeys(JOINTS, "STS3215")
        assert facts["firmware"] == dict.fromkeys(JOINTS, "3.10")
        assert facts["voltage_v"] == dict.fromkeys(JOINTS, 7.4)
        assert facts["energised"] == dict.fromkeys(JOINTS, False)
        assert facts["calibration_source"] == "none: full servo travel"
        json.dumps(facts)
        assert rig.requests("setpoint", "enable", "safe", "other") == []
        assert rig.torque() == [0] * 6
        assert tuple(rig.wire.handover()) == (rig.port.fileno(),)

    virtual(main)


def test_open_takes_the_return_delay_away_until_power_off() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(protocol.LOCK, 0)
        await rig.wire.open()
        assert [servo.get(protocol.RETURN_DELAY) for servo in rig.bus.servos] == [0] * 6
        rig.bus.power_cycle()
        assert [servo.get(protocol.RETURN_DELAY) for servo in rig.bus.servos] == [250] * 6

    virtual(main)


async def _refused(rig: Rig) -> str:
    with pytest.raises(WireDown) as down:
        await rig.wire.open()
    assert rig.port.closed, "a wire that did not open keeps no port"
    assert rig.torque() == [0] * 6
    return str(down.value)


def test_a_dead_servo_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        text = await _refused(rig)
        assert "elbow_flex (id 3) does not answer" in text
        assert not any(other in text for other in OTHERS)

    virtual(main)


def test_a_silent_bus_is_not_six_dead_servos() -> None:
    async def main() -> None:
        rig = Rig()
        rig.bus.set_fault(Fault.OFF)
        assert "no servo of so101 answers on memory at 1000000 baud" in await _refused(rig)

    virtual(main)


def test_two_servos_on_one_id_are_told_from_a_dead_one() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo(4).put(protocol.ID, VICTIM)
        text = await _refused(rig)
        assert "wrist_flex (id 4) does not answer" in text
        assert "elbow_flex (id 3) answers more than once" in text

    virtual(main)


def test_a_foreign_servo_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo(4).put(protocol.ID, 9)
        text = await _refused(rig)
        assert "wrist_flex (id 4) does not answer" in text
        assert "id 9 is not of so101" in text

    virtual(main)


def test_garbled_answers_are_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.bus.set_fault(Fault.GARBAGE, VICTIM)
        assert "elbow_flex (id 3) answers more than once or garbled" in await _refused(rig)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "value", "says"),
    [
        (protocol.MODEL, 2825, "elbow_flex (id 3) is a STS3250, must be STS3215"),
        (protocol.MODEL, 4242, "elbow_flex (id 3) is a model 4242, must be STS3215"),
        (protocol.MODE, 1, "elbow_flex (id 3) is in mode 1, must be 0"),
    ],
)
def test_another_servo_is_refused(register: protocol.Register, value: int, says: str) -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(register, value)
        assert says in await _refused(rig)

    virtual(main)


def calibration() -> dict[str, dict[str, int]]:
    return {
        key: {
            "id": at,
            "drive_mode": 0,
            "homing_offset": 11 * at,
            "range_min": 700 + at,
            "range_max": 3300 + at,
        }
        for at, key in enumerate(JOINTS, 1)
    }


def calibrate(rig: Rig) -> None:
    for servo, motor in zip(rig.bus.servos, calibration().values(), strict=True):
        servo.put(protocol.HOMING_OFFSET, motor["homing_offset"])
        servo.put(protocol.MIN_POSITION, motor["range_min"])
        servo.put(protocol.MAX_POSITION, motor["range_max"])


def test_the_calibrated_robot_is_accepted() -> None:
    async def main() -> None:
        rig = Rig(calibration=calibration())
        calibrate(rig)
        facts = await rig.wire.open()
        assert facts["calibration_source"] == "given as a dict"
        seen = await rig.wire.arm(Permission())
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(protocol.POSITION)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "field"),
    [
        (protocol.HOMING_OFFSET, "homing_offset 33"),
        (protocol.MIN_POSITION, "range_min 703"),
        (protocol.MAX_POSITION, "range_max 3303"),
    ],
)
def test_the_file_of_another_robot_is_refused(register: protocol.Register, field: str) -> None:
    async def main() -> None:
        rig = Rig(calibration=calibration())
        calibrate(rig)
        rig.servo().put(register, 1000)
        assert f"calibration says {field} for elbow_flex, servo 3 has 1000" in await _refused(rig)

    virtual(main)


# -- arm


def test_arm_sets_the_goal_first_and_energises_one_by_one() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(protocol.GOAL_POSITION, 100)  # an old goal: energising on it would be a jump
        rig.port.written.clear()
        permission = Permission(rig.port)
        seen = await rig.wire.arm(permission)

        moving = rig.requests("safe", "enable", "setpoint")
        assert protocol.classify(moving[0]) == "safe"
        assert [packet.id for packet in moving[1:]] == [1, 2, 3, 4, 5, 6]
        assert [packet.params for packet in moving[1:]] == [bytes((40, 1))] * 6
        assert rig.torque() == [1] * 6
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(protocol.GOAL_POSITION)
        assert seen.faults == {}
        assert all(stamp > 0 for stamp in seen.stamp_ns)
        assert permission.checks == 7, "before the goals and before each motor"

    virtual(main)


def test_a_stop_during_bring_up_wins() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        permission = Permission(rig.port, denied_at=3)
        with pytest.raises(PermitDenied):
            await rig.wire.arm(permission)
        assert rig.torque() == [1, 1, 0, 0, 0, 0]
        assert len(rig.port.written) == permission.written_before[-1], "nothing after the denial"
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert rig.torque() == [0] * 6

    virtual(main)


@pytest.mark.parametrize(
    ("lost", "says"),
    [
        (lambda packet: packet.id == 4 and packet.code == protocol.WRITE, "does not confirm torque on"),
        (lambda packet: packet.id == 4 and packet.code == protocol.READ, "does not stay energised"),
        (lambda packet: packet.code == protocol.SYNC_WRITE, "did not take its present position as goal"),
    ],
)
def test_a_motor_that_does_not_confirm_is_named(lost: Callable[[protocol.Packet], bool], says: str) -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(protocol.GOAL_POSITION, 100)
        rig.filter(lambda packet: not lost(packet))
        with pytest.raises(WireDown, match=says) as down:
            await rig.wire.arm(Permission())
        assert ("wrist_flex (id 4)" in str(down.value)) == ("goal" not in says)

    virtual(main)


def test_arm_names_the_servo_that_died_since_connect() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        with pytest.raises(WireDown, match=r"arm: elbow_flex \(id 3\) does not tell its position"):
            await rig.wire.arm(Permission())
        assert rig.requests("enable", "setpoint", "safe") == []

    virtual(main)


def test_arm_refuses_to_pull_a_joint_in() -> None:
    async def main() -> None:
        rig = Rig()
        rig.servo().put(protocol.MIN_POSITION, 2600)
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
            assert axis.count(value) == servo.get(protocol.POSITION)
        assert len(seen.velocity) == 6
        assert set(seen.sensors) >= {"load_pct", "voltage_v", "temperature_c"}
        assert seen.sensors["voltage_v"] == (7.4,) * 6
        assert seen.faults == {}

    virtual(main)


def test_write_checks_the_permit_last_and_writes_one_frame() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        permission = Permission(rig.port)
        await rig.wire.write((10.0, -10.0, 5.0, 0.0, 0.0, 50.0), permission)
        assert permission.written_before == [0]
        assert len(rig.port.written) == 1
        assert [protocol.classify(packet) for packet in rig.requests()] == ["setpoint"]
        for axis, servo in zip(rig.driver.joints, rig.bus.servos, strict=True):
            wanted = (10.0, -10.0, 5.0, 0.0, 0.0, 50.0)[rig.driver.joints.index(axis)]
            assert servo.get(protocol.GOAL_POSITION) == axis.count(wanted)

        with pytest.raises(PermitDenied):
            await rig.wire.write((0.0,) * 6, Permission(denied_at=0))
        assert len(rig.port.written) == 1

    virtual(main)


def test_the_arm_goes_where_it_is_sent() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        target = (20.0, -10.0, 15.0, 10.0, -20.0, 40.0)
        seen = await rig.wire.read()
        for _ in range(100):
            await rig.wire.write(target, Permission())
            seen = await rig.wire.read()
            await trio.sleep(0.02)
        assert seen.position == pytest.approx(target, abs=3.0)

    virtual(main)


def test_a_silent_servo_keeps_its_stamp_and_holds_nobody_up() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        before = await rig.wire.read()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        fresh = 0
        slowest_s = 0.0
        for _ in range(300):  # 3 s at 100 Hz
            began, last_ns = trio.current_time(), before.stamp_ns[0]
            seen = await rig.wire.read()
            slowest_s = max(slowest_s, trio.current_time() - began)
            fresh += seen.stamp_ns[0] > last_ns
            before = Observation(**{**_fields(before), "stamp_ns": (seen.stamp_ns[0], *before.stamp_ns[1:])})
            await trio.sleep(max(0.0, 0.01 - (trio.current_time() - began)))
        assert seen.faults == {"elbow_flex": "silent"}
        assert seen.stamp_ns[VICTIM - 1] == before.stamp_ns[VICTIM - 1]
        assert seen.position[VICTIM - 1] == before.position[VICTIM - 1]
        assert fresh > 150
        assert slowest_s < 0.03, "the quiet time held the caller up"

        rig.bus.set_fault(Fault.OK, VICTIM)
        await _until(rig.wire, lambda seen: seen.faults == {"elbow_flex": "limp"})
        # its power came back, its torque did not

    virtual(main)


def _fields(seen: Observation) -> dict[str, Any]:
    return {name: getattr(seen, name) for name in seen.__struct_fields__}


def test_in_the_quiet_time_the_last_observation_is_returned_at_once() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        last = await rig.wire.read()
        written, began = len(rig.port.written), trio.current_time()
        assert await rig.wire.read() is last
        assert trio.current_time() == began
        assert len(rig.port.written) == written
        await rig.wire.write((0.0,) * 6, Permission())
        assert len(rig.port.written) == written + 1, "a setpoint goes out all the same"
        await trio.sleep(QUIET_S)
        assert await rig.wire.read() is not last

    virtual(main)


def test_a_bus_that_falls_silent_is_a_lost_link() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(Fault.OFF)
        began = trio.current_time()
        with pytest.raises(WireDown, match="no servo of so101 answers"), trio.fail_after(3):
            while True:
                await rig.wire.read()
                await trio.sleep(0.01)
        assert trio.current_time() - began > 0.5

    virtual(main)


def test_a_short_silence_of_all_is_survived() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.filter(lambda packet: not 10.0 < trio.current_time() < 10.4)
        await trio.sleep_until(9.9)
        seen = await rig.wire.read()
        while trio.current_time() < 12:
            seen = await rig.wire.read()
            await trio.sleep(0.01)
        assert seen.faults == {}

    virtual(main)


def test_a_servo_that_lost_its_torque_is_named_while_armed() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        for _ in range(100):
            assert (await rig.wire.read()).faults == {}, "nobody asked for torque yet"
            await trio.sleep(0.01)
        await rig.wire.arm(Permission())
        rig.servo().power_cycle()
        await trio.sleep(0.6)
        await rig.wire.read()
        await trio.sleep(0.6)
        seen = await rig.wire.read()
        assert seen.faults == {"elbow_flex": "limp"}
        await rig.wire.make_safe("limp")
        assert (await rig.wire.read()).faults == {}, "limp is no fault when it was ordered"

    virtual(main)


def test_what_a_servo_reports_is_named() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.servo().voltage_v = 3.9
        seen = await rig.wire.read()
        assert seen.faults == {"elbow_flex": "voltage"}
        assert seen.sensors["voltage_v"][VICTIM - 1] == 3.9
        assert seen.sensors["voltage_min_v"][VICTIM - 1] == 4.0

    virtual(main)


def test_a_late_servo_never_lies() -> None:
    """Sixty milliseconds late while its joint moves on: no reading of it is ever an older one."""

    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(Fault.DELAYED, VICTIM)
        first = rig.servo().get(protocol.POSITION)
        for number in range(200):
            rig.servo().put(protocol.GOAL_POSITION, first + 2 * number)
            seen = await rig.wire.read()
            if seen.stamp_ns[VICTIM - 1] == rig.clock.now_ns():
                count = rig.driver.joints[VICTIM - 1].count(seen.position[VICTIM - 1])
                assert count == rig.servo().get(protocol.POSITION)
            assert "elbow_flex" in seen.faults or number < 1
            await trio.sleep(0.01)

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
        assert trio.current_time() - began < 0.05

    virtual(main)


@pytest.mark.parametrize(
    ("fault", "detail"), [(Fault.OFF, "silent"), (Fault.DELAYED, "silent"), (Fault.GARBAGE, "bad reply")]
)
@pytest.mark.parametrize("quiet", [False, True])
def test_stop_reaches_the_others_and_names_the_one(fault: Fault, detail: str, quiet: bool) -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.bus.set_fault(fault, VICTIM)
        if quiet:
            await rig.wire.read()
        rig.port.written.clear()
        began = trio.current_time()
        reports = await rig.wire.make_safe("limp")
        assert rig.port.written[0][0] == began
        assert trio.current_time() - began <= 1.1
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        victim = reports[VICTIM - 1]
        assert (victim.written, victim.acknowledged, victim.detail) == (True, False, detail)

    virtual(main)


def test_a_motor_that_keeps_its_torque_is_named() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: (
            None if address == protocol.TORQUE_ENABLE.address else keep(address, data)
        )
        victim = (await rig.wire.make_safe("limp"))[VICTIM - 1]
        assert (victim.safe, victim.acknowledged, victim.detail) == (False, True, "still energised")

    virtual(main)


def test_a_motor_that_missed_the_broadcasts_is_reached_alone() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.filter(lambda packet: not (packet.id == protocol.BROADCAST and packet.code == protocol.WRITE))
        reports = await rig.wire.make_safe("limp")
        assert all(report.safe for report in reports)
        assert rig.torque() == [0] * 6

    virtual(main)


def test_safe_frames_survive_half_a_setpoint() -> None:
    """The frame its writer did not finish takes bytes of ours for its own, wherever it was cut."""

    async def main() -> None:
        setpoint = protocol.sync_write(protocol.GOAL_POSITION, dict.fromkeys(range(1, 7), 3000))
        for cut in range(1, len(setpoint)):
            rig = await Rig().armed()
            rig.port.write(setpoint[:cut])
            rig.port.written.clear()
            assert all(verdicts(await rig.wire.make_safe("limp")).values()), cut
            assert rig.torque() == [0] * 6
            assert len(rig.port.written) == 4, "three frames of torque off and one question"

    virtual(main)


def test_hold_keeps_the_arm_where_it_is() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        for _ in range(10):
            await rig.wire.write((30.0, 20.0, 20.0, 10.0, 10.0, 50.0), Permission())
            seen = await rig.wire.read()
            await trio.sleep(0.01)
        rig.port.written.clear()
        began = trio.current_time()
        reports = await rig.wire.make_safe("hold")
        assert all(report.safe for report in reports), reports
        at, first = rig.port.written[0]
        counts = {axis.id: axis.count(value) for axis, value in zip(rig.driver.joints, seen.position, strict=True)}
        assert at == began and first.startswith(protocol.RESYNC + protocol.hold(counts))
        assert rig.torque() == [1] * 6
        assert rig.requests("setpoint", "enable") == []
        await trio.sleep(1)
        rested = await rig.wire.read()
        assert rested.position == pytest.approx(seen.position, abs=8.0)
        assert rested.faults == {}

    virtual(main)


def test_hold_asks_again_when_what_it_knows_is_old() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.wire.write((30.0, 20.0, 20.0, 10.0, 10.0, 50.0), Permission())
        await trio.sleep(2)
        began = trio.current_time()
        rig.port.written.clear()
        assert all(verdicts(await rig.wire.make_safe("hold")).values())
        assert rig.port.written[0][0] == began
        there = [servo.get(protocol.POSITION) for servo in rig.bus.servos]
        goals = [servo.get(protocol.GOAL_POSITION) for servo in rig.bus.servos]
        assert goals == pytest.approx(there, abs=60), "where it is, not where it was two seconds ago"

    virtual(main)


def test_hold_names_a_motor_that_is_limp_and_one_that_is_silent() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.wire.read()
        rig.servo(5).power_cycle()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        reports = {report.axis: report for report in await rig.wire.make_safe("hold")}
        assert {key for key, report in reports.items() if not report.safe} == {"elbow_flex", "wrist_roll"}
        assert reports["elbow_flex"].detail == "silent"
        assert reports["wrist_roll"].detail == "limp"

    virtual(main)


@pytest.mark.parametrize("rung", ["hold", "limp", "a rung nobody knows"])
def test_a_dead_link_is_a_report_not_an_error(rung: str) -> None:
    async def main() -> None:
        rig = Rig()
        for report in await rig.wire.make_safe(rung):
            assert (report.written, report.safe, report.detail) == (False, False, "not connected")
        await rig.armed()
        rig.port.unplugged = True
        reports = await rig.wire.make_safe(rung)
        assert [report.axis for report in reports] == list(JOINTS)
        for report in reports:
            assert (report.written, report.acknowledged, report.safe) == (False, False, False)
            assert "the port is gone" in report.detail
        rig.wire.close()

    virtual(main)


@pytest.mark.parametrize("robot", Feetech.SUPPORTED_ROBOTS)
def test_every_robot_opens_arms_moves_and_stops(robot: str) -> None:
    async def main() -> None:
        rig = Rig(robot)
        await rig.wire.open()
        seen = await rig.wire.arm(Permission())
        assert all(map(math.isfinite, seen.position))
        await rig.wire.write(seen.position, Permission())
        assert (await rig.wire.read()).faults == {}
        assert all(report.safe for report in await rig.wire.make_safe("hold"))
        assert all(report.safe for report in await rig.wire.make_safe("limp"))

    virtual(main)


# -- the twin's own process, on a pty


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[TwinProcess]:
    with TwinProcess(tmp_path) as process:
        yield process


async def connected(wire: FeetechWire) -> dict[str, Any]:
    """Open, and again if need be, as a supervisor does: on a busy machine the twin may miss a ping."""
    for _ in range(9):
        with contextlib.suppress(WireDown):
            return await wire.open()
    return await wire.open()


def host_kinds(twin: TwinProcess) -> list[str]:
    return [kind for kind, _ in twin.logged("host")]


def on(twin: TwinProcess) -> tuple[Feetech, FeetechWire]:
    driver = Feetech("so101", twin.port, Feetech.resolve("so101", {}))
    return driver, driver.open_wire(MonotonicClock())


def test_the_process_opens_arms_moves_and_stops(twin: TwinProcess) -> None:
    async def main() -> None:
        _, wire = on(twin)
        facts = await connected(wire)
        assert facts["port"] == twin.port
        seen = await wire.arm(Permission())
        target = list(seen.position)
        target[0] += 15.0
        with trio.fail_after(20):
            while abs((await wire.read()).position[0] - target[0]) > 3.0:
                await wire.write(tuple(target), Permission())
                await trio.sleep(0.02)
        assert all(verdicts(await wire.make_safe("hold")).values())
        assert all(verdicts(await wire.make_safe("limp")).values())
        wire.close()

        kinds = host_kinds(twin)
        assert kinds.index("safe") < kinds.index("enable") < kinds.index("setpoint")
        stopped = len(kinds) - kinds[::-1].index("setpoint")
        assert "safe" in kinds[stopped:] and "enable" not in kinds[stopped:]

    trio.run(main)


@pytest.mark.parametrize("fault", ["off", "delayed", "garbage"])
def test_the_process_with_a_faulty_servo_stops_the_other_five(twin: TwinProcess, fault: str) -> None:
    async def main() -> None:
        _, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        twin.command(f"fault {fault}:{VICTIM}")
        seen = await _until(wire, lambda seen: "silent" in seen.faults.get("elbow_flex", ""))
        later = await _until(wire, lambda now: now.stamp_ns[0] > seen.stamp_ns[0] + 1_000_000_000)
        assert set(later.faults) == {"elbow_flex"}, "the others go on"
        reports = await wire.make_safe("limp")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        assert reports[VICTIM - 1].detail
        twin.command(f"fault ok:{VICTIM}")
        await _until(wire, lambda seen: not seen.faults)
        await wire.arm(Permission())
        assert all(verdicts(await wire.make_safe("limp")).values())
        wire.close()

    trio.run(main)


def test_the_second_path_makes_the_robot_of_a_dead_owner_limp(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        descriptors = [os.dup(fd) for fd in wire.handover()]
        setpoint = protocol.sync_write(protocol.GOAL_POSITION, dict.fromkeys(driver.ids, 3000))
        os.write(wire.handover()[0], setpoint[:13])  # died in the middle of a frame
        os.close(wire.handover()[0])  # as the kernel does it: no goodbye

        second = driver.second_path(descriptors, MonotonicClock())
        before = len(host_kinds(twin))
        reports = await second.make_safe("limp")
        assert all(report.safe and report.written for report in reports), reports
        assert "setpoint" not in host_kinds(twin)[before:]
        second.close()

        again = driver.open_wire(MonotonicClock())
        facts = await connected(again)
        assert not any(facts["energised"].values())
        again.close()

    trio.run(main)


def test_the_second_path_can_hold_too(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        second = driver.second_path([os.dup(fd) for fd in wire.handover()], MonotonicClock())
        assert all(verdicts(await second.make_safe("hold")).values())
        second.close()
        wire.close()

    trio.run(main)


def test_two_masters_are_refused_and_a_closed_port_can_be_opened_again(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        other = driver.open_wire(MonotonicClock())
        with pytest.raises(WireDown, match="cannot open at 1000000 baud"):
            await other.open()
        kept = os.dup(wire.handover()[0])  # the root's: must not keep us out
        wire.close()
        await connected(other)
        other.close()
        os.close(kept)

    trio.run(main)


def test_an_unplugged_cable_is_a_lost_link_and_comes_back(twin: TwinProcess) -> None:
    async def main() -> None:
        driver, wire = on(twin)
        await connected(wire)
        await wire.arm(Permission())
        twin.command("unplug")
        wait_until(lambda: not os.path.exists(twin.port), "the port is gone")
        with pytest.raises(WireDown, match="the port is gone"):
            await wire.read()
        for report in await wire.make_safe("limp"):
            assert not report.safe and not report.written and "the port is gone" in report.detail
        wire.close()

        again = driver.open_wire(MonotonicClock())
        with pytest.raises(WireDown, match="cannot open"):
            await again.open()
        twin.command("plug")
        wait_until(lambda: os.path.exists(twin.port), "the port is back")
        await connected(again)
        assert all(verdicts(await again.make_safe("limp")).values())
        again.close()

    trio.run(main)


def test_what_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    async def main() -> None:
        for path in (tmp_path / "none", tmp_path):
            wire = Feetech("so101", str(path), Feetech.resolve("so101", {})).open_wire(MonotonicClock())
            with pytest.raises(WireDown, match="cannot open"):
                await wire.open()

    trio.run(main)
