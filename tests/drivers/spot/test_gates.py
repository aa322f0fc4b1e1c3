"""Test which commands a Spot refuses, with code, offered value and limit, and the values of accepted actions."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import GateState, Live
from strands_actors.contract.wire import Observation
from strands_actors.drivers.spot.driver import Spot
from strands_actors.drivers.spot.robots import DRIVES, KEYS, LEGS, MOVES_ARM, MOVES_CLAW, TABLES
from strands_actors.kernel.messages import Refused

from .rig import NOW_NS, accepted, observed, refused, state

NAN = math.nan
ARMLESS = (0.0, 0.0, 0.0, *(NAN,) * 7)


@pytest.mark.parametrize(
    ("action", "code", "says"),
    [
        ({"vx": 1.7}, "past_travel", "Stay within -1.6000..1.6000"),
        ({"wz": -1.6}, "past_travel", "-1.5000..1.5000"),
        ({"arm_sh0": 3.2}, "past_travel", "-2.6179..3.1415"),
        ({"arm_el0": -0.1}, "past_travel", "0.0000..3.1415"),
        ({"arm_f1x": 0.1}, "past_travel", "-1.5708..0.0000"),
        ({"arm_wr0": 1.84}, "past_travel", "1.8326"),
        ({"fl_hx": 0.0}, "read_only", "legs belong to the locomotion controller"),
        ({"hr_kn.pos": 0.0, "vx": 0.1}, "read_only", "legs belong to the locomotion controller"),
        ({"gripper": 0.0}, "unknown_joint", "Use vx, vy, wz, arm_sh0"),
        ({"vx": NAN}, "not_finite", "finite"),
        ({}, "empty", "names no joint"),
    ],
)
def test_saf_014_an_invalid_command_is_refused(action: dict[str, Any], code: str, says: str) -> None:
    refusal = refused(action)
    assert refusal.code == code
    assert says in refusal.text


@pytest.mark.parametrize("leg", LEGS)
def test_no_leg_is_moved_by_us(leg: str) -> None:
    assert refused({leg: 0.1}).code == "read_only"


@pytest.mark.parametrize(
    ("sensors", "faults", "code", "says"),
    [
        ({"estopped": 1.0}, {}, "estopped", "the robot is E-stopped. Release it first"),
        ({"motors": 1.0}, {}, "motors_off", "its motors are off. Call stand() first"),
        ({"motors": 3.0}, {}, "motors_off", "powering on"),
        ({}, {"lease": "the lease was taken over by tablet-7"}, "lease_lost", "tablet-7"),
        ({}, {"estop": "another client has set up the robot's e-stop"}, "estop_lost", "Call resume()"),
    ],
)
def test_saf_014_a_robot_that_may_not_be_moved(
    sensors: dict[str, float], faults: dict[str, str], code: str, says: str
) -> None:
    seen = observed(**sensors)
    seen = Observation(seen.t_ns, seen.position, seen.stamp_ns, sensors=seen.sensors, faults=faults)
    refusal = refused({"vx": 0.1}, state(seen))
    assert refusal.code == code
    assert says in refusal.text


def test_a_robot_without_an_arm_refuses_arm_commands_and_walks() -> None:
    at = state(observed(ARMLESS))
    assert refused({"arm_sh0": 0.0}, at).reason == "this robot has no arm"
    assert refused({"arm_f1x": 0.0}, at).reason == "this robot has no claw"
    walks = accepted({"vx": 0.3}, at)
    assert (walks.values[MOVES_ARM], walks.values[MOVES_CLAW]) == (0.0, 0.0)
    assert Spot("spot", "", {}).as_json(ARMLESS) == {"vx": 0.0, "vy": 0.0, "wz": 0.0}


def test_a_joint_that_was_not_read_for_long_is_not_moved() -> None:
    old = Observation(NOW_NS, (0.0,) * 10, (NOW_NS - 10**9,) * 10, sensors=observed().sensors)
    assert refused({"arm_sh0": 0.1}, state(old)).code == "stale"


def test_saf_001_a_twist_ends_and_the_arm_holds_its_target() -> None:
    assert accepted({"vx": 0.5}).until_ns == NOW_NS + 600_000_000
    assert accepted({"vx": 0.0}).until_ns == 0
    assert accepted({"arm_sh0": 0.5}).until_ns == 0
    both = accepted({"arm_sh0": 0.5, "vx": 0.1})
    assert both.until_ns == NOW_NS + 600_000_000


def test_saf_001_an_arm_command_goes_on_with_a_twist_and_does_not_prolong_it() -> None:
    walking = state(observed(), live=Live(NOW_NS + 10**8))
    walking = type(walking)(
        NOW_NS, walking.observation, (0.5, *(0.0,) * 9, 1.0, 0.0, 0.0), NOW_NS, False, 0.0, Live(NOW_NS + 10**8)
    )
    goes_on = accepted({"arm_sh0": 0.1}, walking)
    assert goes_on.values[0] == 0.5 and goes_on.values[DRIVES] == 1.0
    assert goes_on.until_ns == NOW_NS + 10**8
    rests = accepted({"vy": 0.1}, walking)
    assert rests.values[:3] == (0.0, 0.1, 0.0), "axes that the twist does not name are zero"


def test_parts_that_are_not_named_get_no_command() -> None:
    assert accepted({"arm_sh0": 0.1}).values[DRIVES:] == (0.0, 1.0, 0.0)
    assert accepted({"arm_f1x": -0.1}).values[DRIVES:] == (0.0, 0.0, 1.0)
    assert accepted({"wz": 0.0}).values[DRIVES:] == (1.0, 0.0, 0.0), "a zero is sent, because it stops a twist"


def test_saf_014_a_joint_without_a_target_never_gets_an_invented_one() -> None:
    """The joint's reading was missing at arming, and exists now. A command always has all joints of the
    arm."""
    armed = (0.0, 0.0, 0.0, 0.1, -2.8, NAN, 0.0, 0.0, 0.0, -0.2)
    seen = observed((0.0, 0.0, 0.0, 0.1, -2.8, 2.8, 0.0, 0.0, 0.0, -0.2))
    first = Spot("spot", "", {}).first_target(observed(armed))
    at = GateState(NOW_NS, seen, first, NOW_NS, False)
    refusal = refused({"arm_sh0": 0.15}, at)
    assert refusal.code == "stale"
    assert "arm_el0 had no position" in refusal.text and "Give arm_el0, too" in refusal.text
    walks = accepted({"vx": 0.1, "arm_f1x": -0.3}, at)
    assert walks.values[DRIVES:] == (1.0, 0.0, 1.0), "the parts other than the arm are sent"
    after = GateState(NOW_NS, seen, walks.values, NOW_NS, False)
    assert refused({"arm_sh0": 0.15}, after).code == "stale", "after a walk the joint still has no target"
    whole = accepted({"arm_sh0": 0.15, "arm_el0": 2.8}, after)
    assert whole.values[3:9] == (0.15, -2.8, 2.8, 0.0, 0.0, 0.0)
    assert accepted({"arm_sh0": 0.2}, GateState(NOW_NS, seen, whole.values, NOW_NS, False))


@given(st.dictionaries(st.sampled_from(KEYS), st.floats(-4, 4), min_size=1))
def test_saf_014_accepted_values_are_within_the_ranges(action: dict[str, float]) -> None:
    from .rig import answer

    found = answer(action)
    axes = Spot("spot", "", {}).table
    within = all(axis.low - 1e-9 <= action[axis.key] <= axis.high + 1e-9 for axis in axes if axis.key in action)
    assert isinstance(found, Refused) is not within


def test_a_stream_may_not_step_further_than_the_arm_moves() -> None:
    streaming = state(stream=True)
    assert accepted({"arm_sh0": 0.29}, streaming)
    assert refused({"arm_sh0": 0.35}, streaming).code == "too_fast"
    assert accepted({"arm_sh0": 2.0}), "a single command may, because the robot limits its speed"


@pytest.mark.parametrize("arguments", [{"vx": 2.0}, {"wz": NAN}, {"vx": "fast"}, {"speed": 1.0}])
def test_saf_014_an_invalid_set_twist_is_refused(arguments: dict[str, Any]) -> None:
    refusal = Spot("spot", "", {}).check_service("set_twist", arguments)
    assert refusal is not None
    assert Spot("spot", "", {}).check_service("set_twist", {"vx": 0.5, "wz": -0.1}) is None


@pytest.mark.parametrize(
    ("option", "value"),
    [("control_frequency", 100.0), ("estop_timeout_s", 0.1), ("on_estop", "fall"), ("controlfrequency", 10.0)],
)
def test_invalid_options_are_refused(option: str, value: Any) -> None:
    with pytest.raises((ValueError, TypeError), match=option):
        Spot.resolve("spot", {option: value})


def test_the_page_is_kept() -> None:
    driver = Spot("spot", "", Spot.resolve("spot", {}))
    assert driver.timing.control_hz == 10.0
    assert driver.axes == KEYS
    assert [verb.name for verb in driver.TOOL_VERBS] == [
        "sensors",
        "state",
        "status",
        "stand",
        "move_to",
        "move",
        "stop",
    ]
    assert driver.GUARDED == ("move_to", "move")
    assert set(driver.SERVICES) == {"stand", "set_twist"}
    assert driver.commanded({"arm_sh0": 0.5}, accepted({"arm_sh0": 0.5}).values) == {
        "robot": "spot",
        "joints": {"arm_sh0": 0.5},
    }
    assert list(TABLES.table("spot")["joints_rad"]) == list(KEYS[3:])
