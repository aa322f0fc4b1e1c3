"""Test every refusal of the Robotiq driver, and that nothing else passes. No I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.robotiq.driver import Robotiq
from strands_actors.drivers.robotiq.protocol import FAULTS
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

NOW_NS = 1000 * NS
GRIPPER = Robotiq("robotiq_2f85", "192.0.2.10", {})
POSITIONS = ("gripper", "gripper.pos", "position", "aperture_mm")


def state(activation: int = 3, fault: int = 0, age_s: float = 0.0) -> GateState:
    sensors = {"activation": (float(activation),), "fault": (float(fault),)}
    stamp_ns = NOW_NS - round(age_s * NS)
    observation = Observation(stamp_ns, (0.0,), (stamp_ns,), sensors=sensors)
    return GateState(NOW_NS, observation, (0.0,), NOW_NS, stream=False)


def decide(action: Mapping[Any, Any], at: GateState | None = None) -> Candidate | Refused:
    at = at or state()
    candidate = GRIPPER.parse(action, at)
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in GRIPPER.gates if (no := gate(candidate, at))), candidate)


def values(action: Mapping[Any, Any]) -> tuple[float, ...]:
    answer = decide(action)
    assert isinstance(answer, Candidate), answer
    assert answer.named == (0,)
    return answer.values


def refusal(action: Mapping[Any, Any], at: GateState | None = None) -> Refused:
    answer = decide(action, at)
    assert isinstance(answer, Refused), answer
    assert answer.code and answer.reason and answer.remedy
    assert answer.offered and answer.limit
    assert len(answer.text) < 300
    return answer


def test_the_four_spellings_of_one_place() -> None:
    assert values({"gripper": 0.8}) == values({"gripper.pos": 0.8}) == (0.8, 1.0, 1.0)
    assert values({"position": 17}) == values({"aperture_mm": 17.0}) == pytest.approx((0.8, 1.0, 1.0))


def test_the_ends_are_inside() -> None:
    assert values({"aperture_mm": 85.0, "speed": 0, "force": 0}) == (0.0, 0.0, 0.0)
    assert values({"aperture_mm": 0}) == (1.0, 1.0, 1.0)
    assert values({"gripper": 1, "speed": 1, "force": 1}) == (1.0, 1.0, 1.0)


@given(st.sampled_from(POSITIONS), st.sampled_from(POSITIONS))
def test_two_places_are_refused(first: str, second: str) -> None:
    if first != second:
        no = refusal({first: 0.5, second: 0.5})
        assert no.code == "both_spellings"
        assert no.offered == f"{first} and {second}"


@pytest.mark.parametrize("action", [{}, {"speed": 1.0}, {"force": 0.5, "speed": 0.5}])
def test_no_place_is_refused(action: dict[str, float]) -> None:
    assert refusal(action).code == "empty"


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({"gripper": 1.01}, "gripper 1.0100 is past 1.0000"),
        ({"gripper.pos": -0.01}, "gripper -0.0100 is past 0.0000"),
        ({"position": 85.1}, "position 85.1 mm is past 85.0"),
        ({"aperture_mm": -1}, "aperture_mm -1.0 mm is past 0.0"),
        ({"gripper": 0.5, "speed": 1.5}, "speed 1.5000 is past 1.0000"),
        ({"gripper": 0.5, "force": -0.5}, "force -0.5000 is past 0.0000"),
    ],
)
def test_out_of_range_is_refused_never_clamped(action: dict[str, float], says: str) -> None:
    no = refusal(action)
    assert no.code == "past_travel"
    assert says in no.reason


@pytest.mark.parametrize("key", ["", ".pos", "gripper.pos.pos", "grip", "speed.pos", "x" * 10_000, 7, None])
def test_strange_keys_are_unknown(key: object) -> None:
    assert refusal({key: 0.5}).code == "unknown_joint"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, True, None, "1", [0.5], 1j, 10**400])
@pytest.mark.parametrize("key", ["gripper", "aperture_mm", "speed", "force"])
def test_only_finite_numbers(key: str, value: object) -> None:
    assert refusal({"gripper": 0.5} | {key: value}).code in ("not_finite", "both_spellings")


@given(st.dictionaries(st.sampled_from([*POSITIONS, "speed", "force", "x"]), st.floats(), max_size=4))
def test_accepted_targets_are_whole_and_in_range(action: dict[str, float]) -> None:
    answer = decide(action)
    if isinstance(answer, Candidate):
        assert len(answer.values) == 3
        assert all(0.0 <= value <= 1.0 for value in answer.values)


@pytest.mark.parametrize("activation", [0, 1])
def test_not_activated(activation: int) -> None:
    no = refusal({"gripper": 0.5}, state(activation=activation))
    assert no.code == "not_activated"
    assert f"the gripper is not activated (gSTA {activation})" in no.reason


@pytest.mark.parametrize("fault", sorted(set(FAULTS) - {0, 9}))
def test_a_fault_is_named(fault: int) -> None:
    no = refusal({"gripper": 0.5}, state(fault=fault))
    assert no.code == "fault"
    assert FAULTS[fault] in no.reason and f"gFLT {fault}" in no.reason


def test_a_past_silence_is_a_status_only() -> None:
    assert isinstance(decide({"gripper": 0.5}, state(fault=9)), Candidate)


def test_stale() -> None:
    assert isinstance(decide({"gripper": 0.5}, state(age_s=0.29)), Candidate)
    no = refusal({"gripper": 0.5}, state(age_s=0.31))
    assert no.code == "stale"
    assert "310 ms" in no.reason


def test_the_answer_of_send_action() -> None:
    action = {"aperture_mm": 17.0, "force": 0.25}
    assert GRIPPER.commanded(action, values(action)) == {
        "robot": "robotiq_2f85",
        "commanded_key": "aperture_mm",
        "gripper": 0.8,
        "position": 204,
        "aperture_mm": 17.0,
        "speed": 255,
        "force": 64,
    }


@pytest.mark.parametrize(("contact", "held"), [(1.0, True), (-1.0, True), (0.0, False), (math.nan, None)])
def test_the_answer_shows_whether_an_object_is_held(contact: float, held: bool | None) -> None:
    reported = GRIPPER.accepted({"gripper": 0.5}, values({"gripper": 0.5}), {"contact": (contact,)})
    assert reported["holding"] is held
    assert GRIPPER.accepted({"gripper": 0.5}, values({"gripper": 0.5}), {})["holding"] is None


def test_no_reason_ever_opens_it() -> None:
    assert set(GRIPPER.fallbacks) == set(Reason)
    assert set(GRIPPER.fallbacks.values()) == {"hold"}
    assert GRIPPER.energised("hold")


# -- options


@pytest.mark.parametrize("robot", ["robotiq_2f85", "robotiq_2f85_v4", "2f85"])
def test_every_robot_can_be_built_from_its_resolved_options(robot: str) -> None:
    resolved = Robotiq.resolve(robot, {"tool_name": "hand"})
    driver = Robotiq(robot, "192.0.2.10:1502", resolved)
    assert (driver.config.unit_id, driver.config.stroke_mm, driver.config.activate) == (9, 85.0, True)
    assert driver.ids == (9,) and driver.axes == ("gripper",)
    assert driver.config.address() == ("192.0.2.10", 1502)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"unit_id": 248}, "0 to 247"),
        ({"unit_id": True}, "0 to 247"),
        ({"stroke_mm": 140}, "opens 85 mm"),
        ({"activate": "yes"}, "True or False"),
    ],
)
def test_bad_options_are_refused_by_name(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Robotiq.resolve("robotiq_2f85", options)


def test_an_unknown_option_or_robot_is_refused_by_name() -> None:
    with pytest.raises(TypeError, match="unknown option parity"):
        Robotiq.resolve("robotiq_2f85", {"parity": "N"})
    with pytest.raises(ValueError, match="robotiq_2f85, robotiq_2f85_v4"):
        Robotiq.resolve("robotiq_2f140", {})
