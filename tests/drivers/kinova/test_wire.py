"""Test the Kinova wire on the twin's base, in memory and virtual time."""

from __future__ import annotations

import math

import pytest
import trio

from strands_actors.contract.wire import PermitDenied, WireDown
from strands_actors.drivers.common.twin import Fault
from strands_actors.drivers.kinova import protocol as p
from strands_actors.drivers.kinova.protocol import ArmState, Call, ServoingMode, unwrap
from strands_actors.drivers.kinova.twin.base import Base
from tests.drivers.common.memory_port import Permission, virtual

from .rig import Rig

STEP_RAD = 0.02


# -- connecting


def test_connecting_does_not_show_the_password() -> None:
    async def main() -> None:
        rig = Rig({"username": "me", "password": "hunter2"}, username="me", password="hunter2")
        facts = await rig.wire.open()
        assert facts == {"address": "192.0.2.10:10000", "actuators": 7}
        assert rig.calls() == [Call.CREATE_SESSION, Call.GET_ACTUATOR_COUNT, *[Call.REFRESH_FEEDBACK] * 2]
        seen = await rig.wire.read()
        assert seen.position == pytest.approx((0, 0.2618, math.pi, -2.2689, 0, 0.9599, 1.5708), abs=1e-3)

    virtual(main)


@pytest.mark.parametrize(
    ("options", "why"), [({"password": "hunter2"}, "INVALID_PASSWORD"), ({"username": "eve"}, "USER_NOT_FOUND")]
)
def test_a_wrong_login_is_named_without_the_password(options: dict[str, str], why: str) -> None:
    async def main() -> None:
        with pytest.raises(WireDown) as down:
            await Rig(options).wire.open()
        assert why in str(down.value) and "hunter2" not in str(down.value)
        assert "Check username= and password=" in str(down.value)

    virtual(main)


def test_a_base_that_never_answers_is_named() -> None:
    async def main() -> None:
        rig = Rig()
        rig.silent = True
        with pytest.raises(WireDown, match="did not answer"):
            await rig.wire.open()

    virtual(main)


def test_another_arm_is_refused() -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.base._call = lambda session, request: p.encode_number(6)  # type: ignore[method-assign]
        with pytest.raises(WireDown, match="has 6 joints, not 7"):
            await rig.wire.open()

    virtual(main)


# -- arming


def test_saf_011_arming_commands_a_standstill() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        before = (await rig.wire.read()).position
        seen = await rig.wire.arm(Permission())
        assert seen.position == pytest.approx(before, abs=1e-6)
        ((_, frame),) = rig.speeds()
        assert p.decode_speeds(frame.payload) == dict.fromkeys(range(7), 0.0)
        assert rig.velocity < 1e-6

    virtual(main)


@pytest.mark.parametrize(
    ("state", "why"),
    [
        (ArmState.IN_FAULT, r"base in fault \(bank 0x1\). Clear the fault, then reconnect"),
        (ArmState.IDLE, r"the arm is in state IDLE \(2\)"),
        (ArmState.LOW_LEVEL_SERVOING, "the arm is in state LOW_LEVEL_SERVOING"),
    ],
)
def test_saf_014_a_base_that_is_not_ready_is_not_armed(state: ArmState, why: str) -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.base.set_state(state)
        await rig.wire.open()
        with pytest.raises(WireDown, match=why):
            await rig.wire.arm(Permission())
        assert not rig.speeds()

    virtual(main)


def test_the_servoing_mode_is_set_when_it_is_another() -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.base.set_mode(ServoingMode.LOW_LEVEL)
        await rig.armed()
        assert rig.twin.base.mode is ServoingMode.SINGLE_LEVEL
        await rig.go(0, STEP_RAD)
        assert (await rig.period()).sensors["arm_state"] == (7.0,)
        assert rig.velocity > 0.01

    virtual(main)


def test_arming_waits_for_a_state_that_follows_the_mode_with_a_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    left_s: list[float] = []

    def late(base: Base) -> ArmState:
        if base.mode is ServoingMode.SINGLE_LEVEL and not left_s:
            left_s.append(base.now_s())
        is_late = not left_s or base.now_s() < left_s[0] + 0.1
        return ArmState.LOW_LEVEL_SERVOING if is_late else ArmState.SERVOING_READY

    async def main() -> None:
        rig = Rig()
        rig.twin.base.set_mode(ServoingMode.LOW_LEVEL)
        monkeypatch.setattr(Base, "arm_state", property(late))
        await rig.armed()
        assert trio.current_time() > left_s[0] + 0.1

    virtual(main)


def test_saf_014_a_base_that_stays_in_low_level_servoing_is_not_armed(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.base.set_mode(ServoingMode.LOW_LEVEL)
        monkeypatch.setattr(Base, "arm_state", property(lambda base: ArmState.LOW_LEVEL_SERVOING))
        await rig.wire.open()
        with pytest.raises(WireDown, match="the arm is in state LOW_LEVEL_SERVOING"):
            await rig.wire.arm(Permission())
        assert not rig.speeds()

    virtual(main)


def test_an_arm_that_another_client_moves_is_not_armed() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(3, STEP_RAD)
        await trio.sleep(0.05)
        other = Rig()
        other.twin = rig.twin
        await other.wire.open()
        with pytest.raises(WireDown, match="joint_4 turns, and not by a command of this program"):
            await other.wire.arm(Permission())
        assert not other.speeds()

    virtual(main)


@pytest.mark.parametrize("checks", [0, 1])
def test_saf_009_a_stop_during_arming_wins(checks: int) -> None:
    async def main() -> None:
        rig = Rig()
        rig.twin.base.mode = ServoingMode.LOW_LEVEL
        await rig.wire.open()
        with pytest.raises(PermitDenied):
            await rig.wire.arm(Permission(denied_at=checks))
        assert not rig.speeds()
        assert rig.calls().count(Call.SET_SERVOING_MODE) == checks

    virtual(main)


# -- moving


def test_a_target_becomes_the_speed_that_reaches_it_in_one_period() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(1, STEP_RAD)
        ((_, frame),) = rig.speeds()
        speeds = p.decode_speeds(frame.payload)
        assert speeds[1] == pytest.approx(math.degrees(STEP_RAD / 0.025), rel=1e-3)
        assert all(abs(speed) < 0.01 for joint, speed in speeds.items() if joint != 1)

    virtual(main)


@pytest.mark.parametrize("joint", range(7))
def test_a_latched_target_is_reached_and_then_stood_on(joint: int) -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(joint, -STEP_RAD)
        assert rig.target is not None
        start, furthest = rig.target[joint] + STEP_RAD, 0.0
        for _ in range(60):
            seen = await rig.period()
            furthest = max(furthest, start - seen.position[joint])
        assert seen.position[joint] == pytest.approx(rig.target[joint], abs=1e-3)
        assert furthest < 1.1 * STEP_RAD, "the joint does not swing past its target"
        _, last = rig.speeds()[-1]
        assert set(p.decode_speeds(last.payload).values()) == {0.0}

    virtual(main)


def test_a_stream_is_followed_at_its_speed() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        start = (await rig.wire.read()).position
        for step in range(1, 41):
            rig.target = (start[0] + 0.25 * step * rig.driver.config.period_s, *start[1:])
            seen = await rig.period()
            if step > 20:
                assert seen.velocity[0] == pytest.approx(0.25, rel=0.2)
                assert 0 < rig.target[0] - seen.position[0] < 0.03

    virtual(main)


def test_no_speed_is_ever_faster_than_the_gate() -> None:
    """This holds for any target: one that passed the gates may be further away when it leaves."""

    async def main() -> None:
        rig = await Rig().armed()
        for step in (0.5, -0.5, 0.02):
            await rig.go(2, step)
            await rig.period()
        most = max(abs(speed) for _, frame in rig.speeds() for speed in p.decode_speeds(frame.payload).values())
        assert most == pytest.approx(50.0, abs=0.01)

    virtual(main)


@pytest.mark.parametrize(("joint", "step"), [(0, -STEP_RAD), (2, STEP_RAD)])
def test_a_joint_without_end_is_followed_over_its_seam(joint: int, step: float) -> None:
    """The joint goes from 0 degrees to 359, and beyond half a turn, where the sign would change."""

    async def main() -> None:
        rig = await Rig().armed()
        start = (await rig.wire.read()).position[joint]
        for _ in range(40):
            await rig.go(joint, step)
            for _ in range(10):
                seen = await rig.period()
        assert seen.position[joint] == pytest.approx(start + 40 * step, abs=0.08)

    virtual(main)


@pytest.mark.parametrize(
    ("seen", "known", "wanted"), [(0.01, 6.28, 6.2932), (6.28, 0.01, -0.0032), (3.2, 3.1, 3.2), (3.2, 0.0, -3.0832)]
)
def test_angles_are_unwrapped_to_the_nearest(seen: float, known: float, wanted: float) -> None:
    assert unwrap([seen], (known,)) == (pytest.approx(wanted, abs=1e-3),)


def test_saf_002_the_permit_is_checked_last() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        target = (await rig.wire.read()).position
        permission = Permission(rig.ports[0], denied_at=0)
        before = len(rig.ports[0].written)
        with pytest.raises(PermitDenied):
            await rig.wire.write(target, permission)
        assert permission.written_before == [before] and len(rig.ports[0].written) == before

    virtual(main)


# -- the lifetime of speeds


def test_saf_003_a_speed_that_is_not_renewed_is_stopped_after_three_periods() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0, STEP_RAD)
        sent_s = trio.current_time()
        for _ in range(12):
            await rig.period(earned=False)
        first = rig.stops()[0]
        assert 0.075 < first - sent_s < 0.11
        seen = await rig.period(earned=False)
        assert "no speed was sent for" in seen.faults["base"]
        assert rig.velocity < 0.01
        assert len(rig.stops()) == 1, "the stop was answered, so it is sent once"
        with pytest.raises(PermitDenied, match="no speed was sent"):
            await rig.wire.write(rig.target or (), Permission())
        await rig.wire.arm(Permission())
        await rig.go(0, STEP_RAD)

    virtual(main)


def test_saf_003_the_stop_is_repeated_until_it_is_answered() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0, STEP_RAD)
        rig.deaf = {Call.STOP}
        for _ in range(10):
            await rig.period(earned=False)
        assert len(rig.stops()) >= 6
        assert rig.velocity > 0.5, "joint speeds never expire in the base"
        rig.deaf = set()
        for _ in range(10):
            await rig.period(earned=False)
        assert rig.velocity < 0.01
        count = len(rig.stops())
        await rig.period(earned=False)
        assert len(rig.stops()) == count

    virtual(main)


def test_stops_that_are_answered_late_end_all_the_same_and_leave_nothing() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0, STEP_RAD)
        rig.delay_s = lambda call: 0.06
        for _ in range(20):
            await rig.period(earned=False)
        count = len(rig.stops())
        assert 1 < count < 8
        session = rig.wire.session
        assert not session.turning and session.stops == []
        assert rig.awaited() == set(session.requested_ns)
        rig.delay_s = lambda call: 0.001
        await trio.sleep(0.1)
        await rig.wire.arm(Permission())
        await rig.go(0, STEP_RAD)
        await rig.period(earned=False)
        assert session.turning, "the answer to an old stop does not end a new speed"

    virtual(main)


def test_saf_012_a_base_that_does_not_answer_is_stopped_and_not_commanded() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0, STEP_RAD)
        rig.silent = True
        silent_s = trio.current_time()
        with pytest.raises((PermitDenied, WireDown)):
            while True:
                await rig.period()
        await rig.wire.read()
        assert 0.07 < rig.stops()[0] - silent_s < 0.12
        assert not [at_s for at_s, _ in rig.speeds() if at_s > rig.stops()[0]]
        with pytest.raises(WireDown, match="did not answer for"):
            for _ in range(40):
                await rig.period(earned=False)
        assert rig.velocity < 0.01, "the base received the stop"

    virtual(main)


def test_saf_012_frozen_feedback_does_not_count_as_alive_and_corrects_nothing() -> None:
    """The base answers and its arm moves, but the feedback stands still. Without a limit the target would be sent
    for ever."""

    async def main() -> None:
        rig = await Rig().armed()
        start = rig.twin.base.plant.position_rad[0]
        rig.twin.set_fault(Fault.STUCK)
        await rig.go(0, STEP_RAD)
        stuck_s = trio.current_time()
        with pytest.raises(PermitDenied, match="no new feedback for"):
            for _ in range(40):
                await rig.period()
        seen = await rig.wire.read()
        assert "no new feedback arrived for" in seen.faults["base"]
        assert trio.current_time() - seen.t_ns / 1e9 > 0.075, "the reading shows its true age"
        assert 0.07 < rig.stops()[0] - stuck_s < 0.12
        assert not [at_s for at_s, _ in rig.speeds() if at_s > rig.stops()[0]]
        with pytest.raises(WireDown, match="the base of kinova_gen3 has repeated the same measurement for 5"):
            for _ in range(40):
                await rig.period(earned=False)
        assert trio.current_time() - stuck_s < 0.7
        assert rig.velocity < 0.01
        most_rad_s = math.radians(50.0)
        assert rig.twin.base.plant.position_rad[0] - start < 0.12 * most_rad_s + 0.07 + STEP_RAD

    virtual(main)


def test_saf_012_a_base_whose_feedback_stands_still_does_not_connect_nor_arm() -> None:
    async def main() -> None:
        rig = Rig()
        await rig.wire.open()
        rig.twin.set_fault(Fault.STUCK)
        with pytest.raises(WireDown, match="no new feedback of 7 joints"):
            await rig.wire.arm(Permission())
        assert not rig.speeds()
        with pytest.raises(WireDown, match="no new feedback of 7 joints"):
            await rig.wire.open()
        rig.twin.set_fault(Fault.OK)
        await rig.armed()

    virtual(main)


def test_two_readings_of_one_cycle_are_no_silence() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        for _ in range(5):
            first = await rig.wire.read()
            rig.delay_s = lambda call: 0.0
            assert (await rig.wire.read()).t_ns >= first.t_ns
            rig.delay_s = lambda call: 0.001
            assert (await rig.period()).t_ns > first.t_ns

    virtual(main)


def test_an_arm_that_stands_needs_no_stop() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        for _ in range(20):
            await rig.period(earned=False)
        assert rig.stops() == []

    virtual(main)


def test_speeds_that_the_base_refuses_are_reported_and_not_repeated() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        await rig.go(0, STEP_RAD)
        rig.twin.base.set_state(ArmState.IN_FAULT)
        with pytest.raises(PermitDenied, match="refuses SEND_JOINT_SPEEDS: ROBOT_IN_FAULT"):
            for _ in range(5):
                seen = await rig.period()
        assert seen.sensors["arm_state"] == (4.0,)
        assert rig.stops(), "joints may turn by an earlier speed, so a stop is sent"
        refused_s = trio.current_time()
        await rig.wire.read()
        assert not [at_s for at_s, _ in rig.speeds() if at_s >= refused_s]

    virtual(main)


# -- faults of the base


def test_late_answers_are_matched_to_their_requests() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.delay_s = lambda call: 0.04
        for _ in range(10):
            seen = await rig.period()
        age_s = trio.current_time() - seen.t_ns / 1e9
        assert 0.04 <= age_s < 0.075

    virtual(main)


def test_every_third_answer_is_missing_and_all_goes_on() -> None:
    async def main() -> None:
        rig = await Rig().armed()
        rig.twin.set_fault(Fault.INTERMITTENT)
        await rig.go(0, STEP_RAD)
        for _ in range(100):
            seen = await rig.period()
        assert rig.target is not None
        assert seen.position[0] == pytest.approx(rig.target[0], abs=2e-3)
        rig.target = None

    virtual(main)


def test_damaged_answers_give_no_position_and_the_stop_is_sent() -> None:
    """A frame has no checksum. Damage to its last byte reads as a different fault bank."""

    async def main() -> None:
        rig = await Rig().armed()
        before = await rig.wire.read()
        rig.twin.set_fault(Fault.GARBAGE)
        for _ in range(50):
            seen = await rig.period()
            assert seen.position == pytest.approx(before.position, abs=1e-5)
        reports = await rig.stop()
        assert rig.stops() and all(report.written for report in reports)

    virtual(main)
