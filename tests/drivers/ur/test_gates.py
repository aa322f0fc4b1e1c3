"""Test which commands are refused, with their codes, and which are accepted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.ur.arms import JOINTS, TABLES, arm_of
from strands_actors.drivers.ur.driver import UR
from strands_actors.drivers.ur.gates import LOOKAHEAD_S, WATCHDOG_HZ
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
AT = (0.0, -1.5, 1.5, -1.5, -1.5, 0.0)
READY: dict[str, tuple[float, ...]] = {
    "robot_mode": (7,),
    "safety_mode": (1,),
    "runtime_state": (2,),
    "speed_scaling": (1.0,),
    "control": (1.0,),
}


def driver(robot: str = "ur5e") -> UR:
    return UR(robot, "192.0.2.10", {})


def state(period_s: float = 0.008, age_s: float = 0.005, **sensors: float) -> GateState:
    stamp = NOW_NS - round(age_s * 1e9)
    seen = {**READY, **{name: (value,) for name, value in sensors.items()}}
    observation = Observation(stamp, AT, (stamp,) * 6, sensors=seen)
    return GateState(NOW_NS, observation, AT, NOW_NS, period_s > 0, period_s)


def judge(action: Mapping[str, Any], at: GateState, robot: str = "ur5e") -> Candidate | Refused:
    """Judge an action as the gate does: conditions, parse, gates."""
    ur = driver(robot)
    for condition in ur.conditions:
        refusal = condition.check(at.observation, at.now_ns)
        if refusal is not None:
            return refusal
    candidate = ur.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    for gate in ur.gates:
        refusal = gate(candidate, at)
        if refusal is not None:
            return refusal
    return candidate


def refused(action: Mapping[str, Any], at: GateState, robot: str = "ur5e") -> Refused:
    answer = judge(action, at, robot)
    assert isinstance(answer, Refused), answer
    return answer


def test_a_small_step_passes_and_the_rest_stays() -> None:
    answer = judge({"elbow_joint": 1.52, "wrist_1_joint.pos": -1.49}, state())
    assert isinstance(answer, Candidate)
    assert answer.values == (0.0, -1.5, 1.52, -1.49, -1.5, 0.0)
    assert answer.named == (2, 3)


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({"elbow": 0.0}, "unknown_joint"),
        ({"elbow_joint": math.nan}, "not_finite"),
        ({"elbow_joint": 3.2}, "past_travel"),
        ({"shoulder_pan_joint": -6.3}, "past_travel"),
        ({"elbow_joint": 1.53}, "too_fast"),
    ],
)
def test_bad_actions(action: Mapping[Any, Any], code: str) -> None:
    assert refused(action, state()).code == code


@pytest.mark.parametrize(
    ("sensors", "code", "text"),
    [
        (
            {"robot_mode": 3},
            "robot_mode",
            "robot is POWER_OFF (3). Power on the arm and release its brakes on the pendant",
        ),
        ({"robot_mode": 5}, "robot_mode", "IDLE (5)"),
        ({"safety_mode": 3}, "safety_mode", "PROTECTIVE_STOP (3). Look at the arm, then unlock"),
        ({"safety_mode": 7}, "safety_mode", "ROBOT_EMERGENCY_STOP"),
        ({"runtime_state": 1}, "program", "control script is not running"),
        ({"control": 0}, "program", "Call resume()"),
        *(({"runtime_state": number}, "paused", "paused on the pendant. Call resume()") for number in (3, 4, 5)),
        ({"speed_scaling": 0}, "paused", "speed slider"),
    ],
)
def test_modes_are_refused_by_name(sensors: Mapping[str, float], code: str, text: str) -> None:
    refusal = refused({"elbow_joint": 1.5}, state(**sensors))
    assert refusal.code == code
    assert text in refusal.text


def test_reduced_mode_moves() -> None:
    assert isinstance(judge({"elbow_joint": 1.5}, state(safety_mode=2)), Candidate)


def test_a_clock_that_stands_still() -> None:
    assert refused({"elbow_joint": 1.5}, state(age_s=0.5)).code == "stale"


def test_the_limit_of_a_step_is_the_joints_speed() -> None:
    """180 deg/s at 125 Hz are 0.02513 rad."""
    refusal = refused({"elbow_joint": 1.71}, state())
    assert "elbow_joint steps 0.2100 rad in 8 ms. Step at most 0.0251 rad" in refusal.text
    assert refused({"elbow_joint": 1.71}, state(period_s=0.0)).limit == "0.0251", (
        "a single command has the same limit"
    )
    assert isinstance(judge({"elbow_joint": 1.71}, state(period_s=0.08)), Candidate)
    assert refused({"elbow_joint": 2.5}, state(period_s=1.0)).limit == "0.3141", (
        "the limit grows no further with a slow stream"
    )


def test_a_script_that_declares_its_period_may_step_as_far_as_the_joint_turns_in_it() -> None:
    """A loop of ``send_action`` sends 30 single commands a second."""
    at = state(period_s=0.0)
    slow = UR("ur5e", "192.0.2.10", {"control_frequency": 30.0})
    candidate = slow.parse({"elbow_joint": 1.6}, at)
    assert isinstance(candidate, Candidate)
    assert [gate(candidate, at) for gate in slow.gates] == [None] * len(slow.gates)
    assert slow.commanded({"elbow_joint": 1.6}, candidate.values)["control_period"] == 1 / 30
    assert refused({"elbow_joint": 1.6}, at).code == "too_fast"
    far = slow.parse({"elbow_joint": 1.61}, at)
    assert isinstance(far, Candidate)
    codes = [refusal.code for gate in slow.gates if (refusal := gate(far, at))]
    assert codes == ["too_fast"]


def ahead(rad: float, at: GateState, joint: int = 0) -> GateState:
    """Return a state in which the last target is so far ahead of the joint's position."""
    target = (*AT[:joint], AT[joint] + rad, *AT[joint + 1 :])
    return msgspec.structs.replace(at, target=target)


def test_saf_014_small_steps_that_come_quicker_than_a_joint_turns_are_refused() -> None:
    """Each step alone is allowed: 0.025 rad every 4 ms are 6.3 rad/s."""
    target = 0.0
    while isinstance(answer := judge({JOINTS[0]: target + 0.025}, ahead(target, state())), Candidate):
        target = answer.values[0]
    assert (answer.code, answer.limit) == ("runs_ahead", "0.9581"), "0.3 s, plus 5 ms for the age of the sample"
    assert 0.92 < target < 0.9582


@given(st.sampled_from(list(TABLES.robots)), st.integers(0, 5), st.floats(0.0, 0.29))
def test_a_stream_at_top_speed_may_be_late_by_a_look_ahead_a_step_and_a_silence(
    robot: str, joint: int, late_s: float
) -> None:
    """The age of the newest sample does not count. A busy machine must not cause a refusal."""
    axis = arm_of(robot).axes[joint]
    step = axis.speed / 125
    lag_s = 0.999 * (2 * LOOKAHEAD_S + 1 / WATCHDOG_HZ) - 1 / 125
    at = ahead(-math.copysign(axis.speed * (lag_s + late_s), AT[joint]), state(age_s=late_s), joint)
    to = at.target[joint] - math.copysign(step, AT[joint])
    assert isinstance(judge({JOINTS[joint]: to}, at, robot), Candidate)


def test_saf_014_a_joint_that_is_not_named_is_looked_at_too() -> None:
    """A fault holds this joint back. The controller gets its target together with the others."""
    refusal = refused({"elbow_joint": 1.5}, ahead(1.0, state(), 3))
    assert refusal.code == "runs_ahead"
    assert "the target of wrist_1_joint is 1 rad from its position" in refusal.text


@given(st.sampled_from(list(TABLES.robots)), st.integers(0, 5), st.floats(-7, 7))
def test_a_value_that_a_refusal_allows_is_accepted(robot: str, joint: int, wanted: float) -> None:
    at = state()
    answer = judge({JOINTS[joint]: wanted}, at, robot)
    if isinstance(answer, Refused):
        assert answer.code in ("past_travel", "too_fast")
        if answer.code == "too_fast":
            step = math.copysign(float(answer.limit), wanted - AT[joint])
            assert isinstance(judge({JOINTS[joint]: AT[joint] + step}, at, robot), Candidate)
        else:
            end = float(answer.limit.rpartition("..")[2])
            assert end <= arm_of(robot).axes[joint].high < end + 1e-3


def test_the_declarations_of_the_driver() -> None:
    ur = driver()
    assert ur.fallbacks[Reason.EXPIRED] == "hold"
    assert ur.fallbacks[Reason.STOP] == ur.fallbacks[Reason.WIRE] == "stop"
    assert ur.energised("hold")
    assert not ur.energised("stop")
    assert "10 Hz" in ur.firmware_watchdog
    assert ur.commanded({"elbow_joint.pos": 1.5}, AT) == {
        "robot": "ur5e",
        "joints": ["elbow_joint"],
        "targets": {"elbow_joint": 1.5},
        "control_period": 0.008,
    }


def test_addresses_and_options() -> None:
    assert driver().config.host == "192.0.2.10"
    assert UR("ur5e", "192.0.2.10:30004", {}).config.host == "192.0.2.10"
    with pytest.raises(ValueError, match="fixed"):
        _ = UR("ur5e", "192.0.2.10:502", {}).config.host
    with pytest.raises(TypeError, match="speed"):
        UR.resolve("ur5e", {"speed": 1})
