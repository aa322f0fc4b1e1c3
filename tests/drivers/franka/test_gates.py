"""Test which commands are refused: each gate and condition with its code, offered value and limit."""

from __future__ import annotations

import math
from collections.abc import Mapping

import pytest

from strands_actors.contract.driver import Candidate, GateState, Reason
from strands_actors.contract.wire import Observation
from strands_actors.drivers.franka.arms import HOME_RAD, arms
from strands_actors.drivers.franka.driver import Franka
from strands_actors.drivers.franka.gates import LOST, REASONS
from strands_actors.drivers.franka.protocol import RobotMode
from strands_actors.kernel.messages import Refused

NOW = 10**12
HOME = tuple(HOME_RAD)


def seen(
    mode: int = RobotMode.IDLE, rate: float = 0.0, age_s: float = 0.0, faults: Mapping[str, str] | None = None
) -> Observation:
    stamp = NOW - round(age_s * 1e9)
    sensors = {"robot_mode": (float(mode),), "success_rate": (rate,)}
    return Observation(stamp, HOME, (stamp,) * 7, sensors=sensors, faults=dict(faults or {}))


def ask(
    driver: Franka, action: Mapping[str, object], observation: Observation | None = None
) -> Candidate | Refused:
    """Judge an action as the gate does."""
    observation = observation or seen()
    for condition in driver.conditions:
        refusal = condition.check(observation, NOW)
        if refusal is not None:
            return refusal
    state = GateState(NOW, observation, HOME, NOW, False)
    candidate = driver.parse(action, state)  # type: ignore[arg-type]  # what others send is anything
    if isinstance(candidate, Refused):
        return candidate
    return next((no for gate in driver.gates if (no := gate(candidate, state)) is not None), candidate)


def refused(driver: Franka, action: Mapping[str, object], observation: Observation | None = None) -> Refused:
    answer = ask(driver, action, observation)
    assert isinstance(answer, Refused), answer
    return answer


def home(driver: Franka) -> dict[str, object]:
    return dict(zip(driver.axes, HOME, strict=True))


@pytest.fixture(params=arms())
def driver(request: pytest.FixtureRequest) -> Franka:
    return Franka(request.param, "192.0.2.1", {})


def test_keys_are_those_of_the_arm() -> None:
    keys = {robot: Franka(robot, "", {}).axes for robot in arms()}
    assert keys["panda"] == tuple(f"joint{number}" for number in range(1, 8))
    assert keys["fr3"] == tuple(f"fr3_joint{number}" for number in range(1, 8))
    assert keys["fr3_v2"] == tuple(f"fr3v2_joint{number}" for number in range(1, 8))


def test_all_seven_joints_are_accepted_by_either_spelling(driver: Franka) -> None:
    assert ask(driver, home(driver)) == Candidate(HOME, tuple(range(7)))
    spelt = {f"{key}.pos": value for key, value in home(driver).items()}
    assert ask(driver, spelt) == Candidate(HOME, tuple(range(7)))


def test_saf_014_less_than_all_joints(driver: Franka) -> None:
    action = home(driver)
    del action[driver.axes[3]]
    answer = refused(driver, action)
    assert answer.code == "not_all_joints"
    assert f"{driver.axes[3]} missing" in answer.text
    assert answer.limit == "7 joints"
    assert refused(driver, {driver.axes[0]: 0.0}).code == "not_all_joints"


def test_saf_014_a_joint_of_another_arm(driver: Franka) -> None:
    stranger = "joint1" if driver.robot != "panda" else "fr3_joint1"
    answer = refused(driver, {**home(driver), stranger: 0.0})
    assert (answer.code, answer.offered) == ("unknown_joint", stranger)


@pytest.mark.parametrize("value", [math.nan, math.inf, "0.1", None, True])
def test_saf_014_a_value_that_is_no_number(driver: Franka, value: object) -> None:
    assert refused(driver, {**home(driver), driver.axes[2]: value}).code == "not_finite"


def test_saf_014_past_the_range_of_each_joint(driver: Franka) -> None:
    for at, axis in enumerate(driver.axes):
        low, high = driver.limits.low[at], driver.limits.high[at]
        for inside in (low, high):
            assert isinstance(ask(driver, {**home(driver), axis: inside}), Candidate)
        for outside in (low - 1e-3, high + 1e-3):
            answer = refused(driver, {**home(driver), axis: outside})
            assert answer.code == "past_travel"
            assert axis in answer.text


def test_the_range_is_never_wider_than_the_arms(driver: Franka) -> None:
    pairs = zip(driver.limits.low, driver.limits.high, driver.arm.low, driver.arm.high, strict=True)
    for low, high, least, most in pairs:
        assert least <= low < high <= most
        assert low - least < 0.02 and most - high < 0.02


@pytest.mark.parametrize(
    ("mode", "name", "remedy"),
    [
        (RobotMode.REFLEX, "reflex", "recover() first"),
        (RobotMode.USER_STOPPED, "user_stopped", "release the stop button"),
        (RobotMode.GUIDING, "guiding", "let go"),
        (RobotMode.OTHER, "other", "Desk"),
        (RobotMode.RECOVERY, "recovery", "wait"),
    ],
)
def test_saf_014_a_mode_in_which_it_may_not_move(mode: RobotMode, name: str, remedy: str) -> None:
    driver = Franka("panda", "", {})
    answer = refused(driver, home(driver), seen(mode, faults={REASONS: "joint_reflex"}))
    assert answer.code == "robot_mode"
    assert f"arm is in {name} (joint_reflex)" in answer.text
    assert remedy in answer.remedy
    assert driver.conditions[0].reason is Reason.FAULT


def test_a_motion_that_the_controller_ended_is_named_until_it_is_armed_again() -> None:
    driver = Franka("panda", "", {})
    answer = refused(driver, home(driver), seen(faults={LOST: "reflex_aborted"}))
    assert (answer.code, answer.offered) == ("motion_ended", "reflex_aborted")


def test_saf_012_an_old_state() -> None:
    driver = Franka("panda", "", {})
    assert isinstance(ask(driver, home(driver), seen(age_s=0.1)), Candidate)
    assert refused(driver, home(driver), seen(age_s=0.2)).code == "stale"


def test_too_few_commands_that_arrive() -> None:
    driver = Franka("fr3", "", {})
    assert isinstance(ask(driver, home(driver), seen(RobotMode.MOVE, 0.5)), Candidate)
    answer = refused(driver, home(driver), seen(RobotMode.MOVE, 0.49))
    assert (answer.code, answer.offered) == ("success_rate", "0.49")
    assert isinstance(ask(driver, home(driver), seen(RobotMode.IDLE, 0.0)), Candidate), (
        "without a motion the success rate is 0"
    )


@pytest.mark.parametrize("factor", [0.0, -0.1, 1.01, math.nan, "fast", True])
def test_an_invalid_speed_factor(factor: object) -> None:
    with pytest.raises(ValueError, match="speed_factor"):
        Franka.resolve("panda", {"speed_factor": factor})


@pytest.mark.parametrize("rate", [0, 9.9, 201, math.inf])
def test_an_invalid_stream_rate(rate: object) -> None:
    with pytest.raises(ValueError, match="stream_rate_hz"):
        Franka.resolve("panda", {"stream_rate_hz": rate})


def test_an_unknown_option_is_refused_with_the_nearest() -> None:
    with pytest.raises(TypeError, match=r"speed_facto.*speed_factor"):
        Franka.resolve("panda", {"speed_facto": 0.5})


def test_the_stride_follows_from_the_stream_rate() -> None:
    assert Franka("panda", "", {}).config.stride == 33
    fast = Franka("panda", "", {"stream_rate_hz": 100.0})
    assert (fast.config.stride, fast.timing.control_hz) == (10, 100.0)


@pytest.mark.parametrize(
    ("port", "fits"), [("192.0.2.1", True), ("192.0.2.1:1337", True), ("192.0.2.1:1338", False)]
)
def test_the_port_is_fixed(port: str, fits: bool) -> None:
    driver = Franka("panda", port, {})
    if fits:
        assert driver.config.host == "192.0.2.1"
    else:
        with pytest.raises(ValueError, match="its port is 1337"):
            _ = driver.config.host
