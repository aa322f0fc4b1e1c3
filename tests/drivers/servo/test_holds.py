"""Test that a hold of servos moves no joint and energises none, with any readings (SAF-019). The tests
run on the twin's servos in memory, in virtual time."""

from __future__ import annotations

import contextlib
from collections.abc import Iterable
from typing import Any

import pytest
import trio

from strands_actors.contract.wire import PermitDenied
from strands_actors.drivers.common.dynamixel import table
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech import protocol as feetech
from tests.drivers.common.memory_port import Permission, virtual

from .rig import JOINTS, MOVED, VICTIM, DynamixelRig, FeetechRig, Rig

both = pytest.mark.parametrize("rig_class", [FeetechRig, DynamixelRig])
FAR = (90.0, -50.0, 60.0, 60.0, -90.0, 90.0)
ONE_DEG = 11


def registers(rig: Rig) -> tuple[Any, Any]:
    """Return the registers of goal and position."""
    if isinstance(rig, FeetechRig):
        return feetech.GOAL_POSITION, feetech.POSITION
    return table.GOAL_POSITION, table.POSITION


def where(rig: Rig) -> list[int]:
    """Return the true positions of the joints in the model."""
    rig.bus.pass_time()
    for servo in rig.bus.servos:
        servo.sense()
    return rig.all_of(registers(rig)[1])


def loses_answers_of(rig: Rig, motors: Iterable[int]) -> None:
    """Drop the answers of these motors. They still receive and obey."""
    inner, lost = rig.port.peer, set(motors)

    def peer(data: bytes) -> Iterable[tuple[float, bytes]]:
        for at_s, reply in inner(data):
            (packet,) = rig.protocol.Decoder().feed(reply)
            if packet.id not in lost:
                yield at_s, reply

    rig.port.peer = peer


@both
def test_saf_019_a_joint_that_does_not_answer_keeps_its_goal(rig_class: type[Rig]) -> None:
    """An earlier version swung it back to its last reading, by 74 degrees at full speed."""

    async def main() -> None:
        rig = await rig_class().armed()
        goal, _ = registers(rig)
        await rig.cycles(3)
        before = where(rig)[VICTIM - 1]
        loses_answers_of(rig, [VICTIM])
        await rig.wire.write(FAR, Permission())
        await rig.cycles(60)
        there = where(rig)[VICTIM - 1]
        assert abs(there - before) > 30 * ONE_DEG
        reports = {report.axis: report for report in await rig.wire.make_safe("hold")}
        assert [axis for axis, report in reports.items() if not report.safe] == ["elbow_flex"]
        axis = rig.driver.joints[VICTIM - 1]
        assert rig.servo().get(goal) == axis.count(FAR[VICTIM - 1])
        await trio.sleep(1.0)
        assert abs(where(rig)[VICTIM - 1] - there) <= ONE_DEG

    virtual(main)


@both
def test_saf_019_when_no_servo_answers_every_servo_keeps_its_goal(rig_class: type[Rig]) -> None:
    """This happens in the middle of a stream, where the last readings are old."""

    async def main() -> None:
        rig = await rig_class().armed()
        goal, _ = registers(rig)
        loses_answers_of(rig, range(1, 7))
        for at in range(10):
            with contextlib.suppress(PermitDenied):  # as soon as no servo answers
                await rig.wire.write(tuple(0.1 * (at + 1) * value for value in FAR), Permission())
            await rig.wire.read()
            await trio.sleep(0.02)
        goals = rig.all_of(goal)
        began_s = trio.current_time()
        written = len(rig.port.written)
        reports = await rig.wire.make_safe("hold")
        assert rig.port.written[written][0] == began_s, "the first frame is written without any wait"
        assert rig.all_of(goal) == goals
        assert not any(report.safe for report in reports)

    virtual(main)


@both
@pytest.mark.parametrize("since_reading_s", [0.0, 0.02, 0.045, 0.2, 2.0])
def test_saf_019_a_hold_at_full_speed_pulls_no_joint_back(rig_class: type[Rig], since_reading_s: float) -> None:
    async def main() -> None:
        rig = await rig_class().armed()
        await rig.wire.write(FAR, Permission())
        await trio.sleep(0.15)
        await rig.wire.read()
        await trio.sleep(since_reading_s)
        began, began_s, written = where(rig), trio.current_time(), len(rig.port.written)
        reports = await rig.wire.make_safe("hold")
        assert rig.port.written[written][0] == began_s
        assert all(report.safe for report in reports), reports
        assert trio.current_time() - began_s < 0.05
        await trio.sleep(1.0)
        wanted = [axis.count(value) for axis, value in zip(rig.driver.joints, FAR, strict=True)]
        for before, after, far in zip(began, where(rig), wanted, strict=True):
            onward = 1 if far > before else -1
            assert (after - before) * onward >= -2 * ONE_DEG, "no joint moves back"
            assert abs(after - before) <= 10 * ONE_DEG, "every joint stops"

    virtual(main)


@both
def test_saf_019_a_reading_from_before_a_setpoint_does_not_count(rig_class: type[Rig]) -> None:
    """The joint was at rest when it was read, and has been sent away since."""

    async def main() -> None:
        rig = await rig_class().armed()
        await rig.cycles(3)
        await rig.wire.read()
        await rig.wire.write(FAR, Permission())
        await trio.sleep(0.045)
        began = where(rig)
        await rig.wire.make_safe("hold")
        await trio.sleep(1.0)
        for before, after in zip(began, where(rig), strict=True):
            assert abs(after - before) <= 8 * ONE_DEG

    virtual(main)


@pytest.mark.parametrize("heard", [True, False], ids=["read since", "not read since"])
def test_saf_019_a_hold_energises_no_motor_that_is_limp(heard: bool) -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        await rig.cycles(3, write=True)
        await trio.sleep(1.0)
        rig.servo().power_cycle()
        if heard:
            await rig.wire.read()
        else:
            rig.wire.session.health.update([VICTIM], [], rig.clock.now_ns())
            rig.wire.session.health.update([VICTIM], [], rig.clock.now_ns())
        reports = {report.axis: report for report in await rig.wire.make_safe("hold")}
        assert rig.torque() == [1, 1, 0, 1, 1, 1]
        assert (reports["elbow_flex"].safe, reports["elbow_flex"].detail) == (False, "limp")
        assert all(report.safe for axis, report in reports.items() if axis != "elbow_flex")

    virtual(main)


def test_a_setpoint_energises_no_motor_that_is_limp() -> None:
    """A goal for the whole arm would energise a servo that lost its torque, and pull it to an old target."""

    async def main() -> None:
        rig = await FeetechRig().armed()
        await rig.cycles(20, write=True)
        rig.servo().power_cycle()
        await rig.wire.read()
        await rig.cycles(20, write=True)
        assert rig.torque() == [1, 1, 0, 1, 1, 1]

    virtual(main)


def test_a_servo_after_a_power_loss_is_not_energised_by_the_others_setpoints() -> None:
    async def main() -> None:
        rig = await FeetechRig().armed()
        rig.bus.set_fault(Fault.OFF, VICTIM)
        await rig.cycles(30, write=True)
        rig.bus.set_fault(Fault.OK, VICTIM)
        seen = await rig.cycles(60, write=True)
        assert seen.faults == {"elbow_flex": "limp"}
        assert rig.torque() == [1, 1, 0, 1, 1, 1]

    virtual(main)


@both
def test_saf_002_no_goal_follows_a_limp(rig_class: type[Rig]) -> None:
    async def main() -> None:
        rig = await rig_class().armed()
        await rig.cycles(3, write=True)
        assert all(report.safe for report in await rig.wire.make_safe("limp"))
        with pytest.raises(PermitDenied):
            await rig.wire.write(MOVED, Permission())
        assert all(report.detail == "limp" for report in await rig.wire.make_safe("hold"))
        assert rig.torque() == [0] * len(JOINTS)

    virtual(main)


@pytest.mark.parametrize("goal_energises", [True, False], ids=["a goal energises", "torque alone does"])
def test_saf_011_arming_moves_no_joint(goal_energises: bool) -> None:
    """The arm leans on its stops, with old goals in its servos."""

    async def main() -> None:
        rig = FeetechRig(goal_energises=goal_energises)
        await rig.wire.open()
        for servo in rig.bus.servos:
            servo.put(feetech.GOAL_POSITION, 100)
        await trio.sleep(2.0)
        before = where(rig)
        await rig.wire.arm(Permission())
        assert rig.torque() == [1] * 6
        await trio.sleep(1.0)
        assert all(abs(after - count) <= ONE_DEG for after, count in zip(where(rig), before, strict=True))

    virtual(main)
