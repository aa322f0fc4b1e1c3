"""Test which commands are refused, with their codes, and which are accepted. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Candidate, GateState, OnResume, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.kinova.driver import Kinova
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

NOW_NS = 1000 * NS
AT = (0.0, 0.26, 3.1, -2.2, 0.0, 0.96, 1.57)
STILL = (0.0,) * 7
LIMIT_RAD = 0.8727 / 40
ARM = Kinova("kinova_gen3", "192.0.2.10", {})


def state(
    age_s: float = 0.005,
    *,
    arm_state: float = 7,
    fault_bank: float = 0,
    faults: Mapping[str, str] | None = None,
    velocity: tuple[float, ...] = STILL,
    at: tuple[float, ...] = AT,
    stream: bool = False,
) -> GateState:
    stamp_ns = NOW_NS - round(age_s * NS)
    sensors = {"arm_state": (arm_state,), "fault_bank": (fault_bank,)}
    seen = Observation(stamp_ns, at, (stamp_ns,) * 7, velocity, sensors, dict(faults or {}))
    return GateState(NOW_NS, seen, at, NOW_NS, stream, 0.025 if stream else 0.0)


def judge(action: Mapping[Any, Any], at: GateState | None = None, arm: Kinova = ARM) -> Candidate | Refused:
    """Judge an action as the gate does: conditions, parse, gates."""
    at = at or state()
    for condition in arm.conditions:
        if (no := condition.check(at.observation, at.now_ns)) is not None:
            return no
    candidate = arm.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in arm.gates if (no := gate(candidate, at))), candidate)


def refused(action: Mapping[Any, Any], at: GateState | None = None, arm: Kinova = ARM) -> Refused:
    answer = judge(action, at, arm)
    assert isinstance(answer, Refused), answer
    assert answer.code and answer.reason and answer.remedy
    return answer


def test_a_small_step_is_accepted_and_has_its_speed() -> None:
    answer = judge({"joint_2": 0.27, "joint_7.pos": 1.56})
    assert isinstance(answer, Candidate)
    assert answer.values[:7] == (0.0, 0.27, 3.1, -2.2, 0.0, 0.96, 1.56)
    assert answer.named == (1, 6)
    assert ARM.as_json(answer.values) == dict(zip(ARM.axes, answer.values, strict=False))
    commanded = ARM.commanded({"joint_2": 0.27, "joint_7.pos": 1.56}, answer.values)
    assert commanded["robot"] == "kinova_gen3" and commanded["joints"] == ["joint_2", "joint_7"]
    assert commanded["joint_speeds"] == {"joint_2": pytest.approx(0.4), "joint_7": pytest.approx(-0.4)}


def test_joints_that_are_not_named_keep_their_targets_after_a_command() -> None:
    first = judge({"joint_1": 0.01})
    assert isinstance(first, Candidate)
    at = state()
    again = GateState(NOW_NS, at.observation, first.values, NOW_NS, False)
    second = judge({"joint_3": 3.11}, again)
    assert isinstance(second, Candidate)
    assert second.values[:3] == (0.01, 0.26, 3.11) and len(second.values) == 14


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"joint_8": 0.0}, "unknown_joint"),
        ({"gripper": 0.0}, "unknown_joint"),
        ({3: 0.0}, "unknown_joint"),
        ({"joint_1": 0.0, "joint_1.pos": 0.0}, "both_spellings"),
        ({"joint_1": math.nan}, "not_finite"),
        ({"joint_1": math.inf}, "not_finite"),
        ({"joint_1": "0"}, "not_finite"),
        ({"joint_1": True}, "not_finite"),
        ({"joint_1": 0.03}, "too_fast"),
        ({"joint_1": -1e9}, "too_fast"),
        ({"joint_2": 2.3}, "past_travel"),
        ({"joint_4": -2.6}, "past_travel"),
        ({"joint_6": 2.1}, "past_travel"),
    ],
)
def test_saf_014_a_bad_action_is_refused_by_name(action: dict[Any, Any], code: str) -> None:
    assert refused(action).code == code


@given(st.floats(-0.1, 0.1), st.integers(0, 6), st.booleans())
def test_saf_014_only_commands_that_need_more_than_the_gate_are_refused(
    step: float, joint: int, stream: bool
) -> None:
    answer = judge({f"joint_{joint + 1}": AT[joint] + step}, state(stream=stream))
    assert isinstance(answer, Candidate) == (abs(step) <= LIMIT_RAD + 1e-9)


def test_the_limit_that_a_refusal_names_is_accepted() -> None:
    no = refused({"joint_1": 0.05})
    assert no.reason == "joint_1 needs 2 rad/s to reach the target within 25 ms"
    step = "send a target at most 0.02181 rad from the measured position"
    assert no.remedy == f'{step}, or use move_to({{"joint_1": 0.05}}, seconds=2)'
    assert isinstance(judge({"joint_1": 0.02181}), Candidate)


def test_where_the_joint_is_by_now_counts() -> None:
    moving = state(age_s=0.05, velocity=(0.4, *STILL[1:]))
    assert isinstance(judge({"joint_1": 0.04}, moving), Candidate)
    assert refused({"joint_1": 0.04}, state(age_s=0.05)).code == "too_fast"
    assert refused({"joint_1": -0.01}, moving).code == "too_fast"


def test_a_joint_without_end_has_no_range() -> None:
    far = (12.5, *AT[1:])
    assert isinstance(judge({"joint_1": 12.51}, state(at=far)), Candidate)


def test_a_joint_at_its_end_may_go_back_only() -> None:
    end = (AT[0], 2.24, *AT[2:])
    assert isinstance(judge({"joint_2": 2.23}, state(at=end)), Candidate)
    assert refused({"joint_2": 2.25}, state(at=end)).code == "past_travel"


def test_saf_012_old_readings_are_no_readings() -> None:
    assert isinstance(judge({"joint_1": 0.0}, state(age_s=0.074)), Candidate)
    no = refused({"joint_1": 0.0}, state(age_s=0.08))
    assert (no.code, no.offered, no.limit) == ("stale", "for 80 ms", "75 ms")


def test_a_base_in_fault_is_named_with_its_bank() -> None:
    no = refused({"joint_1": 0.0}, state(arm_state=4, fault_bank=0x20))
    assert no.text == "base in fault (bank 0x20). Clear the fault, then reconnect"
    assert refused({"joint_1": 0.0}, state(arm_state=8)).code == "arm_state"
    assert "PLAYING_SEQUENCE (8)" in refused({"joint_1": 0.0}, state(arm_state=8)).reason


def test_low_level_servoing_is_named_and_ends_with_a_resume() -> None:
    no = refused({"joint_1": 0.0}, state(arm_state=6))
    assert no.code == "arm_state" and no.offered == "LOW_LEVEL_SERVOING (6)"
    assert no.text == "another client has set low-level servoing. Call resume() to set single-level servoing"
    (condition,) = (each for each in ARM.conditions if each.check(state(arm_state=6).observation, NOW_NS))
    assert condition.always and condition.on_resume is OnResume.ARM_ANEW


def test_an_arm_that_its_wire_has_stopped_must_be_armed_again() -> None:
    no = refused({"joint_1": 0.0}, state(faults={"base": "stopped, because no speed was sent for 80 ms"}))
    assert no.reason == "stopped, because no speed was sent for 80 ms"
    assert no.remedy == "call resume()"
    assert isinstance(judge({"joint_1": 0.0}, state(faults={"joint_3": "fault banks 0x1 0x0"})), Candidate)


# -- the driver itself


def test_every_reason_ends_in_a_standing_arm() -> None:
    assert {ARM.fallbacks[reason] for reason in (Reason.EXPIRED, Reason.LEASE, Reason.POLICY)} == {"hold"}
    assert {ARM.fallbacks[reason] for reason in Reason} == {"hold", "stop"}
    assert ARM.energised("hold")
    assert "never expire" in ARM.firmware_watchdog


@pytest.mark.parametrize(("hz", "silent_s"), [(40.0, 0.075), (100, 0.03), (10.0, 0.3)])
def test_the_clocks_follow_the_control_frequency(hz: float, silent_s: float) -> None:
    arm = Kinova("kinova_gen3", "192.0.2.10", Kinova.resolve("kinova_gen3", {"control_frequency": hz}))
    timing = arm.timing
    assert timing.control_hz == hz
    for lapse_s in (timing.stream_ttl_s, timing.state_ttl_s, timing.heartbeat_ttl_s, arm.config.silent_s):
        assert lapse_s == pytest.approx(silent_s)
    assert timing.keepalive_s < 1 / hz
    step = 0.8727 / hz
    assert isinstance(judge({"joint_1": 0.99 * step}, arm=arm), Candidate)
    assert refused({"joint_1": 1.01 * step}, arm=arm).code == "too_fast"


@pytest.mark.parametrize(
    "options",
    [
        {"control_frequency": 5.0},
        {"control_frequency": 1000.0},
        {"control_frequency": math.nan},
        {"control_frequency": "40"},
        {"username": ""},
        {"username": 7},
    ],
)
def test_an_invalid_option_is_named_with_the_valid_ones(options: dict[str, Any]) -> None:
    (name,) = options
    with pytest.raises(ValueError, match=f"kinova_gen3: {name} is .*It is: {Kinova.OPTIONS[name][:20]}"):
        Kinova.resolve("kinova_gen3", options)


def test_an_unknown_option_is_refused_with_the_nearest() -> None:
    with pytest.raises(TypeError, match="'user' -> 'username'"):
        Kinova.resolve("kinova_gen3", {"user": "admin"})


def test_a_password_is_in_no_refusal() -> None:
    assert {"password"} == Kinova.SECRETS
    with pytest.raises(ValueError) as refusal:
        Kinova.resolve("kinova_gen3", {"password": 73571})
    assert "password is not accepted" in str(refusal.value) and "73571" not in str(refusal.value)


@pytest.mark.parametrize(
    ("port", "address"),
    [("192.168.1.10", ("192.168.1.10", 10000)), ("arm.local:10001", ("arm.local", 10001))],
)
def test_the_address(port: str, address: tuple[str, int]) -> None:
    assert Kinova("kinova_gen3", port, {}).config.address() == address


def test_a_port_that_is_no_address_is_refused() -> None:
    with pytest.raises(ValueError, match="Give an address"):
        Kinova("kinova_gen3", "10.0.0.1:x", {}).config.address()
