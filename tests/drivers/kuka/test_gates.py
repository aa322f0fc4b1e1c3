"""Test which commands are refused before they reach the arm: each gate and condition with its code and remedy."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation
from strands_actors.drivers.kuka.driver import Kuka
from strands_actors.drivers.kuka.protocol import ClientMode, ControlMode, Monitoring, Overlay, Quality, State
from strands_actors.drivers.kuka.wire import observation_of
from strands_actors.kernel.messages import Refused

KUKA = Kuka("kuka_iiwa", "", {})
NOW_NS = 10**12
HERE = (0.0, 0.5, 0.0, -1.2, 0.0, 0.9, 0.0)
TOLD = (0.003, *HERE[1:])
"""The commanded hold position, which differs a little from the measured one."""

FINE: dict[str, Any] = {
    "drives": (2,) * 7,
    "position": HERE,
    "commanded": TOLD,
    "state": int(State.COMMANDING_ACTIVE),
    "quality": int(Quality.GOOD),
    "sample_ms": 5,
    "client_mode": int(ClientMode.POSITION),
    "overlay": int(Overlay.JOINT),
}


def seen(age_s: float = 0.0, **said: Any) -> Observation:
    return observation_of(Monitoring(1, **{**FINE, **said}), (), NOW_NS - round(age_s * 1e9))


def answer(
    action: dict[str, Any],
    observation: Observation | None = None,
    target: tuple[float, ...] = HERE,
    period_s: float = 0.0,
    target_ns: int = 0,
) -> Candidate | Refused:
    """Judge an action as the gate does."""
    observation = observation or seen()
    for condition in KUKA.conditions:
        refusal = condition.check(observation, NOW_NS)
        if refusal is not None:
            return refusal
    state = GateState(NOW_NS, observation, target, target_ns, period_s > 0, period_s)
    candidate = KUKA.parse(action, state)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in KUKA.gates if (no := gate(candidate, state)) is not None), candidate)


def refused(*args: Any, **keywords: Any) -> Refused:
    verdict = answer(*args, **keywords)
    assert isinstance(verdict, Refused), verdict
    return verdict


def accepted(*args: Any, **keywords: Any) -> Candidate:
    verdict = answer(*args, **keywords)
    assert isinstance(verdict, Candidate), verdict
    return verdict


# -- conditions


@pytest.mark.parametrize(
    ("said", "code", "text"),
    [
        (
            {"state": State.MONITORING_READY},
            "fri_state",
            "FRI session is MONITORING_READY. Start the motion on the pendant",
        ),
        ({"state": 9}, "fri_state", "FRI session is 9"),
        ({"client_mode": ClientMode.TORQUE}, "client_mode", "FRI client command mode is TORQUE"),
        ({"control_mode": ControlMode.JOINT_IMPEDANCE}, "control_mode", "control mode is JOINT_IMPEDANCE"),
        ({"safety": 2}, "safety", "safety stop, level 2. Clear it on the pendant"),
        ({"drives": (2, 2, 0, 2, 2, 2, 2)}, "drives", "drive of joint3 is OFF"),
        ({"drives": (2, 2, 2, 2, 2, 2, 1)}, "drives", "drive of joint7 is TRANSITIONING"),
        ({"drives": ()}, "drives", "the controller does not report its drives"),
        ({"quality": Quality.FAIR}, "quality", "FRI connection quality is FAIR"),
        ({"overlay": Overlay.NO_OVERLAY}, "overlay", "the controller has ended the FRI overlay"),
    ],
)
def test_saf_014_a_robot_that_may_not_be_commanded_is_not(said: dict[str, Any], code: str, text: str) -> None:
    refusal = refused({"joint1": 0.0}, seen(**said))
    assert refusal.code == code
    assert refusal.text.startswith(text)
    assert refusal.remedy and refusal.limit


def test_saf_014_the_cause_is_named_before_its_effects() -> None:
    """A safety stop ends the session as well, so the safety stop has to be named."""
    stopped = seen(safety=1, drives=(0,) * 7, state=State.MONITORING_READY, client_mode=0, overlay=0, quality=0)
    assert refused({"joint1": 0.0}, stopped).code == "safety"


@pytest.mark.parametrize(("age_s", "fresh"), [(0.19, True), (0.21, False)])
def test_saf_012_an_old_message_does_not_count(age_s: float, fresh: bool) -> None:
    verdict = answer({"joint1": 0.0}, seen(age_s))
    assert isinstance(verdict, Candidate) if fresh else isinstance(verdict, Refused) and verdict.code == "stale"


def test_saf_012_no_message_was_received_yet() -> None:
    nothing = Observation(0, (math.nan,) * 7, (0,) * 7)
    assert refused({"joint1": 0.0}, nothing).code == "stale"


# -- names, range, speed


def test_a_single_command_may_step_as_far_as_one_control_period() -> None:
    most = math.radians(75) / 50
    assert accepted({"joint4": HERE[3] + most}).values[3] == HERE[3] + most
    refusal = refused({"joint4": HERE[3] + most + 1e-6})
    assert (refusal.code, refusal.limit) == ("too_fast", "0.02617")
    assert "joint4 steps 0.026181 rad at once, the limit is 0.02617 at 50 Hz" in refusal.text


def test_the_limit_that_a_refusal_names_is_accepted() -> None:
    limit = float(refused({"joint4": 0.0}).limit)
    accepted({"joint4": HERE[3] + limit})


def test_a_stream_steps_as_far_as_a_joint_turns_in_its_period() -> None:
    for hz in (100, 50, 20):
        most = math.radians(85) / hz
        accepted({"joint1": TOLD[0] + most}, period_s=1 / hz)
        assert refused({"joint1": TOLD[0] + most + 1e-6}, period_s=1 / hz).code == "too_fast"
    assert refused({"joint1": 0.2}, period_s=5.0).code == "too_fast", "a long period does not allow a jump"


def test_control_frequency_sets_what_one_command_may_step() -> None:
    quick = Kuka("kuka_iiwa", "", {"control_frequency": 100.0})
    state = GateState(NOW_NS, seen(), HERE, NOW_NS, False)
    candidate = quick.parse({"joint1": 0.02}, state)
    assert isinstance(candidate, Candidate)
    refusals = [gate(candidate, state) for gate in quick.gates]
    assert [refusal.code for refusal in refusals if refusal is not None] == ["too_fast"]
    assert quick.timing.control_hz == 100.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_no_joint_leaves_its_range(sign: float) -> None:
    for at, joint in enumerate(KUKA.arm.joints):
        end = sign * joint.reach_rad
        at_the_end = (*HERE[:at], end, *HERE[at + 1 :], 0.02)
        accepted({joint.key: end}, target=at_the_end)
        refusal = refused({joint.key: end + sign * 1e-4}, target=at_the_end)
        assert refusal.code == "past_travel" and joint.key in refusal.text


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"joint8": 0.0}, "unknown_joint"),
        ({"joint1": 0.0, "elbow": 0.0}, "unknown_joint"),
        ({"joint1": 0.0, "joint1.pos": 0.0}, "both_spellings"),
        ({"joint1": math.nan}, "not_finite"),
        ({"joint1": math.inf}, "not_finite"),
        ({"joint1": "fast"}, "not_finite"),
        ({"joint1": True}, "not_finite"),
    ],
)
def test_saf_014_names_and_numbers(action: dict[str, Any], code: str) -> None:
    assert refused(action).code == code


def test_saf_019_a_joint_that_is_not_named_keeps_its_commanded_position() -> None:
    """A hold from before the newest reading does not count: the robot's own program may have moved the arm."""
    assert accepted({"joint2": 0.51}).values[:7] == (TOLD[0], 0.51, *TOLD[2:])
    held = (0.2, *HERE[1:])
    assert accepted({"joint2": 0.51}, target=held, target_ns=NOW_NS).values[:7] == (0.2, 0.51, *HERE[2:])
    live = (0.2, *HERE[1:], 0.02)
    assert accepted({"joint2": 0.51}, target=live).values[:7] == (0.2, 0.51, *HERE[2:])


def test_saf_011_a_freshly_armed_arm_starts_at_its_commanded_position() -> None:
    assert KUKA.first_target(seen()) == TOLD


def test_the_time_to_spread_a_target_over_follows_its_position() -> None:
    assert accepted({"joint1": 0.0}).values[7] == 0.02
    assert accepted({"joint1": 0.0}, period_s=0.01).values[7] == 0.01
    assert accepted({"joint1": 0.0}, period_s=1.0).values[7] == 0.1
    assert list(KUKA.as_json(accepted({"joint1": 0.0}).values)) == [f"joint{number}" for number in range(1, 8)]


# -- options


@pytest.mark.parametrize(
    ("options", "named"),
    [
        ({"fri_port": 0}, "fri_port is 0"),
        ({"fri_port": 65536}, "fri_port is 65536"),
        ({"fri_port": "30200"}, "fri_port is '30200'"),
        ({"control_frequency": 10.0}, "control_frequency is 10.0"),
        ({"control_frequency": 500}, "control_frequency is 500"),
        ({"control_frequency": math.nan}, "control_frequency is nan"),
        ({"connect_timeout": 0}, "connect_timeout is 0"),
        ({"connect_timeout": 60.0}, "connect_timeout is 60.0"),
    ],
)
def test_options_are_checked(options: dict[str, Any], named: str) -> None:
    with pytest.raises(ValueError, match=named):
        Kuka.resolve("kuka_iiwa", options)


def test_an_unknown_option_is_refused_with_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"unknown option fri_prot \('fri_prot' -> 'fri_port'\?\)"):
        Kuka.resolve("kuka_iiwa", {"fri_prot": 30201})


def test_the_port_names_the_controller_and_may_name_the_port_of_both_ends() -> None:
    def address(port: str, **options: Any) -> tuple[str, int]:
        return Kuka("kuka_iiwa", port, options).config.address()

    assert address("") == ("", 30200)
    assert address("192.0.2.10") == ("192.0.2.10", 30200)
    assert address("192.0.2.10", fri_port=30201) == ("192.0.2.10", 30201)
    assert address("192.0.2.10:30202") == ("192.0.2.10", 30202)
    with pytest.raises(ValueError, match="port is '192"):
        address("192.0.2.10:x")
