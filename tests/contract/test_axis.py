"""Test axes: parsing of actions, the first target, and the gates that are derived from the table."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind, axes_of, first_target, parse_action
from strands_actors.contract.axis_gates import axis_gates, past_range, stale, too_fast
from strands_actors.contract.driver import Candidate, GateState
from strands_actors.contract.wire import Observation
from strands_actors.kernel.messages import Refused

ARM = tuple(Axis(key=f"joint{at}", unit="rad", low=-2.0, high=2.0, speed=1.0, id=at) for at in (1, 2))
WHEELS = tuple(Axis(key=key, unit="m/s", low=-0.5, high=0.5, mode=AxisMode.VELOCITY) for key in ("vx", "vy"))
TABLE = axes_of((Part(PartKind.ARM, ARM), Part(PartKind.BASE, WHEELS)))
INDEX = {axis.key: at for at, axis in enumerate(TABLE)}


def parse(action: dict[str, object], target: tuple[float, ...] = (0.1, 0.2, 0.3, 0.4)) -> object:
    return parse_action(action, "rover", TABLE, INDEX, target)


def state(*, stream: bool = False, period_s: float = 0.0, age_ns: int = 0, since_ns: int = 0) -> GateState:
    now_ns = 10**9
    seen = Observation(now_ns, (0.0,) * 4, (now_ns - age_ns,) * 4)
    return GateState(now_ns, seen, (0.1, 0.2, 0.0, 0.0), now_ns - since_ns, stream, period_s)


def test_a_position_that_is_not_named_keeps_its_target_and_a_velocity_rests() -> None:
    assert parse({"joint2": 1}) == ((0.1, 1.0, 0.0, 0.0), (1,))
    assert parse({"vx": 0.25}) == ((0.1, 0.2, 0.25, 0.0), (2,))
    assert parse({"joint1.pos": 0.5}) == ((0.5, 0.2, 0.0, 0.0), (0,))


def test_a_base_that_was_just_armed_does_not_drive_to_its_odometry() -> None:
    assert first_target(TABLE, (0.7, 0.8, 3.0, 1.5)) == (0.7, 0.8, 0.0, 0.0)


@pytest.mark.parametrize(
    ("action", "code"),
    [
        ({}, "empty"),
        ({"joint9": 1.0}, "unknown_joint"),
        ({1: 1.0}, "unknown_joint"),
        ({"joint1": math.nan}, "not_finite"),
        ({"joint1": True}, "not_finite"),
        ({"joint1": "1"}, "not_finite"),
        ({"joint1": 10**400}, "not_finite"),
        ({"joint1": 1.0, "joint1.pos": 1.0}, "both_spellings"),
    ],
)
def test_saf_014_bad_actions_are_refused_by_name(action: dict[str, object], code: str) -> None:
    refused = parse(action)
    assert isinstance(refused, Refused) and refused.code == code and refused.remedy


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("5", "joint1 is '5', a text."),
        ("", "joint1 is '', a text."),
        ("inf", "joint1 is 'inf', a text."),
        ("wide", "joint1 is wide."),
        (math.nan, "joint1 is nan."),
        (True, "joint1 is True."),
        ([5], "joint1 is [5]."),
        (None, "joint1 is None, as JSON also has what is infinite or not a number."),
    ],
)
def test_saf_014_a_refusal_shows_the_value_that_is_not_a_number(value: object, message: str) -> None:
    refused = parse({"joint1": value})
    assert isinstance(refused, Refused) and refused.code == "not_finite"
    assert refused.text == f"{message} Send a finite number"


def test_two_axes_of_one_name_are_refused() -> None:
    with pytest.raises(ValueError, match="joint1"):
        axes_of((Part(PartKind.ARM, ARM), Part(PartKind.ARM, ARM, "left")))


def test_saf_014_past_its_range() -> None:
    gate = past_range(TABLE)
    refused = gate(Candidate((2.5, 0.0, 0.0, 0.0), (0,)), state())
    assert isinstance(refused, Refused)
    assert refused.text == "joint1 2.5000 rad is past 2.0000. Stay within -2.0000..2.0000"
    # the gate checks only axes that the action names
    assert gate(Candidate((2.5, 0.0, 0.0, 0.0), (1,)), state()) is None
    assert gate(Candidate((math.nan, 0.0, 0.0, 0.0), (0,)), state()) is not None


@given(st.floats(-10, 10), st.floats(-3, 3), st.floats(0.001, 3))
def test_the_limits_named_in_a_refusal_are_accepted(value: float, low: float, span: float) -> None:
    axis = Axis(key="a", unit="rad", low=low, high=low + span)
    refused = past_range((axis,))(Candidate((value,), (0,)), state())
    if refused is not None:
        bottom, _, top = refused.limit.partition("..")
        for end in (float(bottom), float(top)):
            if float(bottom) <= float(top):
                assert past_range((axis,))(Candidate((end,), (0,)), state()) is None


def test_saf_012_an_old_position_does_not_count() -> None:
    gate = stale(TABLE, 0.3)
    assert gate(Candidate((0.1,) * 4, (0,)), state(age_ns=200_000_000)) is None
    refused = gate(Candidate((0.1,) * 4, (0,)), state(age_ns=400_000_000))
    assert isinstance(refused, Refused) and "no position from joint1 (id 1) for 400 ms" in refused.text
    assert gate(Candidate((0.1, math.nan, 0.0, 0.0), (0,)), state()) is not None


def test_saf_014_a_stream_steps_as_far_as_the_axis_moves() -> None:
    gate = too_fast(TABLE, longest_s=0.1)
    at_30_hz = state(stream=True, period_s=1 / 30)
    assert gate(Candidate((0.1 + 1.2 / 30, 0.2, 0.0, 0.0), (0,)), at_30_hz) is None
    refused = gate(Candidate((0.1 + 1.3 / 30, 0.2, 0.0, 0.0), (0,)), at_30_hz)
    assert isinstance(refused, Refused) and refused.code == "too_fast"
    assert "joint1 steps 0.043333 rad in 33.3 ms" in refused.text and refused.limit == "0.0400"
    after_a_pause = state(stream=True, period_s=1 / 30, since_ns=5 * 10**9)
    assert gate(Candidate((0.1 + 0.13, 0.2, 0.0, 0.0), (0,)), after_a_pause) is not None
    assert gate(Candidate((5.0, 0.2, 0.0, 0.0), (0,)), state()) is None  # a single command has no step limit
    assert gate(Candidate((0.1, 0.2, 99.0, 0.0), (2,)), at_30_hz) is None  # no acceleration limit declared


def test_saf_014_a_pause_can_count_for_nothing() -> None:
    """A controller may go to each target within one period, however old the last target is. The step limit then
    does not grow during a pause."""
    after_a_pause = state(stream=True, period_s=0.008, since_ns=5 * 10**9)
    step = Candidate((0.1 + 0.05, 0.2, 0.0, 0.0), (0,))
    assert too_fast(TABLE, longest_s=0.1)(step, after_a_pause) is None
    refused = too_fast(TABLE, tolerance=1.0, longest_s=0.1, pause_counts=False)(step, after_a_pause)
    assert isinstance(refused, Refused) and refused.limit == "0.0080"
    assert "steps 0.0500 rad in 8 ms" in refused.text


def test_saf_014_a_slow_stream_steps_no_further_than_its_longest_period() -> None:
    gate = too_fast(TABLE, tolerance=1.0, longest_s=0.1, pause_counts=False)
    slow = state(stream=True, period_s=1.0)
    assert gate(Candidate((0.19, 0.2, 0.0, 0.0), (0,)), slow) is None
    assert gate(Candidate((0.21, 0.2, 0.0, 0.0), (0,)), slow) is not None


def test_the_rounding_error_of_the_wire_is_within_the_range() -> None:
    at_its_end = Candidate((2.0 + 5e-7, 0.2, 0.0, 0.0), (0,))
    assert past_range(TABLE, rounding=1e-6)(at_its_end, state()) is None
    assert past_range(TABLE)(at_its_end, state()) is not None


def test_saf_014_a_command_on_its_own_steps_no_further_than_one_period() -> None:
    gate = too_fast(TABLE, oneshot_s=0.008)
    assert gate(Candidate((0.108, 0.2, 0.0, 0.0), (0,)), state()) is None
    assert gate(Candidate((0.11, 0.2, 0.0, 0.0), (0,)), state()) is not None


def test_the_gates_of_a_table_ask_for_freshness_first() -> None:
    gates = axis_gates(TABLE, 0.3, oneshot_s=0.008)
    first = next(refused for gate in gates if (refused := gate(Candidate((9.0,) * 4, (0,)), state(age_ns=10**9))))
    assert first.code == "stale"


def beyond(measured: float, target: float) -> GateState:
    now_ns = 10**9
    seen = Observation(now_ns, (measured, 0.0, 0.0, 0.0), (now_ns,) * 4)
    return GateState(now_ns, seen, (target, 0.2, 0.0, 0.0), now_ns, False)


def test_saf_014_a_joint_that_is_past_its_end_may_be_held_there_or_brought_back() -> None:
    """A policy that returns what it observed must not be refused for where the joint is."""
    gate = past_range(TABLE)
    for end in (1.0, -1.0):
        stands = beyond(end * 2.05, 0.0)
        for value in (2.05, 2.0501, 2.02, 2.0):
            assert gate(Candidate((end * value, 0.2, 0.0, 0.0), (0,)), stands) is None, value
        assert gate(Candidate((end * 2.06, 0.2, 0.0, 0.0), (0,)), stands) is not None
        assert gate(Candidate((end * -2.01, 0.2, 0.0, 0.0), (0,)), stands) is not None  # the other end
        # The last observation may lie a little further out than the joint is now.
        comes_back = beyond(end * 2.01, end * 2.05)
        assert gate(Candidate((end * 2.04, 0.2, 0.0, 0.0), (0,)), comes_back) is None
        assert gate(Candidate((end * 2.051, 0.2, 0.0, 0.0), (0,)), comes_back) is not None


def test_saf_014_a_measured_velocity_past_the_range_does_not_allow_that_speed() -> None:
    now_ns = 10**9
    fast = GateState(
        now_ns, Observation(now_ns, (0.0, 0.0, 0.9, 0.0), (now_ns,) * 4), (0.0, 0.0, 0.9, 0.0), 0, False
    )
    assert past_range(TABLE)(Candidate((0.0, 0.0, 0.9, 0.0), (2,)), fast) is not None


def test_saf_014_an_unknown_position_allows_nothing_past_the_end() -> None:
    unknown = beyond(math.nan, math.nan)
    assert past_range(TABLE)(Candidate((2.01, 0.0, 0.0, 0.0), (0,)), unknown) is not None


@given(st.floats(1e-8, 1.0))
def test_a_refusal_shows_that_the_value_is_past_the_end(past: float) -> None:
    refused = past_range(TABLE)(Candidate((2.0 + past, 0.2, 0.0, 0.0), (0,)), beyond(0.0, 0.0))
    assert isinstance(refused, Refused) and float(refused.offered) > 2.0
    refused = past_range(TABLE)(Candidate((-2.0 - past, 0.2, 0.0, 0.0), (0,)), beyond(0.0, 0.0))
    assert isinstance(refused, Refused) and float(refused.offered) < -2.0
