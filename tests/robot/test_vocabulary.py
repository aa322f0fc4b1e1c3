"""Names, keys and first calls of a script that was written for strands-robots."""

from __future__ import annotations

import json
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy
import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.session.tree import RobotTree
from strands_actors.kernel.messages import Message, Refused
from strands_actors.kernel.refusals import Code
from strands_actors.testing import Twin
from tests.answers import json_of, status, task, until, why

from .conftest import NewArm
from .helpers import IDS


def test_the_first_command_connects(twin: Twin, new_arm: NewArm) -> None:
    """A script for strands-robots does not call ``connect_eagerly()``."""
    arm = new_arm(port=twin.port)
    began_ns = time.monotonic_ns()
    assert json_of(arm.send_action({"shoulder_pan": 10.0}))["commanded"] == {"shoulder_pan": 10.0}
    assert twin.log.host("setpoint", began_ns)
    json_of(arm.stop())
    assert "resume() first" in why(arm.send_action({"shoulder_pan": 0.0}))  # a command does not undo a stop
    arm.cleanup()
    assert "was cleaned up" in why(arm.send_action({"shoulder_pan": 0.0}))


def test_a_first_command_that_cannot_connect_gives_the_reason(new_arm: NewArm) -> None:
    arm = new_arm(port="/dev/nowhere")
    text = why(arm.send_action({"shoulder_pan": 10.0}))
    assert text.startswith("move: not connected: ") and "/dev/nowhere" in text
    assert "not connected" in why(arm.send_action({"shoulder_pan": 10.0}))


def test_the_first_arming_waits_for_every_process_that_could_stop_the_robot(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    lifts: list[bool] = []
    energise = RobotTree._energise

    async def not_yet(tree: RobotTree, stops: int, requested_ns: int, lift: bool) -> Message | None:
        lifts.append(lift)
        if len(lifts) < 3:
            return Refused(Code.NO_STANDBY, "a process that could stop the robot is missing")
        return await energise(tree, stops, requested_ns, lift)

    monkeypatch.setattr(RobotTree, "_energise", not_yet)
    assert new_arm(port=twin.port).connect_eagerly() is None
    assert lifts == [False] * 3


def test_saf_009_a_stop_while_the_first_command_connects_is_kept(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The next command does not energise the stopped robot."""
    arm = new_arm(port=twin.port)
    connected: list[bool] = []

    async def stopped(tree: RobotTree, arm: bool = True) -> str:
        connected.append(arm)
        return "stopped meanwhile"

    monkeypatch.setattr(RobotTree, "connect", stopped)
    assert why(arm.send_action({"shoulder_pan": 10.0})) == "move: not connected: stopped meanwhile"
    assert "Call connect_eagerly() first" in why(arm.send_action({"shoulder_pan": 10.0}))
    assert connected == [True]


def test_four_threads_may_send_the_first_command(twin: Twin, new_arm: NewArm) -> None:
    arm = new_arm(port=twin.port)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda degrees: arm.send_action({"shoulder_pan": float(degrees)}), range(4)))
    assert [answer["status"] for answer in answers] == ["success"] * 4, answers


# # -- keys and types of strands-robots


def test_both_spellings_of_a_joint_can_be_read(arm: RealRobot) -> None:
    seen = arm.get_observation()
    assert list(seen) == list(IDS)  # the plain keys are listed and sent
    assert seen["shoulder_pan.pos"] == seen["shoulder_pan"] == seen.get("shoulder_pan.pos")
    assert "shoulder_pan.pos" in seen and "elbow.pos" not in seen and "shoulder_pan.pos.pos" not in seen
    assert seen.get("elbow.pos", 7) == 7
    with pytest.raises(KeyError, match=r"elbow\.pos"):
        seen["elbow.pos"]
    assert json.loads(json.dumps(seen)) == dict(seen)
    assert seen.copy()["gripper.pos"] == seen["gripper"]


def test_a_policy_of_the_reference_can_use_keys_with_pos(arm: RealRobot) -> None:
    class Policy:
        def get_actions_sync(self, observation: Any, instruction: str) -> list[dict[str, float]]:
            return [
                {"shoulder_pan.pos": observation["shoulder_pan.pos"], "gripper.pos": observation["gripper.pos"]}
            ]

    json_of(arm.run_policy(Policy(), n_steps=5))
    until(lambda: not task(arm)["running"], "the rollout ends")
    assert task(arm)["exit_reason"] == "n_steps", task(arm)


def test_budgets_of_a_rollout_may_be_numpy_numbers(arm: RealRobot) -> None:
    json_of(arm.run_policy(lambda seen: dict(seen), duration=numpy.float32(5), n_steps=numpy.int64(3)))
    until(lambda: not task(arm)["running"], "the rollout ends")
    assert task(arm)["steps"] == 3
    assert "n_steps is True" in why(arm.run_policy(lambda seen: dict(seen), n_steps=numpy.bool_(True)))
    assert why(arm.send_action({"shoulder_pan": numpy.bool_(True)})).startswith("move: shoulder_pan is True")


def test_the_servos_can_be_read_through_bus_as_in_lerobot(arm: RealRobot) -> None:
    assert status(arm)["motors"] == arm.bus.motors == IDS
    positions = arm.bus.sync_read("Present_Position")
    assert positions == pytest.approx(arm.get_observation(), abs=1.0)
    assert list(arm.bus.sync_read("Present_Position", ["gripper"])) == ["gripper"]
    assert set(arm.bus.sync_read("Present_Voltage")) == set(IDS)
    assert all(isinstance(counts, int) for counts in arm.bus.sync_read("Present_Temperature").values())
    with pytest.raises(ValueError, match=r"'Goal_Position' is not available\. Use one of Present_Position"):
        arm.bus.sync_read("Goal_Position")
    with pytest.raises(ValueError, match="the robot has no joint 'elbow'"):
        arm.bus.sync_read("Present_Position", "elbow")
    arm.cleanup()
    with pytest.raises(ConnectionError, match="cleaned up"):
        arm.bus.sync_read("Present_Position")


def test_a_silent_servo_is_left_out_of_a_read(arm: RealRobot, twin: Twin) -> None:
    twin.fault("off:3")
    until(lambda: "elbow_flex" not in arm.bus.sync_read(), "the silent servo is left out")
    assert "gripper" in arm.bus.sync_read()


def test_a_robot_without_servos_has_no_bus() -> None:
    with pytest.raises(AttributeError, match=r"ur5e has no bus of servos. Use state\(\)"):
        _ = Robot("ur5e", mode="real", port="127.0.0.1").bus


def test_state_has_joints_and_their_velocities(arm: RealRobot) -> None:
    reading = json_of(arm.state())
    assert set(reading["joints"]) == set(reading["joint_velocities"]) == set(IDS)
    assert reading["state"] == "armed" and reading["unit"].startswith("degrees")
