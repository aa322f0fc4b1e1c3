"""Test how the Feetech wire reads, writes and makes safe, on the twin's servos in memory and virtual time."""

from __future__ import annotations

import math
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import Observation, PermitDenied, WireDown
from strands_actors.drivers.common.ports.half_duplex import QUIET_S
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech import protocol
from strands_actors.drivers.feetech.driver import Feetech
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import JOINTS, VICTIM, FeetechRig, read_until, verdicts

# -- read and write


def test_read_gives_every_row_in_the_drivers_units() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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


@pytest.mark.parametrize("is_coarse", [False, True])
def test_a_speed_is_read_in_the_unit_that_the_servo_has(is_coarse: bool) -> None:
    """A lowering that took 50 counts/s for one would let the arm fall."""

    async def main() -> None:
        rig = FeetechRig()
        if is_coarse:
            for servo in rig.bus.servos:
                servo.table[protocol.PHASE.address] &= ~protocol.SPEED_IN_COUNTS
        await rig.armed()
        before = await rig.wire.read()
        await rig.wire.write((before.position[0] + 20.0, *before.position[1:]), Permission())
        fastest = 0.0
        for _ in range(40):
            await trio.sleep(0.01)
            seen = await rig.wire.read()
            fastest = max(fastest, abs(seen.velocity[0]))
        assert abs(seen.position[0] - before.position[0]) > 10
        assert 30 < fastest < 400, "degrees a second"

    virtual(main)


def test_an_overload_that_arming_clears_does_not_refuse_the_first_setpoint() -> None:
    async def main() -> None:
        rig = FeetechRig()
        servo = rig.bus.servos[VICTIM - 1]
        servo._tripped = overload = 32
        await rig.wire.open()
        assert servo.error == overload, "connecting energises nothing, so the error stays"
        seen = await rig.wire.arm(Permission())
        assert servo.error == 0
        assert seen.faults == {}

    virtual(main)


def test_write_checks_the_permit_last_and_writes_one_frame() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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
        rig = await FeetechRig().armed()
        target = (20.0, -10.0, 15.0, 10.0, -20.0, 40.0)
        seen = await rig.wire.read()
        for _ in range(100):
            await rig.wire.write(target, Permission())
            seen = await rig.wire.read()
            await trio.sleep(0.02)
        assert seen.position == pytest.approx(target, abs=3.0)

    virtual(main)


def test_a_silent_servo_keeps_its_stamp_and_delays_no_other() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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
        assert slowest_s < 0.03, "the quiet time does not delay the caller"

        rig.bus.set_fault(Fault.OK, VICTIM)
        await read_until(rig.wire, lambda seen: seen.faults == {"elbow_flex": "limp"})
        # Its power came back, its torque did not.

    virtual(main)


def _fields(seen: Observation) -> dict[str, Any]:
    return {name: getattr(seen, name) for name in seen.__struct_fields__}


def test_in_the_quiet_time_the_last_observation_is_returned_at_once() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        last = await rig.wire.read()
        written, began = len(rig.port.written), trio.current_time()
        assert await rig.wire.read() is last
        assert trio.current_time() == began
        assert len(rig.port.written) == written
        await rig.wire.write((0.0,) * 6, Permission())
        assert len(rig.port.written) == written + 1, "a setpoint is sent all the same"
        await trio.sleep(QUIET_S)
        assert await rig.wire.read() is not last

    virtual(main)


def test_a_cancelled_read_without_an_answer_delays_only_the_next_read() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        last = await rig.wire.read()
        rig.bus.set_fault(Fault.OFF)
        with trio.move_on_after(0.0005) as cut:
            await rig.wire.read()
        assert cut.cancelled_caught
        assert await rig.wire.read() is last
        with pytest.raises(WireDown, match="no servo of so101 answers"), trio.fail_after(3):
            while True:
                await rig.wire.read()
                await trio.sleep(0.01)

    virtual(main)


def test_a_bus_that_falls_silent_is_a_lost_link() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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
        rig = await FeetechRig().armed()
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
        rig = FeetechRig()
        await rig.wire.open()
        for _ in range(100):
            assert (await rig.wire.read()).faults == {}, "missing torque is no fault before arming"
            await trio.sleep(0.01)
        await rig.wire.arm(Permission())
        rig.servo().power_cycle()
        await trio.sleep(0.6)
        await rig.wire.read()
        await trio.sleep(0.6)
        seen = await rig.wire.read()
        assert seen.faults == {"elbow_flex": "limp"}
        await rig.wire.make_safe("limp")
        assert (await rig.wire.read()).faults == {}, "limp is no fault after the order to go limp"

    virtual(main)


def test_the_fault_of_a_servo_is_named() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        rig.servo().voltage_v = 3.9
        seen = await rig.wire.read()
        assert seen.faults == {"elbow_flex": "voltage"}
        assert seen.sensors["voltage_v"][VICTIM - 1] == 3.9
        assert seen.sensors["voltage_min_v"][VICTIM - 1] == 4.0

    virtual(main)


def test_a_late_servo_never_gives_an_older_reading() -> None:
    """The servo answers 60 ms late while its joint moves. No reading may be older than the one before."""

    async def main() -> None:
        rig = await FeetechRig().armed()
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


@pytest.mark.parametrize(
    ("fault", "detail"), [(Fault.OFF, "silent"), (Fault.DELAYED, "silent"), (Fault.GARBAGE, "bad reply")]
)
@pytest.mark.parametrize("quiet", [False, True])
def test_stop_reaches_the_others_and_names_the_one(fault: Fault, detail: str, quiet: bool) -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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
        rig = await FeetechRig().armed()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: (
            None if address == protocol.TORQUE_ENABLE.address else keep(address, data)
        )
        victim = (await rig.wire.make_safe("limp"))[VICTIM - 1]
        assert (victim.safe, victim.acknowledged, victim.detail) == (False, True, "still energised")

    virtual(main)


def test_safe_frames_survive_half_a_setpoint() -> None:
    """The unfinished frame swallows bytes of ours, wherever it was cut."""

    async def main() -> None:
        setpoint = protocol.sync_write(protocol.GOAL_POSITION, dict.fromkeys(range(1, 7), 3000))
        for cut in range(1, len(setpoint)):
            rig = await FeetechRig().armed()
            rig.port.write(setpoint[:cut])
            rig.port.written.clear()
            assert all(verdicts(await rig.wire.make_safe("limp")).values()), cut
            assert rig.torque() == [0] * 6
            assert len(rig.port.written) == 4, "three frames of torque off and one question"

    virtual(main)


def test_hold_keeps_the_arm_where_it_is() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
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
        goals = {motor.id: axis.count(motor.target) for axis, motor in zip(rig.driver.joints, reports, strict=True)}
        assert at == began and protocol.hold(counts) not in first, "no servo is pulled back to an old position"
        assert rig.all_of(protocol.GOAL_POSITION) == list(goals.values())
        assert rig.torque() == [1] * 6
        assert rig.requests("setpoint", "enable") == []
        await trio.sleep(1)
        rested = await rig.wire.read()
        assert rested.position == pytest.approx(seen.position, abs=8.0)
        assert rested.faults == {}

    virtual(main)


def test_a_hold_reads_again_when_its_readings_are_old() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        await rig.wire.write((30.0, 20.0, 20.0, 10.0, 10.0, 50.0), Permission())
        await trio.sleep(2)
        began = trio.current_time()
        rig.port.written.clear()
        assert all(verdicts(await rig.wire.make_safe("hold")).values())
        assert rig.port.written[0][0] == began
        there = [servo.get(protocol.POSITION) for servo in rig.bus.servos]
        goals = [servo.get(protocol.GOAL_POSITION) for servo in rig.bus.servos]
        assert goals == pytest.approx(there, abs=60), (
            "the goals are the present positions, not those of two seconds ago"
        )

    virtual(main)


def test_hold_names_a_motor_that_is_limp_and_one_that_is_silent() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        rig.servo(5).power_cycle()
        await rig.wire.read()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        reports = {report.axis: report for report in await rig.wire.make_safe("hold")}
        assert {key for key, report in reports.items() if not report.safe} == {"elbow_flex", "wrist_roll"}
        assert reports["elbow_flex"].detail == "silent"
        assert reports["wrist_roll"].detail == "limp"

    virtual(main)


@pytest.mark.parametrize("robot", Feetech.SUPPORTED_ROBOTS)
def test_every_robot_opens_arms_moves_and_stops(robot: str) -> None:
    async def main() -> None:
        rig = FeetechRig(robot)
        await rig.wire.open()
        seen = await rig.wire.arm(Permission())
        assert all(map(math.isfinite, seen.position))
        await rig.wire.write(seen.position, Permission())
        assert (await rig.wire.read()).faults == {}
        assert all(report.safe for report in await rig.wire.make_safe("hold"))
        assert all(report.safe for report in await rig.wire.make_safe("limp"))

    virtual(main)
