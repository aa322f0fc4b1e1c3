"""Behaviours of a UR arm that the tests of strands-robots require, tested on one twin through the public
names.
"""

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
    for _ in range(3):  # the machine may be busy
        if (problem := arm.connect_eagerly()) is None:
            break
    assert problem is None
    yield arm
    arm.cleanup()
    arm.cleanup()
    assert not arm.is_connected


def elbow(arm: RealRobot) -> float:
    return float(arm.get_observation()[ELBOW])


def test_state_and_status_describe_the_arm(bench: RealRobot, twin_ur5e: Twin) -> None:
    assert bench.connect_eagerly() is None and bench.is_connected
    reading = json_of(bench.state())
    assert set(reading["joints"]) == set(reading["joint_velocities"]) == set(JOINTS)
    assert len(reading["tcp_pose"]) == len(reading["wrench"]) == 6
    assert (reading["robot_mode"], reading["safety_mode"]) == ("RUNNING", "NORMAL")  # scripts compare these
    reported = status(bench)
    assert (reported["connected"], reported["model"], reported["robot_mode"]) == (True, "ur5e", "RUNNING")
    assert reported["host"] == twin_ur5e.port.rpartition(":")[0]  # without RTDE's port
    assert set(bench.get_observation()) == set(JOINTS)
    assert set(json_of(ask(bench, action="state"))["positions"]) == set(JOINTS)


@pytest.mark.parametrize("key", [ELBOW, f"{ELBOW}.pos"])
def test_a_step_within_the_period_is_written(bench: RealRobot, key: str) -> None:
    to = elbow(bench) + 0.005
    sent = json_of(bench.send_action({key: to}))
    assert (sent["robot"], sent["joints"], sent["control_period"]) == ("ur5e", [ELBOW], PERIOD_S)
    assert sent["targets"] == {ELBOW: pytest.approx(to)}


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({ELBOW: 9.0}, "past 3.14"),
        ({}, "names no joint"),
        ([ELBOW], "a mapping of joints to numbers"),
        ({"elbow": 1.5}, "elbow is not a joint"),
        ({ELBOW: float("nan")}, "elbow_joint is nan"),
        ({ELBOW: "up"}, "elbow_joint is up"),
        ({ELBOW: True}, "elbow_joint is True"),
        ({ELBOW: None}, "elbow_joint is None"),
    ],
)
def test_an_invalid_action_is_refused(bench: RealRobot, action: Any, says: str) -> None:
    assert says in why(bench.send_action(action))


def test_an_action_for_another_robot_is_refused(bench: RealRobot) -> None:
    assert "ur10e" in why(bench.send_action({ELBOW: elbow(bench)}, robot_name="ur10e"))


def test_each_step_of_a_stream_is_limited_from_the_last_commanded_position(bench: RealRobot) -> None:
    """An arm that lags behind its stream loses no step, and a step that is too long is refused."""
    start = elbow(bench)
    for step in range(1, 11):
        json_of(bench.send_action({ELBOW: start - 0.02 * step}))
        time.sleep(PERIOD_S)
    assert STEP_RAD < 0.02 * 10  # from the measured position the step would be too far
    assert "Step at most" in why(bench.send_action({ELBOW: start - 1.2}))
    json_of(bench.send_action({ELBOW: start - 0.21}))  # the refused step does not end the stream
    until(lambda: abs(elbow(bench) - start + 0.21) < 0.002, "the elbow is there")


class Chunked:
    """A policy with ``get_actions_sync``."""

    instruction = ""

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        self.instruction = instruction
        return [{ELBOW: observation[ELBOW]}]


class Stepped:
    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        return {ELBOW: observation[ELBOW]}


def does_three_steps(arm: RealRobot, policy: Any) -> bool:
    """Run three steps. On a busy machine a late step may end the rollout in a hold."""
    json_of(arm.run_policy(policy, instruction="lift", n_steps=3))
    ended = task_ended(arm)
    return (ended["exit_reason"], ended["steps"]) == ("n_steps", 3)


def test_every_form_of_policy_runs_its_steps(bench: RealRobot) -> None:
    chunked = Chunked()
    for policy in (chunked, Stepped(), hold):
        until(lambda policy=policy: does_three_steps(bench, policy), "the rollout does its three steps")
    assert chunked.instruction == "lift"
    assert "get_actions_sync" in why(bench.run_policy(object()))


@pytest.mark.parametrize(
    ("policy", "reason", "says"),
    [
        (lambda seen: {ELBOW: seen[ELBOW] - 1.0}, "gate", "Step at most"),
        (lambda seen: None, "policy", "not an action"),
        (lambda seen: 1 / 0, "policy", "division by zero"),
    ],
)
def test_a_rollout_with_a_refused_action_or_an_exception_ends_with_the_reason(
    bench: RealRobot, policy: Any, reason: str, says: str
) -> None:
    json_of(bench.run_policy(policy, n_steps=5))
    ended = task_ended(bench)
    assert ended["exit_reason"] == reason and says in ended["exit_detail"], ended


def test_a_rollout_is_stopped_and_the_next_command_starts_at_the_arms_position(bench: RealRobot) -> None:
    json_of(bench.run_policy(hold, duration=30.0))
    assert "already running" in why(bench.run_policy(hold))
    until(lambda: task(bench)["steps"] > 1, "the policy runs")
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
def test_a_stop_by_the_controller_refuses_the_next_step_with_its_name(
    bench: RealRobot, twin_ur5e: Twin, order: str, back: str, field: str, word: str
) -> None:
    twin_ur5e.order(order)
    try:
        until(lambda: status(bench)[field] == word, "the status shows it")
        assert bench.send_action({ELBOW: elbow(bench)})["status"] == "error"
    finally:
        twin_ur5e.order(back)
    until(lambda: status(bench)[field] in ("NORMAL", "RUNNING"), "the status is normal again")

    def moves_again() -> bool:
        bench.stop()  # a stop also ends a program that the controller has interrupted
        bench.resume()
        return bench.send_action({ELBOW: elbow(bench)})["status"] == "success"

    until(moves_again, "the arm moves again")


def test_an_agents_verbs_are_those_of_the_schema(bench: RealRobot) -> None:
    verbs = bench.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["state", "status", "get_pose", "move_to", "stop"]
    assert "needs an operator's approval" in why(ask(bench, action="move_to", targets={ELBOW: 1.0}))
    for other in ("home", "move", ""):
        refusal = why(ask(bench, action=other))
        assert repr(other) in refusal and ", ".join(verbs) in refusal
    assert json_of(ask(bench, action="stop"))["unconfirmed"] == []
    assert "resume() first" in why(bench.send_action({ELBOW: elbow(bench)}))
    resumed(bench)


def test_connecting_to_a_stopped_or_missing_controller_gives_the_reason(bench: RealRobot, twin_ur5e: Twin) -> None:
    """This is the last test of the file, because it closes the connection of ``bench``."""
    bench.cleanup()
    for order, back, word in (
        ("safety PROTECTIVE_STOP", "safety NORMAL", "PROTECTIVE_STOP"),
        ("mode POWER_OFF", "mode RUNNING", "POWER_OFF"),
    ):
        twin_ur5e.order(order)
        arm = Robot("ur5e", mode="real", port=twin_ur5e.port)
        try:
            until(lambda arm=arm, word=word: word in (arm.connect_eagerly() or ""), "connect gives the reason")
        finally:
            arm.cleanup()
        twin_ur5e.order(back)
    missing = Robot("ur5e", mode="real", port="127.0.0.77")
    try:
        assert "127.0.0.77" in (missing.connect_eagerly() or "")
        assert not missing.is_connected
    finally:
        missing.cleanup()
