"""Behaviours of an SO arm that the tests of strands-robots require, tested on one twin through the public
names.
"""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Iterator, Mapping
from typing import Any

import numpy
import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.testing import Twin
from tests.answers import json_of, status, task, task_ended, until, why
from tests.trees import connected

from .helpers import IDS, goals

NAN = float("nan")
DEGREES = "degrees (gripper: percent open)"


@pytest.fixture(scope="module")
def bench(twin_process: Twin) -> Iterator[RealRobot]:
    """Connect once for all tests of this file. Each test leaves the arm armed and at rest."""
    os.truncate(twin_process.log.path, 0)
    arm = Robot("so101", mode="real", port=twin_process.port)
    connected(arm)
    yield arm
    arm.cleanup()
    arm.cleanup()  # a second cleanup does nothing
    assert (arm.is_connected, dict(arm.get_observation())) == (False, {})


def ask(robot: Any, **given: Any) -> Mapping[str, Any]:
    """Use the robot as an agent's runtime does: one call, one result of that call."""

    async def use() -> list[Mapping[str, Any]]:
        call = {"name": robot.tool_name, "toolUseId": "use-7", "input": given}
        return [event async for event in robot.stream(call, {})]

    (answer,) = asyncio.run(use())
    assert answer["toolUseId"] == "use-7"
    return answer


def hold(observation: Mapping[str, float]) -> dict[str, float]:
    return dict(observation)


def test_connecting_again_does_nothing_and_status_names_the_robot(bench: RealRobot) -> None:
    assert bench.connect_eagerly() is None and bench.is_connected
    assert (bench.tool_name, bench.tool_type, bench.robot_name) == ("so101", "robot", "so101")
    reported = status(bench)
    assert (reported["tool_name"], reported["connected"], reported["baud"]) == ("so101", True, 1_000_000)
    assert reported["motors"] == IDS and reported["port"]
    assert reported["calibration_source"].startswith("none") and "not calibrated" in reported["caveats"][0]
    assert "content" not in json_of(ask(bench, action="status"))


@pytest.mark.parametrize(
    ("action", "commanded"),
    [
        ({"shoulder_pan": 5.0, "gripper": 60.0}, {"shoulder_pan": 5.0, "gripper": 60.0}),
        ({"shoulder_pan.pos": 0.0}, {"shoulder_pan": 0.0}),
        ({"gripper": numpy.float32(50)}, {"gripper": 50.0}),
        ({"gripper": numpy.int64(50)}, {"gripper": 50.0}),
        ({"gripper": 50}, {"gripper": 50.0}),
    ],
)
def test_the_answer_to_a_command_has_the_commanded_values_and_the_unit(
    bench: RealRobot, action: dict[str, Any], commanded: dict[str, float]
) -> None:
    assert json_of(bench.send_action(action)) == {"commanded": commanded, "unit": DEGREES}


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({}, "names no joint"),
        (None, "a mapping of joints to numbers"),
        ([("gripper", 1.0)], "a mapping of joints to numbers"),
        ({"shoulder_lift": 400.0}, "past 100.0"),
        ({"gripper": 101.0}, "past 100.0"),
        ({"shoulder_pan": 1.0, "nope": 0.0}, "nope is not a joint"),
        ({"gripper": NAN}, "gripper is nan"),
        ({"gripper": float("inf")}, "gripper is inf"),
        ({"gripper": None}, "gripper is None"),
        ({"gripper": [1.0]}, "finite number"),
        ({"gripper": True}, "gripper is True"),
        ({"gripper": "wide"}, "finite number"),
        ({"shoulder_pan": 1.0, "shoulder_pan.pos": 2.0}, "shoulder_pan and shoulder_pan.pos are both given"),
    ],
)
def test_an_invalid_action_is_refused_as_a_whole(
    bench: RealRobot, twin_process: Twin, action: Any, says: str
) -> None:
    json_of(bench.send_action({"shoulder_pan": 0.0}))
    last_goals = goals(until(lambda: twin_process.log.host("setpoint"), "the setpoint is written")[-1])
    since_ns = time.monotonic_ns()
    assert says in why(bench.send_action(action))
    assert all(goals(entry) == last_goals for entry in twin_process.log.host("setpoint", since_ns))


def test_an_observation_can_be_sent_back_unchanged(bench: RealRobot) -> None:
    read = bench.get_observation()
    assert json_of(bench.send_action(read))["commanded"] == read


@pytest.mark.parametrize(
    ("keywords", "says"),
    [
        ({"duration": 0.0}, "duration is 0.0"),
        ({"duration": NAN}, "duration is nan"),
        ({"duration": float("inf")}, "duration is inf"),
        ({"duration": -1.0}, "duration is -1.0"),
        ({"duration": "3"}, "duration is '3'"),
        ({"control_frequency": 0.0}, "control_frequency is 0.0"),
        ({"control_frequency": -30.0}, "control_frequency is -30.0"),
        ({"n_steps": 0}, "n_steps is 0"),
        ({"n_steps": -1}, "n_steps is -1"),
        ({"n_steps": 2.5}, "n_steps is 2.5"),
        ({"n_steps": True}, "n_steps is True"),
    ],
)
def test_an_invalid_duration_frequency_or_step_count_starts_nothing(
    bench: RealRobot, keywords: dict[str, Any], says: str
) -> None:
    assert says in why(bench.run_policy(hold, **keywords))
    assert not task(bench)["running"]


@pytest.mark.parametrize("policy", [None, object(), 7])
def test_the_refusal_of_an_invalid_policy_names_the_accepted_forms(bench: RealRobot, policy: Any) -> None:
    assert "get_actions_sync" in why(bench.run_policy(policy))


def test_a_rollout_does_its_steps_and_its_result_can_be_read_later(bench: RealRobot) -> None:
    seen: list[Mapping[str, float]] = []

    def policy(observation: Mapping[str, float]) -> dict[str, float]:
        seen.append(observation)
        return {"shoulder_pan": 1.0}

    begun = json_of(bench.run_policy(policy, instruction="hold still", n_steps=4, control_frequency=50.0))
    assert begun["running"]
    ended = task_ended(bench)
    assert (ended["steps"], ended["exit_reason"], ended["instruction"]) == (4, "n_steps", "hold still")
    assert all(f"{joint}.pos" in seen[0] for joint in IDS)  # a policy of LeRobot reads these keys
    assert task(bench) == ended


@pytest.mark.parametrize(
    ("policy", "reason", "says"),
    [
        (lambda observation: {"shoulder_lift": 400.0}, "gate", "past 100.0"),
        (lambda observation: {"elbow_typo": 1.0}, "gate", "elbow_typo is not a joint"),
        (lambda observation: None, "policy", "returned NoneType"),
        (lambda observation: 1 / 0, "policy", "division by zero"),
    ],
)
def test_a_rollout_with_an_invalid_action_or_exception_ends_with_the_reason(
    bench: RealRobot, policy: Any, reason: str, says: str
) -> None:
    json_of(bench.run_policy(policy, n_steps=5))
    ended = task_ended(bench)
    assert (ended["exit_reason"], ended["steps"]) == (reason, 0)
    assert says in ended["exit_detail"]


def test_a_second_rollout_is_refused_and_the_end_of_one_leaves_the_arm_energised(bench: RealRobot) -> None:
    json_of(bench.run_policy(hold, duration=30.0))
    assert "already running" in why(bench.run_policy(hold))
    halted = json_of(bench.stop_task())
    assert (halted["stopped"], halted["robot"], halted["running"]) == (True, "so101", False)
    assert halted["exit_reason"] == task(bench)["exit_reason"] == "stopped"
    assert json_of(bench.stop_task()) == halted
    assert status(bench)["state"] in ("armed", "holding")
    json_of(bench.run_policy(hold, duration=0.1))
    assert task_ended(bench)["exit_reason"] == "duration"


def test_the_refusal_of_an_unknown_provider_names_it(bench: RealRobot) -> None:
    assert "not_a_provider" in why(bench.start_task("pick up the cube", policy_provider="not_a_provider"))


def test_known_registers_can_be_read_and_others_are_refused(bench: RealRobot) -> None:
    assert set(bench.bus.sync_read("Present_Position", ["gripper", "elbow_flex"])) == {"gripper", "elbow_flex"}
    for register in ("Present_Velocity", "Present_Load", "Present_Temperature"):
        assert set(bench.bus.sync_read(register)) == set(IDS)
    with pytest.raises(ValueError, match="Present_Nothing"):
        bench.bus.sync_read("Present_Nothing")


def test_an_agents_verbs_are_those_of_the_schema(bench: RealRobot) -> None:
    action = bench.tool_spec["inputSchema"]["json"]["properties"]["action"]
    assert set(action["enum"]) == {"status", "sensors", "get_pose", "move_to", "set_torque", "stop"}
    assert all(f"{verb}:" in action["description"] for verb in action["enum"])
    for other in ("home", "dance", "calibrate", ""):
        refusal = why(ask(bench, action=other))
        assert repr(other) in refusal and all(verb in refusal for verb in action["enum"])
    assert set(json_of(ask(bench, action="sensors"))["positions"]) == set(IDS)
    moved = json_of(ask(bench, action="move_to", targets={"elbow_flex": 10.0}))
    assert moved["commanded"] == {"elbow_flex": 10.0}
    assert "targets is missing" in why(ask(bench, action="move_to"))


@pytest.mark.parametrize("enabled", ["false", "true", 0, 1, None, [], {}])
def test_a_value_that_is_not_a_boolean_neither_energises_nor_releases(bench: RealRobot, enabled: Any) -> None:
    before = status(bench)["epoch"]
    assert "enabled" in why(ask(bench, action="set_torque", enabled=enabled))
    assert status(bench)["epoch"] == before


def test_an_agents_stop_releases_every_motor_and_may_be_awaited(
    bench: RealRobot, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert "operator's approval" in why(ask(bench, action="set_torque", enabled=True)), "not so in the reference"
    monkeypatch.setenv(ALLOW, "set_torque")
    assert json_of(ask(bench, action="set_torque", enabled=True))["armed"] is True
    stopped = json_of(ask(bench, action="stop"))
    assert stopped["safe_state"] == "limp" and stopped["unconfirmed"] == []
    assert all(stopped["motors"][joint]["safe"] for joint in IDS)
    assert "resume() first" in why(bench.send_action({"gripper": 50.0}))
    json_of(bench.resume())

    async def awaited() -> Any:
        return await bench.stop()

    assert json_of(asyncio.run(awaited()))["stopped"] is True
    json_of(bench.resume())
