"""Test how an arm of servos is brought down before its torque goes (SAF-026), on the twin's servos with gravity."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import pytest
import trio

from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import MotorReport, WireDown, all_safe
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.common.physics.touch import Touch
from strands_actors.drivers.common.servo import lowering
from strands_actors.drivers.common.servo.bring_down import LoweringEnd
from strands_actors.drivers.common.servo.lowering import FallingTorque, RestPath, allowed_m_s, pace
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.feetech.robots import TABLES
from tests.drivers.common.memory_port import Permission, virtual
from tests.drivers.servo.rig import JOINTS, VICTIM, DynamixelRig, FeetechRig, MakeRig, Rig, raised

LIMIT_M_S = 0.15
"""Highest speed at which the arm may touch the table."""
LIMP_S = 3.0

RAISED: dict[MakeRig, list[tuple[float, ...]]] = {
    FeetechRig: [
        (0, -0.3, 0.2, 0.3, 0, 0.5),
        (0, 0.3, -0.5, 0.3, 0, 0.5),
        (0.5, 0.8, -0.8, 0, 0, 0.3),
        (0, -1.0, -1.5, 0, 1, 0.2),
    ],
    DynamixelRig: [(0, -0.3, 0.2, 0.3, 0, 0.5), (0, 0, -0.5, 0.3, 0, 0.5), (0.5, -1, -0.8, 0, 0, 0.3)],
}
"""Poses with the tool above the table, in radians."""
POSES = [(rig, pose) for rig, poses in RAISED.items() for pose in poses]
RIGS = list(RAISED)


class Stop:
    """A stop of the arm: its reports and when it was done, and what the arm touched until it lay still."""

    reports: tuple[MotorReport, ...]
    began_s: float
    limp_s: float
    touches: list[Touch]


async def stopped(rig: Rig, safe_state: SafeState = SafeState.LOWERED, settle_s: float = 1.0) -> Stop:
    stop = Stop()
    stop.began_s = trio.current_time()
    async with trio.open_nursery() as nursery:

        async def pass_time() -> None:
            while True:
                rig.bus.pass_time()
                await trio.sleep(0.005)

        nursery.start_soon(pass_time)
        stop.reports = await rig.wire.make_safe(safe_state)
        stop.limp_s = trio.current_time() - stop.began_s
        await trio.sleep(settle_s)
        nursery.cancel_scope.cancel()
    stop.touches = rig.bus.plant.take_touches()
    return stop


def kinds(rig: Rig) -> list[str]:
    return [rig.protocol.classify(packet) for packet in rig.requests()]


# -- the arm comes down


@pytest.mark.parametrize(("make", "pose"), POSES)
def test_saf_026_a_raised_arm_is_laid_down_slowly_and_then_limp(make: MakeRig, pose: tuple[float, ...]) -> None:
    async def main() -> None:
        stop = await stopped(await raised(make, pose, lower_s=2.9))
        assert all_safe(stop.reports)
        assert stop.limp_s <= LIMP_S
        assert stop.touches, "the arm comes to lie on the table"
        assert max(touch.speed_m_s for touch in stop.touches) <= LIMIT_M_S, stop.touches

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_an_arm_that_is_not_lowered_falls(make: MakeRig) -> None:
    async def main() -> None:
        stop = await stopped(await raised(make, RAISED[make][0]), SafeState.LIMP)
        assert max(touch.speed_m_s for touch in stop.touches) > 1.5 * LIMIT_M_S

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_saf_022_the_arm_holds_before_the_first_wait_and_gets_no_setpoint_after(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        stop = await stopped(rig)
        at_once = b"".join(data for at_s, data in rig.port.written if at_s == stop.began_s)
        first = next(iter(rig.protocol.Decoder().feed(at_once)))
        assert rig.protocol.safe_state(first, rig.driver.ids) == "hold"
        assert set(kinds(rig)) <= {"safe", "lowering", "read", "config", "other"}
        assert "lowering" in kinds(rig)
        assert rig.torque() == [0] * 6

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_the_arm_goes_to_its_rest_pose_and_is_let_go_there(make: MakeRig) -> None:
    async def main() -> None:
        axes = make().driver.joints
        turned = (0.4, *RAISED[make][0][1:4], -0.3, 0.5)
        rest = {
            axis.key: axis.value(round(2048 + rad * 4096 / math.tau))
            for axis, rad in zip(axes, turned, strict=True)
        }
        rig = await raised(make, RAISED[make][0], rest=rest, lower_s=6.0)
        stop = await stopped(rig)
        assert all_safe(stop.reports)
        assert rig.wire.lowered is LoweringEnd.DOWN
        assert rig.wire.ended_in is None
        after = rig.bus.plant.position_rad
        assert after[0] == pytest.approx(0.4, abs=0.15)
        assert after[4] == pytest.approx(-0.3, abs=0.15)

    virtual(main)


# -- it is cut short: limp at once


@pytest.mark.parametrize("make", RIGS)
@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.7])
def test_saf_026_a_servo_that_falls_mute_makes_the_arm_limp_within_50_ms(make: MakeRig, after_s: float) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        limp_s: list[float] = []

        async def stop() -> None:
            await rig.wire.make_safe(SafeState.LOWERED)

        async with trio.open_nursery() as nursery:
            nursery.start_soon(stop)
            await trio.sleep(after_s)
            rig.bus.set_fault(Fault.OFF, VICTIM)
            muted_s = trio.current_time()
            await trio.sleep(0.2)
            for at_s, data in rig.port.written:
                for packet in rig.protocol.Decoder().feed(data):
                    if rig.protocol.safe_state(packet, rig.driver.ids) == "limp":
                        limp_s.append(at_s - muted_s)
        assert limp_s[0] <= 0.055, "one period of the lowering and one answer that does not come"

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_saf_026_a_stop_that_is_cut_off_can_be_made_limp_at_once(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        with trio.move_on_after(0.5):
            await rig.wire.make_safe(SafeState.LOWERED)
        assert sum(rig.torque()) > 0
        began_s = trio.current_time()
        assert all_safe(await rig.wire.make_safe(SafeState.LIMP))
        assert trio.current_time() - began_s < 0.05

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_a_lowering_that_was_cut_off_goes_on(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        with trio.move_on_after(0.3):
            await rig.wire.make_safe(SafeState.LOWERED)
        stop = await stopped(rig)
        assert all_safe(stop.reports)
        assert max(touch.speed_m_s for touch in stop.touches) <= LIMIT_M_S

    virtual(main)


def test_saf_026_a_joint_that_meets_something_on_the_way_to_rest_is_let_go() -> None:
    async def main() -> None:
        rest = dict.fromkeys(JOINTS, 0.0) | {"gripper": 20.0, "shoulder_lift": -60.0}
        rig = await raised(FeetechRig, RAISED[FeetechRig][0], rest=rest, lower_s=6.0)
        joint = JOINTS.index("shoulder_lift")
        rig.bus.plant.set_stuck(joint, True)
        await rig.wire.make_safe(SafeState.LOWERED)
        assert rig.wire.lowered is LoweringEnd.BLOCKED
        assert rig.wire.ended_in is SafeState.LIMP
        assert rig.torque() == [0] * 6

    virtual(main)


def test_saf_026_the_torque_goes_when_the_time_is_over() -> None:
    async def main() -> None:
        rig = await raised(FeetechRig, RAISED[FeetechRig][0], lower_s=0.5)
        stop = await stopped(rig)
        assert rig.wire.lowered is LoweringEnd.TIME
        assert rig.wire.ended_in is SafeState.LIMP
        assert 0.5 <= stop.limp_s < 0.6

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_saf_026_a_lowering_that_begins_anew_has_no_more_time(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0], lower_s=0.8)
        with trio.move_on_after(0.5):
            await rig.wire.make_safe(SafeState.LOWERED)
        stop = await stopped(rig)
        assert rig.wire.lowered is LoweringEnd.TIME
        assert stop.limp_s < 0.4

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_an_unplugged_adapter_does_not_end_the_stop_with_an_exception(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        rig.port.unplugged = True
        assert not any(report.safe for report in await rig.wire.make_safe(SafeState.LOWERED))

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_an_arm_that_is_not_armed_is_made_limp_at_once(make: MakeRig) -> None:
    async def main() -> None:
        rig = make(on_exit="lower")
        await rig.wire.open()
        began_s = trio.current_time()
        assert all_safe(await rig.wire.make_safe(SafeState.LOWERED))
        assert trio.current_time() - began_s < 0.05
        assert "lowering" not in kinds(rig)

    virtual(main)


# -- the torque limits come back


@pytest.mark.parametrize("make", RIGS)
def test_a_lowered_arm_has_its_full_torque_again(make: MakeRig) -> None:
    async def main() -> None:
        rig = await raised(make, RAISED[make][0])
        register = rig.protocol.TORQUE_LIMIT
        full = rig.all_of(register)
        await rig.wire.make_safe(SafeState.LOWERED)
        assert rig.all_of(register) == full

    virtual(main)


@pytest.mark.parametrize("make", RIGS)
def test_arming_lifts_the_limits_of_a_lowering_whose_process_died(make: MakeRig) -> None:
    async def main() -> None:
        rig = make()
        register = rig.protocol.TORQUE_LIMIT
        full = rig.all_of(register)
        rig.servo().put(register, 30)
        await rig.wire.open()
        await rig.wire.arm(Permission())
        assert rig.all_of(register) == full

    virtual(main)


def test_a_stop_leaves_the_limits_of_another_program_alone() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(rig.protocol.TORQUE_LIMIT, 30)
        await rig.wire.open()
        await rig.wire.make_safe(SafeState.LIMP)
        assert rig.servo().get(rig.protocol.TORQUE_LIMIT) == 30

    virtual(main)


def test_a_servo_that_keeps_a_low_limit_is_not_armed() -> None:
    async def main() -> None:
        rig = FeetechRig()
        rig.servo().put(rig.protocol.TORQUE_LIMIT, 30)
        await rig.wire.open()
        size = rig.protocol.GOAL_VELOCITY.size + rig.protocol.TORQUE_LIMIT.size
        start = bytes((rig.protocol.GOAL_VELOCITY.address, size))
        rig.filter(lambda packet: not packet.params.startswith(start))
        with pytest.raises(WireDown, match="keeps the torque limit 30"):
            await rig.wire.arm(Permission())

    virtual(main)


# -- the plans


def arm() -> Chain:
    table = TABLES.table("so101")
    return Chain(table, [joint["key"] for joint in table["joints"]])


def test_the_model_of_the_arm_is_the_twins() -> None:
    pose = (0.3, -0.4, 0.7, -0.2, 0.5, 0.4)
    plant = Plant.from_table(TABLES.table("so101"))
    plant.data.qpos[plant._qpos] = pose
    mujoco.mj_forward(plant.model, plant.data)
    points = arm().points(pose)
    # The shapes end beside the joint of the next link, by half the width of a servo.
    for point, body in ((points[1], "lower_arm"), (points[2], "wrist"), (points[3], "hand")):
        assert point == pytest.approx(plant.data.body(body).xpos.tolist(), abs=0.02)


def test_a_point_may_be_faster_the_higher_it_is() -> None:
    speeds = [allowed_m_s(height) for height in (-0.1, 0.0, 0.1, 0.5)]
    assert speeds == sorted(speeds)
    assert speeds[0] == speeds[1] == lowering.SLOW_M_S <= LIMIT_M_S
    assert speeds[3] == lowering.FASTEST_M_S


def test_torque_falls_while_the_arm_stands_and_rises_while_it_is_too_fast() -> None:
    torque = FallingTorque({1: 0.2, 2: -0.1, 3: 0.0}, seconds=1.0)
    first = dict(torque.shares)
    assert first[1] > 0.2 and first[2] > 0.1 and first[3] > 0
    assert all(share < first[motor] for motor, share in torque.step(0.0, 0.1).items())
    slow = dict(torque.shares)
    assert all(share > slow[motor] for motor, share in torque.step(1.5, 0.1).items())
    for _ in range(200):
        assert all(0 <= share <= 1 for share in torque.step(3.0, 0.1).values())
    for _ in range(30):
        torque.step(0.0, 0.1)
    assert torque.done


def test_a_rest_path_is_as_fast_as_allowed_and_no_faster() -> None:
    chain, start, rest = arm(), (0.4, 0.3, -0.5, 0.3, 0.0, 0.5), (0.0, -1.0, 1.0, 0.5, 0.0, 0.1)
    path = RestPath(chain, start, rest)
    assert path.pose_after(0.0) == pytest.approx(start)
    assert path.pose_after(path.seconds) == path.pose_after(path.seconds + 1) == pytest.approx(rest)
    paces = []
    for number in range(200):
        at_s = path.seconds * number / 200
        here, ahead = path.pose_after(at_s), path.pose_after(at_s + 0.001)
        paces.append(pace(chain, here, [(b - a) / 0.001 for a, b in zip(here, ahead, strict=True)]))
    assert 0.9 < max(paces) < 1.1


# -- what the user chooses


@pytest.mark.parametrize(
    ("options", "safe_state"),
    [
        ({}, SafeState.LIMP),
        ({"on_exit": "lower"}, SafeState.LOWERED),
        ({"on_exit": "limp"}, SafeState.LIMP),
        ({"on_exit": "hold"}, SafeState.HOLD),
    ],
)
def test_on_exit_decides_about_stops_without_hurry_only(options: dict[str, str], safe_state: SafeState) -> None:
    async def main() -> None:
        fallbacks = FeetechRig(**options).driver.fallbacks
        assert {reason for reason, state in fallbacks.items() if state is safe_state} >= {
            Reason.STOP,
            Reason.CLEANUP,
            Reason.CALLER,
        }
        for reason in (Reason.ESTOP, Reason.WIRE, Reason.ROOT, Reason.LINK, Reason.FAULT):
            assert fallbacks[reason] is SafeState.LIMP

    virtual(main)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"on_exit": "fall"}, "Use one of lower, limp, hold"),
        ({"on_exit": 1}, "Use one of lower, limp, hold"),
        ({"on_exit": "lower", "rest": {"shoulder_pan": 0.0}}, "has no number for shoulder_lift"),
        ({"on_exit": "lower", "rest": {"shoulder_pam": 0.0}}, "is no joint"),
        ({"on_exit": "lower", "rest": 5}, "Give a pose"),
        ({"on_exit": "lower", "rest": "/nowhere/rest.json"}, "Teach it again"),
        ({"on_exit": "lower", "rest": dict.fromkeys(JOINTS, 500.0)}, "Give a pose inside the range"),
        ({"rest": dict.fromkeys(JOINTS, 0.0), "on_exit": "limp"}, 'rest needs on_exit="lower"'),
        ({"on_exit": "lower", "lower_s": 0.1}, "Give seconds, 0.5 to 10"),
        ({"on_exit": "lower", "lower_s": float("nan")}, "Give seconds, 0.5 to 10"),
    ],
)
def test_saf_014_a_wrong_option_is_refused_with_what_is_accepted(options: dict[str, Any], text: str) -> None:
    async def main() -> None:
        with pytest.raises(ValueError, match=text):
            FeetechRig(**options)

    virtual(main)


def test_a_robot_that_is_no_arm_is_not_lowered() -> None:
    async def main() -> None:
        assert FeetechRig("open_duck_mini").driver.fallbacks[Reason.STOP] is SafeState.LIMP
        with pytest.raises(ValueError, match="Use one of limp, hold"):
            FeetechRig("open_duck_mini", on_exit="lower")

    virtual(main)
