"""Test which commands are refused with which messages. A value that a message allows is accepted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.axis import PartKind
from strands_actors.contract.driver import HOLDING_REASONS, Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers import get_native_driver_class
from strands_actors.drivers.rby1.driver import HOLD_S, RBY1
from strands_actors.kernel.messages import Refused

NOW_NS = 10**12
MS = 1_000_000
GOOD = {"emergency_stop": 0.0, "control_manager": 2.0, "power": 1.0, "joints_ready": 1.0}


def driver(**options: Any) -> RBY1:
    return RBY1("rby1", "192.0.2.1", options)


def seen(**sensors: float) -> Observation:
    axes = driver().table
    rows: dict[str, tuple[float, ...]] = {
        "range_low_rad": tuple(axis.low for axis in axes),
        "range_high_rad": tuple(axis.high for axis in axes),
        "speed_limit_rad_s": tuple(axis.speed for axis in axes),
    }
    said = {name: (value,) for name, value in {**GOOD, **sensors}.items()}
    return Observation(NOW_NS, (0.0,) * 22, (NOW_NS - 5 * MS,) * 22, sensors=rows | said)


def state(observation: Observation | None = None, target: float = 0.0, stream_s: float = 0.0) -> GateState:
    return GateState(NOW_NS, observation or seen(), (target,) * 22, NOW_NS - 10 * MS, bool(stream_s), stream_s)


def judge(action: Mapping[str, Any], at: GateState | None = None, by: RBY1 | None = None) -> Candidate | Refused:
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


def refused(action: Mapping[str, Any], at: GateState | None = None, by: RBY1 | None = None) -> Refused:
    answer = judge(action, at, by)
    assert isinstance(answer, Refused), answer
    return answer


def test_a_valid_command_is_accepted_and_other_joints_keep_their_targets() -> None:
    candidate = judge({"torso_1": 0.04, "head_1.pos": -0.06})
    assert isinstance(candidate, Candidate)
    assert (candidate.values[1], candidate.values[21], sum(map(abs, candidate.values))) == (
        0.04,
        -0.06,
        pytest.approx(0.1),
    )


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"right_wheel": 0.0}, "unknown_joint"),
        ({"gripper_finger_r1": 0.0}, "unknown_joint"),
        ({"torso_6": 0.0}, "unknown_joint"),
        ({"head_0": 0.0, "head_0.pos": 0.0}, "both_spellings"),
        ({"head_0": math.nan}, "not_finite"),
        ({"head_0": math.inf}, "not_finite"),
        ({"head_0": True}, "not_finite"),
        ({"head_0": "0.1"}, "not_finite"),
    ],
)
def test_saf_014_an_invalid_action_is_refused(action: Mapping[str, Any], code: str) -> None:
    assert refused(action).code == code


# -- the robot


@pytest.mark.parametrize(
    ("sensors", "says"),
    [
        ({"emergency_stop": 1.0, "power": 0.0}, "the emergency stop button is pressed. Release the button"),
        ({"control_manager": 3.0}, "the robot's control manager reports MINOR_FAULT (3). Fix its cause"),
        ({"control_manager": 4.0}, "the robot's control manager reports MAJOR_FAULT (4)"),
        ({"control_manager": 1.0}, "the control manager is IDLE (1). Check the cause"),
        ({"power": 0.0}, "the motors have no power"),
        ({"joints_ready": 0.0}, "servos are off"),
    ],
)
def test_a_robot_that_does_not_follow_is_named(sensors: Mapping[str, float], says: str) -> None:
    assert says in refused({"torso_0": 0.0}, state(seen(**sensors))).text


def test_a_robot_without_a_report_is_refused_commands() -> None:
    bare = Observation(NOW_NS, (0.0,) * 22, (NOW_NS,) * 22)
    assert refused({"torso_0": 0.0}, state(bare)).code == "emergency_stop"
    good = msgspec.structs.replace(bare, sensors={name: (value,) for name, value in GOOD.items()})
    assert refused({"torso_0": 0.0}, state(good)).code == "no_limits"
    for condition in driver().conditions:
        assert condition.always and condition.reason is Reason.FAULT


def test_a_dropped_command_is_named() -> None:
    dropped = msgspec.structs.replace(seen(), faults={"controller": "the robot has dropped our command: PREEMPTED"})
    refusal = refused({"torso_0": 0.0}, state(dropped))
    assert (refusal.code, "PREEMPTED" in refusal.text) == ("dropped", True)


def test_saf_012_an_old_state_does_not_count() -> None:
    old = msgspec.structs.replace(seen(), stamp_ns=(NOW_NS - 151 * MS,) * 22)
    refusal = refused({"torso_0": 0.0}, state(old))
    assert (refusal.code, refusal.limit) == ("stale", "150 ms")


# -- range and speed


@pytest.mark.parametrize("at", range(22))
def test_every_joint_stays_within_its_range(at: int) -> None:
    axis = driver().table[at]
    for end, outwards in ((axis.low, -0.01), (axis.high, 0.01)):
        near = msgspec.structs.replace(seen(), position=(end,) * 22)
        assert isinstance(judge({axis.key: end}, state(near, end)), Candidate)
        refusal = refused({axis.key: end + outwards}, state(near, end))
        assert refusal.code == "past_travel"


def test_the_ranges_and_speeds_are_the_robots_own_not_the_tables() -> None:
    own = seen()
    sensors = {**own.sensors, "range_low_rad": (-0.01,) * 22, "range_high_rad": (0.01,) * 22}
    assert (
        refused({"torso_0": 0.02}, state(msgspec.structs.replace(own, sensors=sensors))).limit == "-0.0100..0.0100"
    )
    sensors = {**own.sensors, "speed_limit_rad_s": (0.5,) * 22}
    assert refused({"torso_0": 0.011}, state(msgspec.structs.replace(own, sensors=sensors))).limit == "0.01"
    sensors = {**own.sensors, "speed_limit_rad_s": (0.5,) * 21}
    assert refused({"torso_0": 0.0}, state(msgspec.structs.replace(own, sensors=sensors))).code == "no_limits"


@given(st.integers(0, 21), st.floats(10, 100), st.floats(0.0, 1.0))
def test_a_step_is_what_a_joint_turns_in_a_control_period(at: int, hz: float, stream_s: float) -> None:
    by = driver(control_frequency=hz)
    axis = by.table[at]
    allowed = axis.speed / hz
    low = msgspec.structs.replace(seen(), position=(axis.low,) * 22)
    here = state(low, axis.low, stream_s)
    room = axis.high - axis.low
    if allowed < room:
        assert isinstance(judge({axis.key: axis.low + allowed * 0.999}, here, by), Candidate)
    if allowed * 1.01 < room:
        refusal = refused({axis.key: axis.low + allowed * 1.01}, here, by)
        assert refusal.code == "too_fast"


def test_small_steps_in_quick_succession_do_not_run_away_from_the_joint() -> None:
    target = 0.0
    while isinstance(answer := judge({"torso_1": target + 0.04}, state(target=target)), Candidate):
        target = answer.values[1]
    assert answer.code == "runs_ahead"
    assert target == pytest.approx(0.4)


# -- declarations


def test_it_is_registered_and_declares_its_keywords() -> None:
    assert get_native_driver_class("rby1") is RBY1
    assert get_native_driver_class("RB-Y1") is RBY1
    assert RBY1.resolve("rby1", {}) == {"control_frequency": 50.0, "priority": 1, "on_estop": "stop"}


def test_its_parts_are_torso_arms_and_head() -> None:
    parts = driver().parts
    assert [(part.kind, part.name, len(part.axes)) for part in parts] == [
        (PartKind.TORSO, "", 6),
        (PartKind.ARM, "right", 7),
        (PartKind.ARM, "left", 7),
        (PartKind.HEAD, "", 2),
    ]
    assert driver().ids == tuple(range(2, 24))


@pytest.mark.parametrize(
    "options",
    [
        {"control_frequency": 9.9},
        {"control_frequency": 101},
        {"control_frequency": math.nan},
        {"control_frequency": "50"},
        {"priority": 0},
        {"priority": 101},
        {"priority": 1.5},
        {"priority": True},
        {"on_estop": "limp"},
    ],
)
def test_an_option_that_cannot_be_is_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        RBY1.resolve("rby1", options)


def test_an_unknown_keyword_names_the_nearest() -> None:
    with pytest.raises(TypeError, match="'prority' -> 'priority'"):
        RBY1.resolve("rby1", {"prority": 2})


def test_each_reason_leads_to_its_safe_state() -> None:
    usual, dropping = driver().fallbacks, driver(on_estop="power_off").fallbacks
    for reason in Reason:
        assert usual[reason] == ("hold" if reason in HOLDING_REASONS else "stop")
        assert dropping[reason] == ("off" if reason is Reason.ESTOP else usual[reason])


def test_the_robots_watchdog_is_armed_with_enough_time() -> None:
    assert driver().timing.keepalive_s * 2 < HOLD_S
    assert "300 ms" in driver().firmware_watchdog


@pytest.mark.parametrize(
    ("port", "address"),
    [("192.0.2.1", ("192.0.2.1", 50051)), ("192.0.2.1:5", ("192.0.2.1", 5)), ("upc.local", ("upc.local", 50051))],
)
def test_the_port_is_an_address(port: str, address: tuple[str, int]) -> None:
    assert RBY1("rby1", port, {}).config.address() == address


def test_the_answer_of_send_action() -> None:
    values = tuple(at / 10 for at in range(22))
    commanded = driver().commanded({"torso_1.pos": 0.1, "head_1": 2.1}, values)
    assert commanded == {"robot": "rby1", "joints": {"torso_1": 0.1, "head_1": 2.1}}
