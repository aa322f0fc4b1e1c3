"""Test which commands are refused with which messages. A value that a message allows is accepted."""

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
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.xarm.driver import XArm
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
MS = 1_000_000
STEP = 0.0314


def driver(**options: Any) -> XArm:
    return XArm("xarm7", "192.0.2.1", options)


def seen(**sensors: float) -> Observation:
    kind = driver().arm.usual
    low, high = zip(*kind.range_rad, strict=True)
    values: dict[str, tuple[float, ...]] = {"range_low_rad": low, "range_high_rad": high}
    said = {"state": 2.0, "mode": 1.0, "error": 0.0, "speed_limit_rad_s": 3.14159, **sensors}
    return Observation(
        NOW_NS,
        (0.0,) * 7,
        (NOW_NS - 5 * MS,) * 7,
        sensors=values | {name: (value,) for name, value in said.items()},
    )


def state(observation: Observation | None = None, target: float = 0.0, stream_s: float = 0.0) -> GateState:
    return GateState(NOW_NS, observation or seen(), (target,) * 7, NOW_NS - 10 * MS, bool(stream_s), stream_s)


def judge(action: Mapping[str, Any], at: GateState | None = None, by: XArm | None = None) -> Candidate | Refused:
    """Judge an action as the gate does: conditions, parse, gates."""
    at, by = at or state(), by or driver()
    for condition in by.conditions:
        if refusal := condition.check(at.observation, at.now_ns):
            return refusal
    candidate = by.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in by.gates:
            if refusal := gate(candidate, at):
                return refusal
    return candidate


def refused(action: Mapping[str, Any], at: GateState | None = None, by: XArm | None = None) -> Refused:
    answer = judge(action, at, by)
    assert isinstance(answer, Refused), answer
    return answer


def test_a_valid_command_is_accepted_and_other_joints_keep_their_targets() -> None:
    candidate = judge({"joint2": 0.03, "joint7.pos": -0.03})
    assert isinstance(candidate, Candidate)
    assert candidate.values == (0.0, 0.03, 0.0, 0.0, 0.0, 0.0, -0.03)


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"joint8": 0.0}, "unknown_joint"),
        ({"gripper": 0.0}, "unknown_joint"),
        ({"joint1": 0.0, "joint1.pos": 0.0}, "both_spellings"),
        ({"joint1": math.nan}, "not_finite"),
        ({"joint1": True}, "not_finite"),
        ({"joint1": "0.1"}, "not_finite"),
    ],
)
def test_saf_014_an_invalid_action_is_refused(action: Mapping[str, Any], code: str) -> None:
    assert refused(action).code == code


# -- the controller


@pytest.mark.parametrize(
    ("sensors", "says"),
    [
        ({"error": 31.0, "state": 4.0}, "the controller reports error 31 (collision). Clear the error at the arm"),
        ({"state": 4.0}, "arm is stopped (state 4)"),
        ({"state": 3.0}, "arm is paused (state 3)"),
        ({"state": 5.0}, "arm is not ready (state 5)"),
        ({"mode": 0.0}, "the arm is in mode 0, not in servo mode (1)"),
    ],
)
def test_a_controller_that_does_not_follow_is_named(sensors: Mapping[str, float], says: str) -> None:
    assert says in refused({"joint1": 0.0}, state(seen(**sensors))).text


def test_a_controller_without_a_report_is_refused_commands() -> None:
    bare = Observation(NOW_NS, (0.0,) * 7, (NOW_NS,) * 7)
    assert refused({"joint1": 0.0}, state(bare)).code == "error"
    for condition in driver().conditions:
        assert condition.check(bare, NOW_NS) is not None
        assert condition.always and condition.reason is Reason.FAULT


def test_saf_012_an_old_report_does_not_count() -> None:
    old = msgspec.structs.replace(seen(), stamp_ns=(NOW_NS - 101 * MS,) * 7)
    refusal = refused({"joint1": 0.0}, state(old))
    assert (refusal.code, refusal.limit) == ("stale", "100 ms")


# -- range


@pytest.mark.parametrize(("joint", "low", "high"), [("joint2", -2.0594, 2.0943), ("joint4", -0.1919, 3.9269)])
def test_a_joint_stays_within_its_range(joint: str, low: float, high: float) -> None:
    for end, step in ((low, -1), (high, 1)):
        near = msgspec.structs.replace(seen(), position=(end,) * 7)
        assert isinstance(judge({joint: end}, state(near, end)), Candidate)
        refusal = refused({joint: end + step * 0.01}, state(near, end))
        assert (refusal.code, refusal.limit) == ("past_travel", f"{low:.4f}..{high:.4f}")


def test_the_range_is_the_one_of_the_arms_own_type() -> None:
    """The ranges of joint 4 hardly overlap between the types."""
    arm = driver().arm
    for kind in arm.types:
        low, high = zip(*kind.range_rad, strict=True)
        at = state(seen())
        own = msgspec.structs.replace(
            at.observation, sensors={**at.observation.sensors, "range_low_rad": low, "range_high_rad": high}
        )
        own = msgspec.structs.replace(own, position=(low[3],) * 7)
        assert isinstance(judge({"joint4": low[3] + 0.001}, state(own, low[3])), Candidate)
        assert refused({"joint4": low[3] - 0.01}, state(own, low[3])).code == "past_travel"
    unknown = msgspec.structs.replace(seen(), sensors={**seen().sensors, "range_low_rad": (), "range_high_rad": ()})
    assert isinstance(judge({"joint4": 0.02}, state(unknown)), Candidate)
    unknown = msgspec.structs.replace(unknown, position=(0.2,) * 7)
    assert refused({"joint4": 0.21}, state(unknown, 0.2)).code == "past_travel"


# -- speed


@pytest.mark.parametrize(
    ("told", "allowed"),
    [(3.14159, 0.0314), (1.0, 0.01), (4.0, 0.0314), (math.nan, 0.0314), (0.0, 0.0314), (-1.0, 0.0314)],
)
def test_a_step_is_what_a_joint_turns_in_a_period_by_the_controllers_limit(told: float, allowed: float) -> None:
    """Without a reported limit the table's applies, so the gate always checks."""
    at = state(seen(speed_limit_rad_s=told))
    assert isinstance(judge({"joint3": allowed}, at), Candidate)
    refusal = refused({"joint3": -allowed - 0.0002}, at)
    assert refusal.code == "too_fast"
    assert refusal.limit == f"{allowed:.5g}"


@given(st.floats(10, 250), st.floats(0.001, 1.0))
def test_the_step_follows_the_control_frequency_not_the_stream(hz: float, stream_s: float) -> None:
    by = driver(control_frequency=hz)
    assert by.timing.control_hz == hz
    assert by.timing.tick_s <= 1 / hz
    allowed = min(3.14 / hz, 0.314)
    assert isinstance(judge({"joint1": allowed * 0.999}, state(stream_s=stream_s), by), Candidate)
    assert refused({"joint1": 3.14 / hz * 1.01}, state(stream_s=stream_s), by).code == "too_fast"


def test_small_steps_in_quick_succession_do_not_run_away_from_the_arm() -> None:
    target = 0.0
    while isinstance(answer := judge({"joint1": target + STEP}, state(target=target)), Candidate):
        target = answer.values[0]
    assert answer.code == "runs_ahead"
    assert 0.25 < target < 0.315


def test_saf_014_the_gate_also_checks_joints_that_are_not_named() -> None:
    """A fault holds the joint back, or it was moved since. It would jump to its old target."""
    at = msgspec.structs.replace(state(), target=(0.0, 0.0, 0.32, 0.0, 0.0, 0.0, 0.0))
    refusal = refused({"joint1": 0.01}, at)
    assert (refusal.code, refusal.limit) == ("runs_ahead", "0.314")
    assert "the target of joint3 is 0.32 rad from its position" in refusal.text
    at = msgspec.structs.replace(state(), target=(0.0, 0.0, 0.31, 0.0, 0.0, 0.0, 0.0))
    assert isinstance(judge({"joint1": 0.01}, at), Candidate)


# -- declarations


def test_it_is_registered_and_declares_its_keywords() -> None:
    assert get_native_driver_class("xarm7") is XArm
    assert set(XArm.OPTIONS) == {"control_frequency", "gripper", "gripper_speed"}
    usual = {"control_frequency": 100.0, "gripper": None, "gripper_speed": 100.0}
    assert XArm.resolve("xarm7", {}) == usual
    resolved = XArm.resolve("xarm7", {"control_frequency": 50, "tool_name": "left"})
    assert resolved == {**usual, "control_frequency": 50.0}
    assert [verb.name for verb in XArm.TOOL_VERBS] == ["sensors", "state", "status", "get_pose", "move_to", "stop"]
    assert XArm.GUARDED == ("move_to",)


@pytest.mark.parametrize("value", [0, 9.9, 251, math.nan, math.inf, "100", None, True])
def test_a_control_frequency_that_cannot_be_is_refused(value: Any) -> None:
    with pytest.raises(ValueError, match="control_frequency"):
        XArm.resolve("xarm7", {"control_frequency": value})


def test_an_unknown_keyword_names_the_nearest() -> None:
    with pytest.raises(TypeError, match="'control_frequenc' -> 'control_frequency'"):
        XArm.resolve("xarm7", {"control_frequenc": 50})


@pytest.mark.parametrize(
    ("port", "address"),
    [("192.0.2.1", ("192.0.2.1", 502)), ("192.0.2.1:1502", ("192.0.2.1", 1502)), ("arm.local", ("arm.local", 502))],
)
def test_the_port_is_an_address(port: str, address: tuple[str, int]) -> None:
    assert XArm("xarm7", port, {}).config.address() == address


def test_the_answer_of_send_action() -> None:
    values = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
    told = driver().commanded({"joint2.pos": 0.2, "joint7": 0.7}, values)
    assert told == {"robot": "xarm7", "joints": {"joint2": 0.2, "joint7": 0.7}}
