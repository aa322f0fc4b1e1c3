"""What the tests of strands-robots assert of a UR arm, as behaviours of ours: on one twin, through
the public names."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.ur.arms import JOINTS
from strands_actors.testing import Twin
from tests.answers import json_of, resumed, status, task, task_ended, until, why

from .test_reference_feetech import ask, hold

ELBOW = "elbow_joint"
PERIOD_S = 0.02
STEP_RAD = 3.14159 * PERIOD_S


@pytest.fixture(scope="module")
def twin_ur5e(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("ur5e", tmp_path_factory.mktemp("ur5e")) as twin:
        yield twin


@pytest.fixture(scope="module")
def bench(twin_ur5e: Twin) -> Iterator[RealRobot]:
    arm = Robot("ur5e", mode="real", port=twin_ur5e.port, control_frequency=1 / PERIOD_S)
    assert "not connected" in why(arm.state()) and dict(arm.get_observation()) == {}
    assert "not connected" in why(arm.stop_task())
    assert not task(arm)["running"]
    for _ in range(3):  # a busy machine
        if (problem := arm.connect_eagerly()) is None:
            break
    assert problem is None
    yield arm
    arm.cleanup()
    arm.cleanup()
    assert not arm.is_connected


def elbow(arm: RealRobot) -> float:
    return float(arm.get_observation()[ELBOW])


def test_what_it_tells_of_itself(bench: RealRobot, twin_ur5e: Twin) -> None:
    assert bench.connect_eagerly() is None and bench.is_connected
    told = json_of(bench.state())
    assert set(told["joints"]) == set(told["joint_velocities"]) == set(JOINTS)
    assert len(told["tcp_pose"]) == len(told["wrench"]) == 6
    assert (told["robot_mode"], told["safety_mode"]) == ("RUNNING", "NORMAL")  # compared by scripts
    said = status(bench)
    assert (said["connected"], said["model"], said["robot_mode"]) == (True, "ur5e", "RUNNING")
    assert said["host"] == twin_ur5e.port.rpartition(":")[0]  # with RTDE's port left out
    assert set(bench.get_observation()) == set(JOINTS)
    assert set(json_of(ask(bench, action="state"))["positions"]) == set(JOINTS)


@pytest.mark.parametrize("key", [ELBOW, f"{ELBOW}.pos"])
def test_a_step_within_the_period_is_written(bench: RealRobot, key: str) -> None:
    to = elbow(bench) + 0.005
    told = json_of(bench.send_action({key: to}))
    assert (told["robot"], told["joints"], told["control_period"]) == ("ur5e", [ELBOW], PERIOD_S)
    assert told["targets"] == {ELBOW: pytest.approx(to)}


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({ELBOW: 9.0}, "past 3.14"),
        ({}, "names no joint"),
        ([ELBOW], "must be a mapping"),
        ({"elbow": 1.5}, "elbow is not a joint"),
        ({ELBOW: float("nan")}, "elbow_joint is nan"),
        ({ELBOW: "up"}, "elbow_joint is up"),
        ({ELBOW: True}, "elbow_joint is True"),
        ({ELBOW: None}, "elbow_joint is None"),
    ],
)
def test_what_it_cannot_honour_is_refused(bench: RealRobot, action: Any, says: str) -> None:
    assert says in why(bench.send_action(action))


def test_another_robots_action_is_not_applied(bench: RealRobot) -> None:
    assert "ur10e" in why(bench.send_action({ELBOW: elbow(bench)}, robot_name="ur10e"))


def test_a_stream_is_measured_from_what_was_commanded_and_each_step_by_the_ceiling(bench: RealRobot) -> None:
    """An arm that lags behind its stream loses no step of it; and no step is too long."""
    start = elbow(bench)
    for step in range(1, 11):
        json_of(bench.send_action({ELBOW: start - 0.02 * step}))
        time.sleep(PERIOD_S)
    assert STEP_RAD < 0.02 * 10  # from where it was measured it would be too far
    assert "step at most" in why(bench.send_action({ELBOW: start - 1.2}))
    json_of(bench.send_action({ELBOW: start - 0.21}))  # a refused one does not end the stream
    until(lambda: abs(elbow(bench) - start + 0.21) < 0.002, "it is there")


class Chunked:
    """A policy by its usual method."""

    instruction = ""

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self.instruction = instruction
        return [{ELBOW: observation[ELBOW]}]


class Stepped:
    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        return {ELBOW: observation[ELBOW]}


def does_three_steps(arm: RealRobot, policy: Any) -> bool:
    """On a busy machine a step may be late, and a rollout is held for it."""
    json_of(arm.run_policy(policy, instruction="lift", n_steps=3))
    ended = task_ended(arm)
    return (ended["exit_reason"], ended["steps"]) == ("n_steps", 3)


def test_every_shape_of_a_policy_runs_its_steps(bench: RealRobot) -> None:
    chunked = Chunked()
    for policy in (chunked, Stepped(), hold):
        until(lambda policy=policy: does_three_steps(bench, policy), "it does its three steps")
    assert chunked.instruction == "lift"
    assert "get_actions_sync" in why(bench.run_policy(object()))


@pytest.mark.parametrize(
    ("policy", "reason", "says"),
    [
        (lambda seen: {ELBOW: seen[ELBOW] - 1.0}, "gate", "step at most"),
        (lambda seen: None, "policy", "not an action"),
        (lambda seen: 1 / 0, "policy", "division by zero"),
    ],
)
def test_a_rollout_that_cannot_go_on_ends_with_the_reason(
    bench: RealRobot, policy: Any, reason: str, says: str
) -> None:
    json_of(bench.run_policy(policy, n_steps=5))
    ended = task_ended(bench)
    assert ended["exit_reason"] == reason and says in ended["exit_detail"], ended


def test_a_rollout_is_halted_and_the_next_begins_where_the_arm_is(bench: RealRobot) -> None:
    json_of(bench.run_policy(hold, duration=30.0))
    assert "already running" in why(bench.run_policy(hold))
    until(lambda: task(bench)["steps"] > 1, "it goes")
    halted = json_of(bench.stop_task())
    assert (halted["stopped"], halted["robot"]) == (True, "ur5e") and halted["steps"] > 1
    json_of(bench.send_action({ELBOW: elbow(bench)}))
    assert "not_a_provider" in why(bench.start_task("lift", policy_provider="not_a_provider"))


@pytest.mark.parametrize(
    ("order", "back", "field", "word"),
    [
        ("safety SAFEGUARD_STOP", "safety NORMAL", "safety_mode", "SAFEGUARD_STOP"),
        ("safety PROTECTIVE_STOP", "safety NORMAL", "safety_mode", "PROTECTIVE_STOP"),
        ("mode POWER_OFF", "mode RUNNING", "robot_mode", "POWER_OFF"),
    ],
)
def test_a_stop_of_the_controllers_own_refuses_the_next_step_by_name(
    bench: RealRobot, twin_ur5e: Twin, order: str, back: str, field: str, word: str
) -> None:
    twin_ur5e.order(order)
    try:
        until(lambda: status(bench)[field] == word, "it is read")
        assert bench.send_action({ELBOW: elbow(bench)})["status"] == "error"
    finally:
        twin_ur5e.order(back)
    until(lambda: status(bench)[field] in ("NORMAL", "RUNNING"), "it is read again")

    def moves_again() -> bool:
        bench.stop()  # which ends a program that the controller has ended
        bench.resume()
        return bench.send_action({ELBOW: elbow(bench)})["status"] == "success"

    until(moves_again, "it moves again")


def test_an_agents_verbs_are_those_of_the_schema(bench: RealRobot) -> None:
    verbs = bench.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["state", "status", "move_to", "stop"]
    assert "needs an operator's approval" in why(ask(bench, action="move_to", targets={ELBOW: 1.0}))
    for other in ("home", "move", ""):
        said = why(ask(bench, action=other))
        assert repr(other) in said and ", ".join(verbs) in said
    assert json_of(ask(bench, action="stop"))["unconfirmed"] == []
    assert "resume() first" in why(bench.send_action({ELBOW: elbow(bench)}))
    resumed(bench)


def test_a_controller_that_may_not_move_or_is_not_there_is_named_when_connecting(
    bench: RealRobot, twin_ur5e: Twin
) -> None:
    """Last: its robot has left the controller by then."""
    bench.cleanup()
    for order, back, word in (
        ("safety PROTECTIVE_STOP", "safety NORMAL", "PROTECTIVE_STOP"),
        ("mode POWER_OFF", "mode RUNNING", "POWER_OFF"),
    ):
        twin_ur5e.order(order)
        arm = Robot("ur5e", mode="real", port=twin_ur5e.port)
        try:
            until(lambda arm=arm, word=word: word in (arm.connect_eagerly() or ""), "it is said")
        finally:
            arm.cleanup()
        twin_ur5e.order(back)
    nobody = Robot("ur5e", mode="real", port="127.0.0.77")
    try:
        assert "127.0.0.77" in (nobody.connect_eagerly() or "")
        assert not nobody.is_connected
    finally:
        nobody.cleanup()
