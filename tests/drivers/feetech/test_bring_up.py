"""Test how the Feetech wire is opened and armed, on the twin's servos in memory and virtual time."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech import protocol
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import JOINTS, VICTIM, FeetechRig, refused, verdicts

# -- open


def test_open_lists_the_servos_and_moves_nothing() -> None:
    async def main() -> None:
        rig = FeetechRig()
        facts = await rig.wire.open()
        assert facts["model"] == dict.fromkeys(JOINTS, "STS3215")
        assert facts["firmware"] == dict.fromkeys(JOINTS, "3.10")
        assert facts["voltage_v"] == dict.fromkeys(JOINTS, 7.4)
        assert facts["energised"] == dict.fromkeys(JOINTS, False)
        assert facts["calibration_source"] == "none: the travel of its model"
        json.dumps(facts)
        assert rig.requests("setpoint", "enable", "safe", "other") == []
        assert rig.torque() == [0] * 6
        assert tuple(rig.wire.handover()) == (rig.port.fileno(),)

    virtual(main)


def test_open_takes_the_return_delay_away_until_power_off() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(protocol.LOCK, 0)
        await rig.wire.open()
        assert [servo.get(protocol.RETURN_DELAY) for servo in rig.bus.servos] == [0] * 6
        rig.bus.power_cycle()
        assert [servo.get(protocol.RETURN_DELAY) for servo in rig.bus.servos] == [250] * 6

    virtual(main)


def test_a_speed_limit_of_another_program_is_lifted_when_it_is_armed_and_not_before() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(protocol.GOAL_VELOCITY, 50)
        facts = await rig.wire.open()
        assert facts["speed_limit"]["elbow_flex"] == 50 == rig.servo().get(protocol.GOAL_VELOCITY)
        await rig.wire.arm(Permission())
        assert rig.servo().get(protocol.GOAL_VELOCITY) == 0

    virtual(main)


def test_a_dead_servo_is_named() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        text = await refused(rig)
        assert "elbow_flex (id 3) does not answer" in text
        assert not any(other in text for other in JOINTS if other != "elbow_flex")

    virtual(main)


def test_a_silent_bus_is_not_six_dead_servos() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.bus.set_fault(Fault.OFF)
        assert "no servo of so101 answers on memory at 1000000 baud" in await refused(rig)

    virtual(main)


def test_two_servos_with_one_id_are_distinguished_from_a_dead_one() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo(4).put(protocol.ID, VICTIM)
        text = await refused(rig)
        assert "wrist_flex (id 4) does not answer" in text
        assert "elbow_flex (id 3) answers more than once" in text

    virtual(main)


def test_a_foreign_servo_is_named() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo(4).put(protocol.ID, 9)
        text = await refused(rig)
        assert "wrist_flex (id 4) does not answer" in text
        assert "id 9 is not of so101" in text

    virtual(main)


def test_garbled_answers_are_named() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.bus.set_fault(Fault.GARBAGE, VICTIM)
        assert "elbow_flex (id 3) answers more than once or garbled" in await refused(rig)

    virtual(main)


@pytest.mark.parametrize(
    ("register", "value", "says"),
    [
        (protocol.MODEL, 2825, "elbow_flex (id 3) is a STS3250, must be STS3215"),
        (protocol.MODEL, 4242, "elbow_flex (id 3) is a model 4242, must be STS3215"),
        (protocol.MODE, 1, "elbow_flex (id 3) is in mode 1, not in mode 0"),
    ],
)
def test_another_servo_is_refused(register: protocol.Register, value: int, says: str) -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(register, value)
        assert says in await refused(rig)

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


def calibrate(rig: FeetechRig) -> None:
    for servo, motor in zip(rig.bus.servos, calibration().values(), strict=True):
        servo.put(protocol.HOMING_OFFSET, motor["homing_offset"])
        servo.put(protocol.MIN_POSITION, motor["range_min"])
        servo.put(protocol.MAX_POSITION, motor["range_max"])


def test_the_calibrated_robot_is_accepted() -> None:
    async def main() -> None:
        rig = FeetechRig(calibration=calibration())
        calibrate(rig)
        facts = await rig.wire.open()
        assert facts["calibration_source"] == "given as a dict"
        seen = await rig.wire.arm(Permission())
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(protocol.GOAL_POSITION)

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
        rig = FeetechRig(calibration=calibration())
        calibrate(rig)
        rig.servo().put(register, 1000)
        assert f"the calibration has {field} for elbow_flex, servo 3 has 1000" in await refused(rig)

    virtual(main)


# -- arm


both_kinds = pytest.mark.parametrize("goal_energises", [True, False], ids=["a goal energises", "torque alone does"])


@both_kinds
def test_saf_011_arm_sets_the_goal_first_and_energises_one_by_one(goal_energises: bool) -> None:
    async def main() -> None:
        rig = FeetechRig(goal_energises=goal_energises)
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(protocol.GOAL_POSITION, 100)  # an old goal: energising on it would cause a jump
        rig.port.written.clear()
        permission = Permission(rig.port)
        seen = await rig.wire.arm(permission)

        moving = rig.requests("safe", "enable", "setpoint")
        assert [protocol.classify(packet) for packet in moving] == ["safe", "enable"] * 6
        assert [list(protocol.rows_of(packet)[1]) for packet in moving[::2]] == [[at] for at in range(1, 7)]
        assert [packet.id for packet in moving[1::2]] == [1, 2, 3, 4, 5, 6]
        assert [packet.params for packet in moving[1::2]] == [bytes((40, 1))] * 6
        assert rig.torque() == [1] * 6
        for axis, value, servo in zip(rig.driver.joints, seen.position, rig.bus.servos, strict=True):
            assert axis.count(value) == servo.get(protocol.GOAL_POSITION)
        assert seen.faults == {}
        assert all(stamp > 0 for stamp in seen.stamp_ns)
        assert permission.checks == 12, (
            "the permit is checked before each goal (which may energise) and each torque"
        )

    virtual(main)


@both_kinds
@pytest.mark.parametrize("denied_at", range(12))
def test_saf_009_a_stop_during_bring_up_wins(goal_energises: bool, denied_at: int) -> None:
    async def main() -> None:
        rig = FeetechRig(goal_energises=goal_energises)
        await rig.wire.open()
        permission = Permission(rig.port, denied_at)
        with pytest.raises(PermitDenied):
            await rig.wire.arm(permission)
        energised = (denied_at + goal_energises) // 2
        assert rig.torque() == [1] * energised + [0] * (6 - energised)
        assert len(rig.port.written) == permission.written_before[-1], (
            "nothing is written after the permit is denied"
        )
        assert all(verdicts(await rig.wire.make_safe("limp")).values())
        assert rig.torque() == [0] * 6

    virtual(main)


@pytest.mark.parametrize(
    ("lost", "says"),
    [
        (lambda packet: packet.id == 4 and packet.code == protocol.WRITE, "does not confirm torque on"),
        (lambda packet: packet == (4, protocol.READ, bytes((40, 1))), "does not report whether it has torque"),
        (lambda packet: packet.code == protocol.SYNC_WRITE, "did not take its present position as goal"),
    ],
)
def test_a_motor_that_does_not_confirm_is_named(lost: Callable[[protocol.Packet], bool], says: str) -> None:
    async def main() -> None:
        rig = FeetechRig()
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
        rig = FeetechRig()
        await rig.wire.open()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        with pytest.raises(WireDown, match=r"arming: elbow_flex \(id 3\) does not report its position"):
            await rig.wire.arm(Permission())
        assert rig.requests("enable", "setpoint", "safe") == []

    virtual(main)


def test_arm_refuses_to_pull_a_joint_in() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(protocol.MIN_POSITION, 2600)
        await rig.wire.open()
        with pytest.raises(WireDown, match=r"elbow_flex \(id 3\) is .* deg outside its range"):
            await rig.wire.arm(Permission())
        assert rig.torque() == [0] * 6

    virtual(main)
