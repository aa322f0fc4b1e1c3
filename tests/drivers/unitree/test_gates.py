"""SAF-014: test the commands that are refused for robots with legs: each gate and each condition by itself, with
its message. No I/O."""

from __future__ import annotations

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.kit.motor_targets import DQ, KD, KP, ROWS, TAU, Q
from strands_actors.drivers.unitree.driver import G1Driver, Go2Driver
from strands_actors.drivers.unitree.gates import CONTROL_S
from strands_actors.kernel.clock import NS
from strands_actors.kernel.messages import Refused

NOW_S = 1000.0
NOW_NS = round(NOW_S * NS)


def g1(**options: Any) -> G1Driver:
    return G1Driver("unitree_g1", "127.0.0.1", options)


def go2(robot: str = "unitree_go2", **options: Any) -> Go2Driver:
    return Go2Driver(robot, "127.0.0.1", options)


def observation(driver: Driver, age_s: float = 0.0, **sensors: tuple[float, ...] | None) -> Observation:
    """Return an observation of a robot that accepts commands, changed by ``sensors``. A sensor of None is
    missing."""
    stamp_ns = NOW_NS - round(age_s * NS)
    position = tuple((axis.low + axis.high) / 2 for axis in driver.table)
    known: dict[str, tuple[float, ...]] = {
        "fsm": (801.0, NOW_S),
        "sport_mode_released": (1.0, NOW_S),
        "battery_pct": (80.0,),
        "battery_stamp_s": (NOW_S,),
    }
    for name, row in sensors.items():
        known.pop(name)
        if row is not None:
            known[name] = row
    return Observation(NOW_NS, position, (stamp_ns,) * len(position), (), known)


def state(driver: Driver, target: tuple[float, ...] = (), period_s: float = 0.002, **given: Any) -> GateState:
    seen = observation(driver, **given)
    return GateState(NOW_NS, seen, target or seen.position, NOW_NS, period_s > 0, period_s)


def verdict(driver: Driver, action: Any, at: GateState) -> Candidate | Refused:
    """Judge an action as the gate does: the conditions, the parser, the gates."""
    for condition in driver.conditions:
        refusal = condition.check(at.observation, at.now_ns)
        if refusal is not None:
            return refusal
    candidate = driver.parse(action, at)
    if isinstance(candidate, Candidate):
        for gate in driver.gates:
            refusal = gate(candidate, at)
            if refusal is not None:
                return refusal
    return candidate


def refused(driver: Driver, action: Any, at: GateState) -> Refused:
    answer = verdict(driver, action, at)
    assert isinstance(answer, Refused), answer
    assert answer.reason
    return answer


def here(driver: Driver, joint: str) -> float:
    return observation(driver).position[driver.axes.index(joint)]


# -- accepted commands


def test_a_number_is_a_position_with_the_joints_gains() -> None:
    driver = g1()
    at = state(driver)
    accepted = verdict(driver, {"left_knee": here(driver, "left_knee") + 0.01}, at)
    assert isinstance(accepted, Candidate)
    knee, count = driver.axes.index("left_knee"), 29
    assert accepted.values[knee + count * Q] == here(driver, "left_knee") + 0.01
    assert accepted.values[knee + count * KP] == 100.0
    assert accepted.values[knee + count * KD] == 2.0
    assert accepted.named == (knee,)
    # the others hold their position
    assert accepted.values[0] == at.observation.position[0]
    assert accepted.values[count * KP] == 60.0


def test_a_dict_sets_all_values_and_keeps_no_earlier_ones() -> None:
    driver = g1()
    first = verdict(
        driver, {"left_knee": {"q": here(driver, "left_knee"), "tau": 12.0, "kp": 150, "kd": 3.0}}, state(driver)
    )
    assert isinstance(first, Candidate)
    knee, count = driver.axes.index("left_knee"), 29
    row = [first.values[knee + count * at] for at in range(5)]
    assert row == [here(driver, "left_knee"), 0.0, 12.0, 150.0, 3.0]
    second = verdict(driver, {"left_knee": here(driver, "left_knee")}, state(driver, first.values))
    assert isinstance(second, Candidate)
    assert second.values[knee + count * TAU] == 0.0
    assert second.values[knee + count * KP] == 100.0


def test_joints_that_are_not_named_keep_their_target() -> None:
    driver = g1()
    first = verdict(driver, {"left_elbow": {"q": here(driver, "left_elbow"), "tau": 2.0}}, state(driver))
    assert isinstance(first, Candidate)
    second = verdict(driver, {"left_knee": here(driver, "left_knee")}, state(driver, first.values))
    assert isinstance(second, Candidate)
    elbow = driver.axes.index("left_elbow")
    assert second.values[elbow + 29 * TAU] == 2.0


@pytest.mark.parametrize("spelling", ["left_knee", "left_knee_joint", "left_knee.pos", "left_knee_joint.pos"])
def test_every_spelling_of_a_joint(spelling: str) -> None:
    driver = g1()
    accepted = verdict(driver, {spelling: here(driver, "left_knee")}, state(driver))
    assert isinstance(accepted, Candidate)
    assert driver.commanded({spelling: 0.0}, accepted.values)["joints"] == ["left_knee"]


def test_the_answer_of_send_action() -> None:
    driver = go2()
    accepted = verdict(driver, {"FL_hip_joint": here(driver, "FL_hip_joint")}, state(driver))
    assert isinstance(accepted, Candidate)
    assert driver.commanded({"FL_hip_joint": 0.0}, accepted.values) == {
        "topic": "rt/lowcmd",
        "joints": ["FL_hip_joint"],
        "slots": [3],
        "targets": {"FL_hip_joint": here(driver, "FL_hip_joint")},
        "unit": "radians",
    }


# -- names and numbers


@pytest.mark.parametrize(("action", "code", "words"), [
    ({}, "empty", "names no joint"),
    ({"knee": 0.0}, "unknown_joint", "knee is not a joint of unitree_g1"),
    ({"3": 0.0}, "unknown_joint", "3 is not a joint"),  # an index is no name
    ({"": 0.0}, "unknown_joint", "'' is not a joint"),
    ({"left_knee": 0.5, "left_knee_joint": 0.5}, "both_spellings", "left_knee and left_knee_joint are both given"),
    ({"left_knee": math.nan}, "not_finite", "left_knee.q is nan"),
    ({"left_knee": math.inf}, "not_finite", "left_knee.q is inf"),
    ({"left_knee": "up"}, "not_finite", "left_knee.q is up"),
    ({"left_knee": True}, "not_finite", "left_knee.q is True"),
    ({"left_knee": None}, "not_finite", "left_knee.q is None"),
    ({"left_knee": 10**400}, "not_finite", "left_knee.q is 1000"),
    ({"left_knee": {}}, "no_q", "left_knee has no q"),
    ({"left_knee": {"kp": 1.0}}, "no_q", "left_knee has no q"),
    ({"left_knee": {"q": 0.5, "torque": 1.0}}, "unknown_key", "left_knee.torque is not known"),
    ({"left_knee": {"q": 0.5, "tau": math.nan}}, "not_finite", "left_knee.tau is nan"),
    ({"left_knee": {"q": 0.5, "kd": "stiff"}}, "not_finite", "left_knee.kd is stiff"),
])  # fmt: skip
def test_saf_014_names_and_numbers(action: dict[str, Any], code: str, words: str) -> None:
    driver = g1()
    refusal = refused(driver, action, state(driver))
    assert refusal.code == code
    assert words in refusal.reason
    assert refusal.remedy


@given(st.dictionaries(st.text(max_size=8), st.one_of(st.none(), st.text(max_size=4), st.floats(), st.integers())))
def test_saf_014_no_action_breaks_the_parser(action: dict[str, Any]) -> None:
    driver = g1()
    assert isinstance(verdict(driver, action, state(driver)), Refused)


# -- of the robot


def whole(driver: Driver, **rows: float) -> dict[str, dict[str, float]]:
    """Return a command that holds every joint, with these rows added."""
    position = observation(driver).position
    return {axis: {"q": q, **rows} for axis, q in zip(driver.axes, position, strict=True)}


@pytest.mark.parametrize("rows", [{}, {"kp": 20.0}, {"kd": 1.0, "tau": 0.5, "dq": 0.1, "kp": 3.0}])
def test_an_action_for_all_joints_equals_one_joint_by_joint(rows: dict[str, float]) -> None:
    driver = go2()
    action = whole(driver, **rows)
    candidate = verdict(driver, action, state(driver))
    joint_by_joint = verdict(driver, dict(reversed(action.items())), state(driver))
    assert isinstance(candidate, Candidate) and isinstance(joint_by_joint, Candidate)
    assert candidate.values == joint_by_joint.values
    assert candidate.named == tuple(range(12))


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("row", ["q", "kp"])
def test_saf_014_a_number_in_rows_that_are_all_alike_is_refused_by_its_joint(row: str, number: float) -> None:
    driver = g1()
    action = whole(driver, kp=20.0)
    action["left_knee"][row] = number
    refusal = refused(driver, action, state(driver))
    assert (refusal.code, "left_knee" in refusal.reason) == ("not_finite", True)


def test_saf_014_finite_numbers_without_a_finite_sum_are_refused_by_value() -> None:
    refusal = refused(g1(), whole(g1(), kp=1e308), state(g1()))
    assert (refusal.code, "kp=1e+308" in refusal.reason) == ("gain", True)


@pytest.mark.parametrize(
    ("rows", "code", "words"),
    [({"pos": 1.0}, "unknown_key", "left_hip_pitch.pos"), ({"kp": True}, "not_finite", "left_hip_pitch.kp")],
)
def test_saf_014_rows_that_are_all_wrong_are_refused_by_the_first_joint(
    rows: dict[str, Any], code: str, words: str
) -> None:
    refusal = refused(g1(), whole(g1(), **rows), state(g1()))
    assert (refusal.code, words in refusal.text) == (code, True), refusal


def test_saf_014_rows_without_a_position_are_refused() -> None:
    action = {axis: {"kp": 1.0} for axis in g1().axes}
    refusal = refused(g1(), action, state(g1()))
    assert (refusal.code, "left_hip_pitch has no q" in refusal.text) == ("no_q", True), refusal


def test_saf_014_gains_are_looked_at_when_they_change() -> None:
    driver = g1()
    first = verdict(driver, whole(driver, kp=20.0, kd=1.0), state(driver))
    assert isinstance(first, Candidate)
    after = state(driver, first.values)
    assert isinstance(verdict(driver, whole(driver, kp=20.0, kd=1.0), after), Candidate)
    assert refused(driver, whole(driver, kp=201.0, kd=1.0), after).code == "gain"
    assert refused(driver, whole(driver, kp=20.0, kd=10.5), after).code == "gain"


@pytest.mark.parametrize(("age_s", "code"), [(0.09, None), (0.11, "stale")])
def test_saf_012_an_old_state_is_no_state(age_s: float, code: str | None) -> None:
    driver = g1()
    answer = verdict(driver, {"left_knee": here(driver, "left_knee")}, state(driver, age_s=age_s))
    assert (answer.code if isinstance(answer, Refused) else None) == code
    if isinstance(answer, Refused):
        assert answer.reason == "last LowState is 110 ms old (limit 100 ms)"


def test_saf_014_before_the_first_state() -> None:
    driver = g1()
    nothing = Observation(0, (math.nan,) * 29, (0,) * 29)
    refusal = refused(driver, {"left_knee": 0.0}, GateState(NOW_NS, nothing, nothing.position, 0, False))
    assert refusal.reason == "no LowState yet, mode_machine unknown"


@pytest.mark.parametrize(("fsm", "code", "words"), [
    ((500.0, NOW_S), None, ""),
    ((501.0, NOW_S), None, ""),
    ((801.0, NOW_S - 0.9), None, ""),
    ((1.0, NOW_S), "fsm", "FSM 1 (damp) does not accept low-level commands; needs 500, 501 or 801"),
    ((0.0, NOW_S), "fsm", "FSM 0 (zero torque) does not"),
    ((999.0, NOW_S), "fsm", "FSM 999 does not"),
    ((801.0, NOW_S - 1.3), "fsm_stale", "FSM id is 1.3 s old (limit 1.0 s)"),  # a stale id does not count
    (None, "fsm_unknown", "the FSM id is not known"),
])  # fmt: skip
def test_saf_014_the_g1_is_commanded_in_three_states(
    fsm: tuple[float, float] | None, code: str | None, words: str
) -> None:
    driver = g1()
    answer = verdict(driver, {"left_knee": here(driver, "left_knee")}, state(driver, fsm=fsm))
    assert (answer.code if isinstance(answer, Refused) else None) == code
    assert words in (answer.reason if isinstance(answer, Refused) else "")


@pytest.mark.parametrize("robot", Go2Driver.SUPPORTED_ROBOTS)
@pytest.mark.parametrize(("released", "code", "words"), [
    ((1.0, NOW_S), None, ""),
    ((0.0, NOW_S), "sport_mode", "the onboard sport mode 'normal' is still active"),
    ((1.0, NOW_S - 1.2), "sport_mode_stale", "the onboard mode is 1.2 s old (limit 1.0 s)"),
    (None, "sport_mode_unknown", "the onboard mode is not known"),
])  # fmt: skip
def test_saf_014_the_others_once_they_are_released(
    robot: str, released: tuple[float, float] | None, code: str | None, words: str
) -> None:
    driver = go2(robot)
    at = state(driver, sport_mode_released=released)
    if released and not released[0]:
        at = msgspec.structs.replace(
            at, observation=msgspec.structs.replace(at.observation, faults={"sport_mode": "'normal'"})
        )
    joint = driver.axes[0]
    answer = verdict(driver, {joint: here(driver, joint)}, at)
    assert (answer.code if isinstance(answer, Refused) else None) == code
    if isinstance(answer, Refused):
        assert words in answer.reason
        assert "release_sport_mode()" in answer.remedy or code == "sport_mode_stale"


def told(battery: tuple[float, float] | None) -> dict[str, tuple[float, ...] | None]:
    """Return the sensors for a charge in percent and the time of its report."""
    if battery is None:
        return {"battery_pct": None, "battery_stamp_s": None}
    return {"battery_pct": battery[:1], "battery_stamp_s": battery[1:]}


@pytest.mark.parametrize("make", [g1, go2])
@pytest.mark.parametrize(("battery", "code", "words"), [
    ((15.0, NOW_S), None, ""),
    ((14.9, NOW_S), "battery_low", "battery 14.9 % is below the minimum of 15.0 %"),
    ((12.0, NOW_S), "battery_low", "battery 12.0 % is below the minimum"),
    (None, "battery_unknown", "the battery's charge is not known"),
    ((80.0, NOW_S - 11.0), "battery_unknown", "the battery's charge is 11 s old"),
])  # fmt: skip
def test_saf_014_a_low_battery_and_an_unknown_one_are_two_refusals(
    make: Any, battery: tuple[float, float] | None, code: str | None, words: str
) -> None:
    driver = make()
    joint = driver.axes[0]
    answer = verdict(driver, {joint: here(driver, joint)}, state(driver, **told(battery)))
    assert (answer.code if isinstance(answer, Refused) else None) == code
    assert words in (answer.reason if isinstance(answer, Refused) else "")


@pytest.mark.parametrize("robot", ["unitree_g1", *Go2Driver.SUPPORTED_ROBOTS])
@pytest.mark.parametrize("row", [Q, DQ, TAU, KP, KD])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_saf_014_a_joint_that_is_not_named_never_gets_a_non_finite_number(
    robot: str, row: int, value: float
) -> None:
    """In every frame such a joint gets its reading, or the target that was accepted before."""
    driver = g1() if robot == "unitree_g1" else go2(robot)
    count = len(driver.axes)
    named, lost = driver.axes[:2]
    at = state(driver)
    before = verdict(driver, {named: here(driver, named)}, at)
    assert isinstance(before, Candidate)
    if row == Q:  # as reported by the robot after arming
        position = tuple(value if axis == lost else q for axis, q in zip(driver.axes, at.target, strict=True))
        at = msgspec.structs.replace(
            at, observation=msgspec.structs.replace(at.observation, position=position), target=position
        )
    else:
        kept = tuple(value if place == row * count + 1 else n for place, n in enumerate(before.values))
        at = state(driver, kept)
    refusal = refused(driver, {named: here(driver, named)}, at)
    assert (refusal.code, refusal.offered) == ("not_finite", str(value))
    assert f"{lost}.{ROWS[row]} is {value}" in refusal.reason


def test_the_floor_is_an_option() -> None:
    driver = g1(battery_floor_pct=50)
    refusal = refused(driver, {"left_knee": here(driver, "left_knee")}, state(driver, **told((40.0, NOW_S))))
    assert "below the minimum of 50.0 %" in refusal.reason


# -- of the command


@pytest.mark.parametrize(("part", "code", "words"), [
    ({"q": 3.1}, "past_travel", "left_knee 3.1000 rad is past 2.8798"),
    ({"q": -0.1}, "past_travel", "left_knee -0.1000 rad is past -0.0872"),
    ({"dq": 20.1}, "too_fast", "left_knee.dq=20.1 is outside -20..20 rad/s"),
    ({"dq": -20.1}, "too_fast", "left_knee.dq=-20.1 is outside"),
    ({"tau": 139.5}, "too_strong", "left_knee.tau=139.5 is outside -139..139 Nm"),
    ({"tau": -139.5}, "too_strong", "left_knee.tau=-139.5 is outside"),
    ({"kp": 201.0}, "gain", "left_knee.kp=201 is outside 0..200"),
    ({"kp": -1.0}, "gain", "left_knee.kp=-1 is outside"),
    ({"kd": 10.5}, "gain", "left_knee.kd=10.5 is outside 0..10"),
    ({"kd": -0.1}, "gain", "left_knee.kd=-0.1 is outside"),
])  # fmt: skip
def test_saf_014_limits_of_a_joint(part: dict[str, float], code: str, words: str) -> None:
    driver = g1()
    action = {"left_knee": {"q": here(driver, "left_knee"), **part}}
    refusal = refused(driver, action, state(driver))
    assert refusal.code == code
    assert words in refusal.reason


@pytest.mark.parametrize("part", [
    {"dq": 20.0}, {"dq": -20.0}, {"tau": 139.0}, {"tau": -139.0}, {"kp": 200.0}, {"kp": 0.0}, {"kd": 10.0},
])  # fmt: skip
def test_a_limit_itself_is_allowed(part: dict[str, float]) -> None:
    driver = g1()
    action = {"left_knee": {"q": here(driver, "left_knee"), **part}}
    assert isinstance(verdict(driver, action, state(driver)), Candidate)


@pytest.mark.parametrize(("period_s", "reach_s"), [(0.002, 0.002), (0.02, 0.02), (1.0, 0.1), (0.0, CONTROL_S)])
def test_saf_011_no_joint_jumps(period_s: float, reach_s: float) -> None:
    """A stream steps as far as the joint turns in its period. A single command steps as far as in one control
    period."""
    driver = g1()
    knee = driver.axes.index("left_knee")
    target = [0.0] * (29 * 5)  # an earlier target: the knee is straight
    at = state(driver, tuple(target), period_s=period_s)
    allowed = 20.0 * reach_s * 1.2
    assert isinstance(verdict(driver, {"left_knee": 0.999 * allowed}, at), Candidate)
    refusal = refused(driver, {"left_knee": 1.001 * allowed}, at)
    assert refusal.code == "too_fast"
    assert "left_knee steps" in refusal.reason
    assert at.target[knee] == 0.0


def test_saf_011_the_first_step_starts_where_the_joint_is_now() -> None:
    """The position at arming does not count: the robot may have walked since."""
    driver = g1()
    at = state(driver)
    armed_at = (0.0,) * 29
    walked = msgspec.structs.replace(at, target=armed_at)
    assert isinstance(verdict(driver, {"left_knee": here(driver, "left_knee")}, walked), Candidate)
    assert refused(driver, {"left_knee": 0.0}, walked).code == "too_fast"


def test_the_joints_of_every_robot_are_limited() -> None:
    for robot in Go2Driver.SUPPORTED_ROBOTS:
        driver = go2(robot)
        for joint in driver.table:
            for past in (joint.low - 0.01, joint.high + 0.01):
                at = state(driver)
                assert refused(driver, {joint.key: past}, at).code == "past_travel", joint.key


def test_a_policy_may_return_the_observed_position_of_a_joint_at_its_stop() -> None:
    """The values are in float32 and with sensor noise. A joint that rests on its stop is often measured past it."""
    driver = g1()
    for joint in driver.table:
        at_stop = state(driver)
        where = driver.axes.index(joint.key)
        for end, outwards in ((joint.low, -1.0), (joint.high, 1.0)):
            for observed, measured in ((3e-6, 0.0), (2e-4, 2e-6), (0.01, 0.01), (0.02, 0.0199)):
                row = list(at_stop.observation.position)
                row[where] = end + outwards * measured
                seen = msgspec.structs.replace(at_stop.observation, position=tuple(row))
                now = msgspec.structs.replace(at_stop, observation=seen, target=tuple(row))
                answer = verdict(driver, {joint.key: end + outwards * observed}, now)
                assert isinstance(answer, Candidate), (joint.key, answer)
                further = refused(driver, {joint.key: end + outwards * (measured + 0.03)}, now)
                assert further.code == "past_travel", joint.key


# -- the driver


def test_every_end_is_zero_torque_unless_the_user_chose_to_damp() -> None:
    assert set(g1().fallbacks.values()) == {"zero_torque"}
    assert set(g1(on_exit="damp").fallbacks.values()) == {"damp"}
    assert set(g1().fallbacks) == set(Reason)
    assert not g1().energised("damp")


@pytest.mark.parametrize(("options", "words"), [
    ({"on_exit": "hold"}, "on_exit is 'hold'. .* one of 'zero_torque', 'damp'"),
    ({"battery_floor_pct": 101}, "battery_floor_pct is 101. .* 0 to 100"),
    ({"battery_floor_pct": True}, "battery_floor_pct is True"),
    ({"domain": 233}, "domain is 233. .* 0 to 232"),
    ({"domain": "x"}, "domain is 'x'"),
    ({"network_interface": 3}, "network_interface is 3"),
])  # fmt: skip
def test_options_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        G1Driver.resolve("unitree_g1", options)


def test_an_unknown_option_is_refused() -> None:
    with pytest.raises(TypeError, match="unknown option gait"):
        G1Driver.resolve("unitree_g1", {"gait": "trot"})


def test_only_the_others_release_a_sport_mode() -> None:
    refusal = g1().check_service("release_sport_mode", {})
    assert refusal is not None and refusal.code == "unknown_service"
    assert go2().check_service("release_sport_mode", {}) is None
    assert go2().check_service("release_sport_mode", {"attempts": 3.0}) is None


@pytest.mark.parametrize(("arguments", "code"), [
    ({"attempts": 0}, "bad_argument"),
    ({"attempts": 6}, "bad_argument"),
    ({"attempts": 1.5}, "bad_argument"),
    ({"attempts": True}, "bad_argument"),
    ({"attempts": math.nan}, "bad_argument"),
    ({"attempts": "5"}, "bad_argument"),
    ({"tries": 5}, "unknown_argument"),
])  # fmt: skip
def test_saf_014_arguments_of_the_verb(arguments: dict[str, Any], code: str) -> None:
    refusal = go2().check_service("release_sport_mode", arguments)
    assert refusal is not None and refusal.code == code
