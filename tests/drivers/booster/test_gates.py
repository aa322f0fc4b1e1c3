"""SAF-014: test the commands that are refused for a T1: each gate and each condition by itself, with its message.
No I/O."""

from __future__ import annotations

import math
from typing import Any

import pytest

from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.wire import Observation
from strands_actors.drivers import canonical_name, get_native_driver_class
from strands_actors.drivers.booster.driver import BoosterDriver
from strands_actors.drivers.booster.protocol import CommandType, Fall
from strands_actors.drivers.booster.rpc import Mode
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

NOW_S = 1000.0
NOW_NS = round(NOW_S * NS)
KEYS = (
    "left_shoulder_pitch",
    "left_shoulder_roll",
    "left_elbow_pitch",
    "left_elbow_yaw",
    "right_shoulder_pitch",
    "right_shoulder_roll",
    "right_elbow_pitch",
    "right_elbow_yaw",
)
HERE = (0.0, -1.4, 0.0, -0.4, 0.0, 1.4, 0.0, 0.4)

Row = tuple[float, ...]


def t1(**options: Any) -> BoosterDriver:
    return BoosterDriver("booster_t1", "127.0.0.1", options)


def observation(age_s: float = 0.0, **sensors: Row | None) -> Observation:
    """Return an observation of a robot that accepts commands, changed by ``sensors``. A sensor of None is
    missing."""
    stamp_ns = NOW_NS - round(age_s * NS)
    known: dict[str, Row] = {
        "fall_state": (float(Fall.IS_READY), NOW_S),
        "mode": (float(Mode.WALKING), NOW_S),
        "upper_body": (1.0,),
        "motors": (23.0,),
    }
    for name, row in sensors.items():
        known.pop(name, None)
        if row is not None:
            known[name] = row
    return Observation(stamp_ns, HERE, (stamp_ns,) * len(HERE), (), known)


def state(target: Row = (), period_s: float = 0.01, seen: Observation | None = None) -> GateState:
    return GateState(NOW_NS, seen or observation(), target or HERE, NOW_NS, period_s > 0, period_s)


def verdict(driver: BoosterDriver, action: Any, at: GateState) -> Candidate | Refused:
    """Judge an action as the gate does: the conditions, the parser, the gates."""
    for condition in driver.conditions:
        refusal = condition.check(at.observation, at.now_ns)
        if refusal is not None:
            return refusal
    candidate = driver.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    for gate in driver.gates:
        refusal = gate(candidate, at)
        if refusal is not None:
            return refusal
    return candidate


def refused(action: Any, at: GateState | None = None) -> Refused:
    answer = verdict(t1(), action, at or state())
    assert isinstance(answer, Refused), answer
    return answer


# -- accepted commands


def test_the_eight_names_of_the_upper_body_and_no_other() -> None:
    driver = t1()
    assert driver.axes == KEYS and driver.ids == tuple(range(2, 10))
    assert driver.unit == "radians"
    assert get_native_driver_class("booster_t1") is BoosterDriver
    assert canonical_name("Booster-T1") == "booster_t1"


@pytest.mark.parametrize("value", [0.05, {"q": 0.05}, {"q": 0.05, "kp": 60.0, "kd": 3.0, "tau": 0.0, "dq": 0.0}])
def test_a_number_or_a_dict_with_q(value: object) -> None:
    answer = verdict(t1(), {"left_elbow_pitch": value}, state())
    assert isinstance(answer, Candidate)
    assert answer.values[:8] == (*HERE[:2], 0.05, *HERE[3:])
    assert answer.values[24:] == (60.0,) * 8 + (3.0,) * 8
    assert t1().commanded({"left_elbow_pitch": value}, answer.values)["slots"] == [4]


# -- refused commands


@pytest.mark.parametrize("joint", ["left_knee_pitch", "waist", "head_yaw", "right_crank_up", "left_hip_roll.pos"])
def test_a_motor_of_the_onboard_controller(joint: str) -> None:
    answer = refused({"left_elbow_pitch": 0.0, joint: 0.0})
    assert answer.code == "not_ours" and "is moved only by the onboard controller" in answer.reason
    assert all(key in (answer.limit or "") for key in KEYS)
    assert "(slot 14)" in refused({"left_knee_pitch": 0.0}).reason
    assert "rotate_head" in refused({"head_yaw": 0.0}).text


def test_the_base_is_no_joint() -> None:
    assert "Call move(vx, vy, vyaw)" in refused({"vx": 0.1}).text


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"elbow": 0.0}, "unknown_joint"),
        ({"4": 0.0}, "unknown_joint"),
        ({4: 0.0}, "unknown_joint"),
        ({"left_elbow_pitch": math.nan}, "not_finite"),
        ({"left_elbow_pitch": "0.1"}, "not_finite"),
        ({"left_elbow_pitch": {"kp": 60.0}}, "no_q"),
        ({"left_elbow_pitch": {"q": 0.0, "weight": 1.0}}, "unknown_key"),
        ({"left_elbow_pitch": 0.0, "left_elbow_pitch.pos": 0.0}, "both_spellings"),
        ({"left_elbow_pitch": 2.3}, "past_travel"),
        ({"left_elbow_yaw": 0.1}, "past_travel"),
        ({"left_elbow_pitch": {"q": 0.0, "kp": 101.0}}, "gain"),
        ({"left_elbow_pitch": {"q": 0.0, "kd": -1.0}}, "gain"),
        ({"left_elbow_pitch": {"q": 0.0, "tau": 18.5}}, "too_strong"),
        ({"left_elbow_pitch": {"q": 0.0, "dq": 19.0}}, "too_fast"),
        ({"left_elbow_pitch": 0.3}, "too_fast"),
    ],
)
def test_impossible_arm_commands_are_refused(action: Any, code: str) -> None:
    assert refused(action).code == code


def test_a_single_command_steps_no_further_than_a_stream() -> None:
    assert refused({"left_elbow_pitch": 0.3}, state(period_s=0.0)).code == "too_fast"
    assert isinstance(verdict(t1(), {"left_elbow_pitch": 0.2}, state(period_s=0.0)), Candidate)


def test_the_upper_body_must_have_been_handed_over() -> None:
    for ours in ((0.0,), None):
        answer = refused({"left_elbow_pitch": 0.0}, state(seen=observation(upper_body=ours)))
        assert answer.text == ("the onboard controller still has the upper body. Call enable_upper_body() first")


@pytest.mark.parametrize("fall", [Fall.IS_FALLING, Fall.HAS_FALLEN, Fall.IS_GETTING_UP])
def test_a_robot_that_is_not_ready(fall: Fall) -> None:
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=observation(fall_state=(float(fall), NOW_S))))
    assert answer.text == f"the robot reports {fall.name}. Wait until the robot has got up (IS_READY)"


def test_a_fall_state_that_is_old_or_unknown() -> None:
    old = observation(fall_state=(0.0, NOW_S - 1.1))
    assert refused({"left_elbow_pitch": 0.0}, state(seen=old)).code == "fall_stale"
    condition = t1().conditions[0].check
    assert condition(old, NOW_NS) is None, "an old fall state does not end the motion yet"
    lost = condition(observation(fall_state=(0.0, NOW_S - 3.1)), NOW_NS)
    assert lost is not None and lost.code == "fall_stale"
    unknown = observation(fall_state=None)
    assert refused({"left_elbow_pitch": 0.0}, state(seen=unknown)).code == "fall_unknown"


def test_custom_mode_is_not_for_us() -> None:
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=observation(mode=(float(Mode.CUSTOM), NOW_S))))
    assert answer.code == "custom_mode" and "the legs would lose their torque" in answer.reason


def test_saf_012_a_mode_that_is_old_or_unknown() -> None:
    """The robot may be in custom mode by now."""
    old = observation(mode=(float(Mode.WALKING), NOW_S - 1.1))
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=old))
    assert answer.code == "mode_stale" and "the last report of the mode is 1.1 s old (limit 1.0 s)" in answer.reason
    assert refused({"left_elbow_pitch": 0.0}, state(seen=observation(mode=None))).code == "mode_unknown"
    late = observation(mode=(float(Mode.WALKING), NOW_S - 0.9))
    assert isinstance(verdict(t1(), {"left_elbow_pitch": 0.0}, state(seen=late)), Candidate)


def test_a_state_that_is_old_or_unknown() -> None:
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=observation(age_s=0.12)))
    assert answer.code == "stale" and "120 ms old (limit 100 ms)" in answer.reason
    unknown = observation()
    unknown = Observation(0, unknown.position, (0,) * 8, (), unknown.sensors)
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=unknown))
    assert answer.code == "no_state" and "no state has arrived yet" in answer.reason


def test_a_robot_with_too_few_motors() -> None:
    answer = refused({"left_elbow_pitch": 0.0}, state(seen=observation(motors=(9.0,))))
    assert answer.code == "too_few_motors" and "reports 9 motors, fewer than a T1 has" in answer.reason
    assert isinstance(verdict(t1(), {"left_elbow_pitch": 0.0}, state(seen=observation(motors=(10.0,)))), Candidate)


def test_a_fall_ends_live_and_held_commands() -> None:
    for condition in t1().conditions:
        assert condition.always and condition.reason is Reason.FAULT and condition.safe_state == SafeState.STOP


# -- the start of a motion


def test_saf_011_it_goes_on_from_where_it_is() -> None:
    assert t1().first_target(observation()) == HERE


def test_it_goes_on_from_its_goal_where_it_hangs_from_it_by_its_weight() -> None:
    goal = (HERE[0] + 0.05, HERE[1] + 0.5, *HERE[2:])
    target = t1().first_target(observation(goal_rad=goal))
    assert target == (HERE[0] + 0.05, HERE[1], *HERE[2:]), (
        "the new target does not start at a goal that is far away"
    )


# -- services and options


@pytest.mark.parametrize(
    ("service", "arguments", "code"),
    [
        ("move", {"vx": 0.9}, "past_limit"),
        ("move", {"vy": -0.5}, "past_limit"),
        ("move", {"vyaw": 1.1}, "past_limit"),
        ("move", {"vx": math.nan}, "not_finite"),
        ("move", {"vx": "fast"}, "not_finite"),
        ("move", {"vx": True}, "not_finite"),
        ("move", {"vz": 0.1}, "unknown_argument"),
        ("rotate_head", {"pitch": 1.3}, "past_limit"),
        ("rotate_head", {"yaw": -1.6}, "past_limit"),
        ("rotate_head", {"yaw": math.inf}, "not_finite"),
        ("change_mode", {"mode": "custom"}, "unknown_mode"),
        ("change_mode", {"mode": "kWalking"}, "unknown_mode"),
        ("change_mode", {"mode": 2}, "unknown_mode"),
        ("enable_upper_body", {"on": "no"}, "bad_argument"),
        ("enable_upper_body", {"arm": 1}, "unknown_argument"),
        ("dance", {}, "unknown_service"),
    ],
)
def test_invalid_service_arguments_are_refused(service: str, arguments: dict[str, Any], code: str) -> None:
    answer = t1().check_service(service, arguments)
    assert answer is not None and answer.code == code


def test_an_unknown_mode_is_refused_with_the_known_ones() -> None:
    answer = t1().check_service("change_mode", {"mode": "run"})
    assert answer is not None and answer.limit == "damping, prepare, walking, soccer"


@pytest.mark.parametrize(
    ("service", "arguments"),
    [
        ("move", {}),
        ("move", {"vx": 0.8, "vy": -0.4, "vyaw": 1.0}),
        ("rotate_head", {"pitch": -0.35, "yaw": 1.57}),
        ("change_mode", {"mode": "prepare"}),
        ("enable_upper_body", {}),
        ("disable_upper_body", {}),
        ("enable_upper_body", {"on": False}),
    ],
)
def test_valid_service_arguments_are_accepted(service: str, arguments: dict[str, Any]) -> None:
    assert t1().check_service(service, arguments) is None


def test_the_options_of_the_page() -> None:
    plain = BoosterDriver.resolve("booster_t1", {})
    assert plain == {"domain_id": 0, "robot_name": None, "cmd_type": "parallel", "network_interface": ""}
    config = t1(domain_id=7, robot_name="alice", cmd_type="serial").config
    assert (config.domain, config.name, config.command_type) == (7, "alice", CommandType.SERIAL)
    for wrong in (
        {"cmd_type": "both"},
        {"domain_id": 233},
        {"domain_id": -1},
        {"robot_name": "a/b"},
        {"robot_name": ""},
    ):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            BoosterDriver.resolve("booster_t1", wrong)
    with pytest.raises(TypeError, match="cmd_type"):
        BoosterDriver.resolve("booster_t1", {"cmd_typ": "serial"})


def test_a_reason_s_safe_state() -> None:
    fallbacks = t1().fallbacks
    assert {reason for reason in Reason if fallbacks[reason] == SafeState.HOLD} == {
        Reason.EXPIRED,
        Reason.LEASE,
        Reason.POLICY,
    }
    assert [reason for reason in Reason if fallbacks[reason] == SafeState.DAMP] == [Reason.ESTOP]
