"""The frames of each stop of an arm of CAN motors, and the confirmation of the stop."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import trio

from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown
from strands_actors.drivers.can_motors.protocol import State
from strands_actors.drivers.can_motors.stopping import DAMP_S, ZERO_S
from strands_actors.drivers.common.twin.faults import Fault
from tests.drivers.common.memory_port import Permission, virtual

from .rig import ROBSTRIDE, Rig
from .test_wire import arms

RAISED = {"joint_1": 0.3, "joint_4": 1.0}


async def raised(**options: Any) -> Rig:
    rig = await Rig(**options).armed()
    await rig.put(**RAISED)
    return rig


def unsafe(reports: tuple[MotorReport, ...]) -> dict[str, str]:
    return {report.axis: report.detail for report in reports if not report.safe}


@pytest.mark.parametrize(
    ("safe_state", "data"),
    [
        (SafeState.DAMP, "7ffc000"),  # speed 0, kp 0, and then the gains of the table
        (SafeState.ZERO_TORQUE, "7ff000000"),
        (SafeState.LIMP, "fffffffffffffffd"),
        (SafeState.OFF, "fffffffffffffffd"),
    ],
)
def test_saf_003_the_first_frames_leave_before_the_first_wait(safe_state: SafeState, data: str) -> None:
    async def main() -> None:
        rig = await raised()
        began = trio.current_time()
        with trio.move_on_after(0):
            await rig.wire.make_safe(safe_state)
        sent = rig.sent()
        assert {frame.id for frame in sent} == set(range(1, 9)), "one for each motor"
        assert all(at == began for at, kind, _ in rig.notes if kind == "safe")
        assert [kind for kind in rig.kinds() if kind != "other"] == ["safe"] * 8
        if safe_state in (SafeState.LIMP, SafeState.OFF):
            assert {frame.data.hex() for frame in sent} == {data}
        else:
            stiffness = {int.from_bytes(frame.data, "big") >> 24 & 0xFFF for frame in sent}
            assert stiffness == {0}

    virtual(main)


@arms
def test_damping_brings_the_arm_down_slowly_and_then_disables_it(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = await Rig(**arm).armed()
        await rig.put(**{rig.driver.axes[0]: 0.8})
        began = trio.current_time()
        reports = await rig.wire.make_safe(SafeState.DAMP)
        assert trio.current_time() - began < DAMP_S + 0.3
        assert unsafe(reports) == {}
        assert rig.states() == {State.DISABLED}
        states = [state for _, kind, state in rig.notes if kind == "safe" and state]
        assert states[0] == SafeState.DAMP
        assert states[-1] == SafeState.LIMP
        assert "setpoint" not in rig.kinds()
        assert all(report.written and report.acknowledged for report in reports)

    virtual(main)


def test_damping_is_slower_than_a_fall() -> None:
    async def main() -> None:
        speeds = {}
        for safe_state in (SafeState.DAMP, SafeState.LIMP):
            rig = await raised()
            fastest = 0.0
            async with trio.open_nursery() as nursery:

                async def watch(rig: Rig = rig) -> None:
                    nonlocal fastest
                    for _ in range(30):
                        rig.robot.pass_time()
                        fastest = max(fastest, max(map(abs, rig.robot.plant.velocity_rad_s)))
                        await trio.sleep(0.01)

                nursery.start_soon(watch)
                await rig.wire.make_safe(safe_state)
            speeds[safe_state] = fastest
        assert speeds[SafeState.DAMP] < 0.5 * speeds[SafeState.LIMP], speeds

    virtual(main)


def test_zero_torque_is_short() -> None:
    async def main() -> None:
        rig = await raised()
        began = trio.current_time()
        assert unsafe(await rig.wire.make_safe(SafeState.ZERO_TORQUE)) == {}
        assert trio.current_time() - began < ZERO_S + 0.1

    virtual(main)


def test_a_lowered_arm_is_driven_to_its_rest_pose() -> None:
    async def main() -> None:
        rig = await raised()
        reports = await rig.wire.make_safe(SafeState.LOWERED)
        assert unsafe(reports) == {}
        assert rig.wire.ended_in is None
        assert rig.states() == {State.DISABLED}
        assert rig.robot.plant.position_rad == pytest.approx((0.0,) * 8, abs=0.1)
        assert "setpoint" not in rig.kinds()

    virtual(main)


def test_an_arm_that_meets_something_while_it_is_lowered_is_damped() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.put(joint_4=1.5)
        rig.robot.plant.set_stuck(3, True)
        reports = await rig.wire.make_safe(SafeState.LOWERED)
        assert unsafe(reports) == {}
        assert rig.wire.ended_in is SafeState.DAMP

    virtual(main)


def test_a_lowering_shows_its_readings() -> None:
    async def main() -> None:
        rig = await raised()
        assert rig.wire.seen is None
        seen = []
        async with trio.open_nursery() as nursery:

            async def look() -> None:
                await trio.sleep(0.2)
                seen.append(rig.wire.seen)

            nursery.start_soon(look)
            with trio.move_on_after(0.3):
                await rig.wire.make_safe(SafeState.LOWERED)
        assert seen[0] is not None

    virtual(main)


@arms
def test_a_hold_keeps_the_last_target(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = await Rig(**arm).armed()
        key = rig.driver.axes[0]
        await rig.put(**{key: 0.4})
        reports = await rig.wire.make_safe(SafeState.HOLD)
        assert unsafe(reports) == {}
        assert reports[0].target == pytest.approx(0.4)
        assert set(rig.kinds()) == {"safe"}
        before = rig.robot.plant.position_rad
        await rig.rest(0.5)
        assert rig.robot.plant.position_rad == pytest.approx(before, abs=0.02), "it does not sag"
        assert rig.states() == {State.ENABLED}

    virtual(main)


def test_a_blocked_joint_is_held_where_it_is() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.robot.plant.set_stuck(0, True)
        await rig.stream(0.1, joint_1=0.5)
        reports = await rig.wire.make_safe(SafeState.HOLD)
        assert reports[0].target == pytest.approx(0.0, abs=0.02)

    virtual(main)


def test_a_hold_that_one_motor_does_not_confirm_damps_the_arm() -> None:
    async def main() -> None:
        rig = await raised()
        rig.robot.motor("joint_3").switch(State.UNDERVOLTAGE)
        reports = await rig.wire.make_safe(SafeState.HOLD)
        assert rig.wire.hold_failed == "joint_3: undervoltage"
        assert unsafe(reports) == {}
        assert rig.states() == {State.DISABLED, State.UNDERVOLTAGE}

    virtual(main)


def test_a_table_may_let_the_others_hold() -> None:
    async def main() -> None:
        rig = await Rig("mine", {**ROBSTRIDE, "on_silence": "hold"}).armed()
        rig.robot.set_fault(Fault.HALF_OPEN, 2)
        await rig.rest(0.05)
        reports = await rig.wire.make_safe(SafeState.HOLD)
        assert rig.wire.hold_failed == ""
        assert unsafe(reports) == {"joint2": "silent"}
        await rig.rest(1.0)
        assert rig.states() == {State.ENABLED}

    virtual(main)


def test_a_silent_motor_is_not_confirmed_and_the_others_are() -> None:
    async def main() -> None:
        rig = await raised()
        rig.robot.set_fault(Fault.HALF_OPEN, 4)
        reports = await rig.wire.make_safe(SafeState.DAMP)
        assert unsafe(reports) == {"joint_4": "silent"}
        assert rig.states() == {State.DISABLED}, "it received the frames all the same"

    virtual(main)


def test_a_lost_bus_does_not_delay_the_other() -> None:
    async def main() -> None:
        rig = await Rig("bi_openarm").armed()
        rig.opened[0].unplugged = True
        reports = await rig.wire.make_safe(SafeState.DAMP)
        left = {report.axis for report in reports if not report.safe}
        assert left == {key for key in rig.driver.axes if key.startswith("left_")}
        assert not any(report.written for report in reports if report.axis in left)
        await trio.sleep(0.5)
        states = {motor.motor.key: motor.state for motor in rig.robot.motors}
        assert rig.states() == {State.DISABLED, State.LOST_COMMUNICATION}
        assert states["right_joint_1"] is State.DISABLED

    virtual(main)


def test_reach_stops_the_arm_over_a_new_port() -> None:
    async def main() -> None:
        rig = await raised()
        rig.opened[0].unplugged = True
        with pytest.raises(WireDown):
            await rig.wire.read()
        reports = await rig.wire.reach(SafeState.DAMP)
        assert unsafe(reports) == {}
        assert len(rig.opened) == 2
        assert rig.opened[1].closed, "nothing stays open that would keep another process out"

    virtual(main)


@arms
def test_the_root_stops_the_arm_over_its_own_channel(arm: Mapping[str, Any]) -> None:
    async def main() -> None:
        rig = await Rig(**arm).armed()
        await rig.put(**{rig.driver.axes[0]: 0.3})
        channel = rig.stop_channel()
        reports = await channel.make_safe(SafeState.HOLD)
        assert unsafe(reports) == {}
        states = [state for _, kind, state in rig.notes if kind == "safe" and state]
        assert states[0] == SafeState.DAMP, "the root cannot repeat a hold, so it damps"
        channel.close()

    virtual(main)


def test_a_stop_of_an_arm_that_was_never_armed() -> None:
    async def main() -> None:
        rig = Rig()
        assert not any(report.written for report in await rig.wire.make_safe(SafeState.DAMP))
        await rig.wire.open()
        rig.forget()
        for safe_state in (SafeState.HOLD, SafeState.LOWERED):
            assert unsafe(await rig.wire.make_safe(safe_state)) == {}
        assert "setpoint" not in rig.kinds()
        await rig.wire.arm(Permission())

    virtual(main)
