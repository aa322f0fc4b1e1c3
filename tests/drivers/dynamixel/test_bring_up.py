"""Test how the Dynamixel wire is opened and armed, on the twin's servos in memory and virtual time."""

from __future__ import annotations

import json

import pytest

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.dynamixel import protocol, table, watchdog
from strands_actors.drivers.common.twin import Fault
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import JOINTS, VICTIM, DynamixelRig, refused, verdicts

# -- open


def test_open_lists_the_servos_moves_nothing_and_rewrites_no_eeprom() -> None:
    async def main() -> None:
        rig = DynamixelRig()
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
        rig = DynamixelRig()
        for servo in rig.bus.servos:
            servo.put(table.STATUS_LEVEL, 0)
        await rig.wire.open()
        assert rig.all_of(table.STATUS_LEVEL) == [2] * 6

    virtual(main)


def test_dead_double_and_foreign_servos_are_named() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        assert "elbow_flex (id 3) does not answer" in await refused(rig)
        rig = DynamixelRig()
        rig.bus.set_fault(Fault.OFF)
        assert "no servo of koch answers on memory at 1000000 baud" in await refused(rig)
        rig = DynamixelRig()
        rig.servo(4).put(table.ID, VICTIM)
        assert "elbow_flex (id 3) answers more than once" in await refused(rig)
        rig = DynamixelRig()
        rig.servo(4).put(table.ID, 9)
        assert "id 9 is not of koch" in await refused(rig)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "value", "says"),
    [
        (table.MODEL, 1190, "elbow_flex (id 3) is a XL330-M077, must be XL330-M288"),
        (table.MODEL, 4242, "elbow_flex (id 3) is a model 4242, must be XL330-M288"),
        (table.MODE, 1, "elbow_flex (id 3) is in mode 1 (velocity), must be in mode 3, 4 or 5"),
    ],
)
def test_another_servo_is_refused(register: table.Register, value: int, says: str) -> None:
    async def main() -> None:
        rig = DynamixelRig()
        rig.servo().put(register, value)
        assert says in await refused(rig)

    virtual(main)


def calibration() -> dict[str, dict[str, int]]:
    return {
        key: {"id": at, "drive_mode": 0, "homing_offset": 11 * at, "range_min": 700 + at, "range_max": 3300 + at}
        for at, key in enumerate(JOINTS, 1)
    }


def calibrate(rig: DynamixelRig) -> None:
    for servo, motor in zip(rig.bus.servos, calibration().values(), strict=True):
        servo.put(table.HOMING_OFFSET, motor["homing_offset"])
        servo.put(table.MIN_POSITION, motor["range_min"])
        servo.put(table.MAX_POSITION, motor["range_max"])


def test_the_calibrated_robot_is_accepted() -> None:
    async def main() -> None:
        rig = DynamixelRig(calibration=calibration())
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
        rig = DynamixelRig(calibration=calibration())
        calibrate(rig)
        rig.servo().put(register, value)
        assert f"the calibration has {field} for elbow_flex, servo 3 has {value}" in await refused(rig)

    virtual(main)


# -- arm


def test_arm_sets_the_goal_first_energises_one_by_one_and_arms_every_watchdog_last() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(table.GOAL_POSITION, 100)  # an old goal: energising on it would cause a jump
        rig.port.written.clear()
        permission = Permission(rig.port)
        seen = await rig.wire.arm(permission)

        moving = rig.requests("safe", "enable", "setpoint", "config")
        assert [protocol.classify(packet) for packet in moving] == ["config", *["safe", "enable"] * 6, "config"]
        assert [list(protocol.rows_of(packet)[1]) for packet in moving[1:-1:2]] == [[at] for at in range(1, 7)]
        assert [packet.id for packet in moving[2:-1:2]] == [1, 2, 3, 4, 5, 6]
        assert moving[-1].params == bytes((98, 0, 1, 0, 1, 15, 2, 15, 3, 15, 4, 15, 5, 15, 6, 15))
        assert rig.requests()[-1].params == bytes((98, 0, 1, 0, 1, 2, 3, 4, 5, 6)), (
            "the indirect addresses are read back"
        )
        assert rig.torque() == [1] * 6
        assert rig.all_of(table.BUS_WATCHDOG) == [watchdog.COUNTS] * 6
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(table.GOAL_POSITION)
        assert seen.faults == {}
        assert permission.checks == 13, "the permit is checked before each goal, each torque and the watchdogs"

    virtual(main)


@pytest.mark.parametrize("denied_at", range(13))
def test_saf_009_a_stop_during_bring_up_wins(denied_at: int) -> None:
    async def main() -> None:
        rig = DynamixelRig()
        await rig.wire.open()
        permission = Permission(rig.port, denied_at=denied_at)
        with pytest.raises(PermitDenied):
            await rig.wire.arm(permission)
        assert sum(rig.torque()) == denied_at // 2
        assert len(rig.port.written) == permission.written_before[-1], (
            "nothing is written after the permit is denied"
        )
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert rig.torque() == [0] * 6

    virtual(main)


def test_a_watchdog_that_does_not_arm_is_named() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        await rig.wire.open()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: 0 if (address, data) == (98, b"\x0f") else keep(address, data)
        with pytest.raises(WireDown, match=r"bus watchdog register \(98\) of elbow_flex \(id 3\) is 0, must be 15"):
            await rig.wire.arm(Permission())

    virtual(main)


def test_a_latched_alert_is_not_energised() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        rig.servo().put(table.HARDWARE_ERROR, table.OVERLOAD_BIT)
        assert (await rig.wire.open())["hardware_alert"]["elbow_flex"] == "overload"
        expected = r"elbow_flex \(id 3\) has stored a hardware error \(overload\).*support the arm, then reboot"
        with pytest.raises(WireDown, match=expected):
            await rig.wire.arm(Permission())
        assert rig.torque() == [0] * 6

    virtual(main)


def test_a_servo_that_refuses_torque_is_named_with_its_error() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        await rig.wire.open()
        servo = rig.servo()
        keep = servo.write
        servo.write = lambda address, data: protocol.RESULT_FAIL if address == 64 else keep(address, data)
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) does not confirm torque on \(result fail\)"):
            await rig.wire.arm(Permission())

    virtual(main)


def test_arm_refuses_a_joint_that_rests_outside_in_every_mode() -> None:
    async def main() -> None:
        rig = DynamixelRig()
        rig.servo().put(table.MODE, table.POSITION_MODE)
        rig.servo().put(table.MIN_POSITION, 2600)
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) is .* deg outside its range"):
            await rig.wire.arm(Permission())
        rig = DynamixelRig()
        rig.servo().put(table.HOMING_OFFSET, 4096)  # one turn away
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) is .* deg outside its range"):
            await rig.wire.arm(Permission())
        assert rig.torque() == [0] * 6

    virtual(main)
