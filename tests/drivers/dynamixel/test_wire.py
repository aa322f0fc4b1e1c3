"""Test how the Dynamixel wire reads, writes and makes safe: on the twin's servos in memory and virtual time,
then against its process on a pty."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import trio

from strands_actors.contract.wire import WireDown
from strands_actors.drivers.common.dynamixel import protocol, table, watchdog
from strands_actors.drivers.common.dynamixel.gates import FAULT_CODES
from strands_actors.drivers.common.dynamixel.watchdog import UNARMED
from strands_actors.drivers.common.ports.half_duplex import QUIET_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.dynamixel.driver import Dynamixel
from strands_actors.kernel.clock import MonotonicClock
from strands_actors.testing.twin import Twin
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import JOINTS, MOVED, VICTIM, DynamixelRig, verdicts

# -- read and write


def test_read_gives_every_row_in_the_drivers_units() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
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
        rig = await DynamixelRig().armed()
        seen = await rig.cycles(60, write=True)
        assert seen.position == pytest.approx(MOVED, abs=4.0)
        assert {protocol.classify(packet) for packet in rig.requests()} == {"setpoint", "read"}

    virtual(main)


def test_a_reply_with_an_error_number_is_dropped_and_reported_and_the_alert_bit_is_not() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        before = await rig.wire.read()
        servo = rig.servo()
        read = servo.read
        servo.read = lambda address, size: (protocol.RESULT_FAIL, b"\0" * size)
        seen = await rig.cycles(1)
        assert seen.faults == {"elbow_flex": "result fail"}
        assert seen.stamp_ns[VICTIM - 1] == before.stamp_ns[VICTIM - 1] < seen.stamp_ns[0]
        assert not rig.wire.session.bus.quiet, "the servo answered, so the bus is not quiet"
        servo.read = read
        servo.put(table.HARDWARE_ERROR, table.VOLTAGE_BIT)
        servo.put(table.SHUTDOWN, 0)
        seen = await rig.wire.read()
        assert seen.stamp_ns[VICTIM - 1] == seen.t_ns, "the data in a reply with an alert counts"
        seen = await rig.cycles(2)
        assert seen.faults == {"elbow_flex": "voltage"}, "the alert is read and named"

    virtual(main)


def test_overload_is_named_with_the_limp_joint() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        rig.servo().put(table.HARDWARE_ERROR, table.OVERLOAD_BIT)
        seen = await rig.cycles(3)
        assert seen.faults == {"elbow_flex": "overload, limp"}

    virtual(main)


def test_a_silent_servo_keeps_its_stamp_and_no_other_trips() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        before = await rig.wire.read()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        seen = await rig.cycles(90)
        assert seen.faults == {"elbow_flex": "silent"}
        assert seen.stamp_ns[VICTIM - 1] == before.stamp_ns[VICTIM - 1]
        assert (
            min(stamp for at, stamp in enumerate(seen.stamp_ns) if at != VICTIM - 1) > before.t_ns + 2_000_000_000
        )
        others = [count for motor, count in enumerate(rig.all_of(table.BUS_WATCHDOG), 1) if motor != VICTIM]
        assert others == [watchdog.COUNTS] * 5, "the other servos' watchdogs do not trip in the quiet time"
        assert watchdog.SECONDS > QUIET_S + 2 / 30

    virtual(main)


def test_a_bus_that_falls_silent_is_a_lost_link() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        rig.bus.set_fault(Fault.OFF)
        with pytest.raises(WireDown, match="no servo of koch answers"), trio.fail_after(3):
            while True:
                await rig.wire.read()
                await trio.sleep(0.01)

    virtual(main)


# -- the bus watchdog


def test_without_frames_the_firmware_stops_the_arm() -> None:
    """SAF-013: a setpoint is under way, and all of our processes are gone."""

    async def main() -> None:
        rig = await DynamixelRig().armed()
        await rig.wire.write((120.0, 0.0, 0.0, 0.0, 0.0, 0.0), Permission())
        await trio.sleep(2.0)
        rig.bus.pass_time()
        assert rig.all_of(table.BUS_WATCHDOG) == [table.WATCHDOG_TRIPPED] * 6
        assert rig.torque() == [1] * 6
        moved_rad = rig.bus.plant.position_rad[0]
        assert moved_rad < watchdog.SECONDS * 6.39, "the joint did not go on to its goal"

    virtual(main)


def test_a_trip_is_a_fault_and_resume_clears_it_with_the_torque_off() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        await rig.wire.write(MOVED, Permission())
        await trio.sleep(0.4)
        seen = await rig.wire.read()
        assert seen.faults == dict.fromkeys(JOINTS, "bus watchdog"), (
            "the first reading after the silence shows the trip"
        )
        before = rig.all_of(table.GOAL_POSITION)
        await rig.wire.write((0.0,) * 6, Permission())
        assert rig.all_of(table.GOAL_POSITION) == before, "a servo with a tripped watchdog refuses a goal"

        assert all(verdicts(await rig.wire.make_safe("hold")).values()), "the servo holds already"
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
        rig = await DynamixelRig().armed()
        await trio.sleep(0.4)
        rig.port.written.clear()
        await rig.wire.arm(Permission())
        kinds = [protocol.classify(packet) for packet in rig.requests() if protocol.classify(packet) != "read"]
        assert kinds == [*["safe"] * 6, "config", *["safe", "enable"] * 6, "config"]
        assert rig.torque() == [1] * 6

    virtual(main)


def test_an_arm_that_rests_or_holds_is_read_for_ever_and_does_not_trip() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        assert (await rig.cycles(90)).faults == {}
        await rig.cycles(10, write=True)
        assert all(verdicts(await rig.wire.make_safe("hold")).values())
        assert (await rig.cycles(90)).faults == {}
        assert rig.all_of(table.BUS_WATCHDOG) == [watchdog.COUNTS] * 6

    virtual(main)


def test_reads_alone_do_not_keep_a_setpoint_alive() -> None:
    """The writer is gone, and so is the gate that would have stopped it. Another program still reads."""

    async def main() -> None:
        rig = await DynamixelRig().armed()
        await rig.cycles(1, write=True)
        last = await rig.cycles(60)
        assert rig.all_of(table.BUS_WATCHDOG) == [table.WATCHDOG_TRIPPED] * 6
        age_s = (rig.clock.now_ns() - last.t_ns) / 1e9
        assert age_s > 1.0, "the last known state is reported with its age"
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert (await rig.wire.read()).t_ns == rig.clock.now_ns()

    virtual(main)


def test_a_servo_that_did_not_take_the_hold_is_not_fed() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        await rig.cycles(3, write=True)
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: 0 if address == table.PROFILE_VELOCITY.address else keep(address, data)
        reports = await rig.wire.make_safe("hold")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        assert reports[VICTIM - 1].detail.startswith("goal is ")
        await rig.cycles(20)
        assert rig.all_of(table.BUS_WATCHDOG)[VICTIM - 1] == table.WATCHDOG_TRIPPED, (
            "the firmware stopped the servo"
        )

    virtual(main)


# -- safe


@pytest.mark.parametrize(
    ("fault", "detail"), [(Fault.OFF, "silent"), (Fault.DELAYED, "silent"), (Fault.GARBAGE, "bad reply")]
)
def test_stop_reaches_the_others_and_names_the_one(fault: Fault, detail: str) -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        rig.bus.set_fault(fault, VICTIM)
        reports = await rig.wire.make_safe("limp")
        assert verdicts(reports) == {key: key != "elbow_flex" for key in JOINTS}
        victim = reports[VICTIM - 1]
        assert (victim.written, victim.acknowledged, victim.detail) == (True, False, detail)

    virtual(main)


@pytest.mark.parametrize("error", [0, protocol.RESULT_FAIL])
def test_a_motor_that_stays_driven_is_named(error: int) -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: error if address == 64 else keep(address, data)
        victim = (await rig.wire.make_safe("limp"))[VICTIM - 1]
        assert (victim.safe, victim.acknowledged) == (False, True)
        assert victim.detail == ("refuses: result fail" if error else "still energised")

    virtual(main)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    "torn",
    [
        pytest.param(protocol.goals(dict.fromkeys(range(1, 7), 3000)), id="setpoint"),
        pytest.param(protocol.hold(dict.fromkeys(range(1, 7), 9)), id="hold"),
    ],
)
def test_safe_frames_survive_half_a_frame(torn: bytes) -> None:
    """The unfinished frame swallows bytes of ours, wherever it was cut."""

    async def main() -> None:
        for cut in range(1, len(torn)):
            rig = await DynamixelRig().armed()
            rig.port.write(torn[:cut])
            rig.port.written.clear()
            assert all(verdicts(await rig.wire.make_safe("limp")).values()), cut
            assert rig.torque() == [0] * 6
            assert len(rig.port.written) == 5, "four frames of torque off and one question"

    virtual(main)


def test_hold_keeps_the_arm_where_it_is() -> None:
    async def main() -> None:
        rig = await DynamixelRig().armed()
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


# -- the twin's own process, on a pty


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("koch", tmp_path) as process:
        yield process


@pytest.mark.parametrize("safe_state", ["limp", "hold"])
def test_the_stop_channel_makes_the_robot_of_a_dead_owner_safe(twin: Twin, safe_state: str) -> None:
    async def main() -> None:
        driver = Dynamixel("koch", twin.port, Dynamixel.resolve("koch", {}))
        wire = driver.open_wire(MonotonicClock())
        await wire.open()
        await wire.arm(Permission())
        descriptors = [os.dup(fd) for fd in wire.handover()]
        os.write(wire.handover()[0], protocol.goals(dict.fromkeys(driver.ids, 3000))[:17])  # it died within a frame
        os.close(wire.handover()[0])  # as the kernel does, without a goodbye

        second = driver.stop_channel(descriptors, MonotonicClock())
        before = len(list(twin.log.entries()))
        reports = await second.make_safe(safe_state)
        assert all(report.safe and report.written for report in reports), reports
        after = [entry for entry in list(twin.log.entries())[before:] if entry.sender == "host"]
        assert {entry.kind for entry in after} <= {"safe", "read", "other"}
        assert safe_state in {entry.safe_state for entry in after}
        second.close()

    trio.run(main)


def test_saf_013_a_watchdog_that_another_program_switches_off_is_a_fault() -> None:
    """The arm would no longer stop by itself."""

    async def main() -> None:
        rig = await DynamixelRig().armed()
        rig.servo(VICTIM).table[table.BUS_WATCHDOG.address] = table.WATCHDOG_OFF
        seen = await rig.cycles(60, write=True)
        assert seen.faults == {JOINTS[VICTIM - 1]: UNARMED}
        assert FAULT_CODES[UNARMED] == "watchdog_off" and FAULT_CODES[UNARMED].remedy
        await rig.wire.make_safe("limp")
        await rig.wire.arm(Permission())
        seen = await rig.cycles(60, write=True)
        assert seen.faults == {}, "a resume arms the watchdog again"

    virtual(main)
