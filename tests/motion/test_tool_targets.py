"""Poses of the tool as actions of a policy (``ee.x`` ...), with the names of LeRobot."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.poses.tool_actions import NoTool, with_tool
from strands_actors.caller.poses.tool_targets import ToolTargets
from strands_actors.contract.pose_keys import GRIPPER_KEY, POSE_KEYS, TURN_KEYS
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.loading import describe_driver
from tests.answers import json_of, task, until

from .arms import ROBOTS, desk, driver_of

STEP_M, FINGER_M = 0.004, 0.025
SERVO_ARMS = ("so100", "koch")


class Stand:
    """The tool of an arm that stands at its ready position."""

    def __init__(self, robot: str) -> None:
        self.driver = driver_of(robot)
        self.tool = ToolTargets(self.driver)
        at = desk(robot)
        self.positions = dict.fromkeys(self.driver.axes, 10.0)
        self.positions.update(zip(self.tool.joints, at.units.values(at.ready), strict=True))
        self.pose = self.tool.pose(self.positions)

    def after(self, **step: float) -> dict[str, Any]:
        """Return the joint targets of an action beside the present pose, by the last letters of the keys."""
        action = {key: self.pose[key] + step.get(key.removeprefix("ee."), 0.0) for key in POSE_KEYS}
        targets = self.tool.targets(action, self.positions)
        assert not isinstance(targets, Refused), targets
        return targets


@pytest.mark.parametrize("robot", (*ROBOTS, *SERVO_ARMS))
def test_an_action_with_a_pose_becomes_joint_targets_that_reach_it(robot: str) -> None:
    stand = Stand(robot)
    targets = stand.after(x=STEP_M, z=-STEP_M)
    assert tuple(targets) == stand.tool.joints
    reached = stand.tool.pose({**stand.positions, **targets})
    assert reached["ee.x"] == pytest.approx(stand.pose["ee.x"] + STEP_M, abs=1e-4)
    assert reached["ee.z"] == pytest.approx(stand.pose["ee.z"] - STEP_M, abs=1e-4)


@pytest.mark.parametrize("robot", ("so101", *SERVO_ARMS))
def test_the_tool_of_an_arm_on_servos_is_between_its_fingers(robot: str) -> None:
    """The chain, with which such an arm is lowered, ends at the tip of the moving finger."""
    stand = Stand(robot)
    driver = stand.driver
    closed = {**stand.positions, "gripper": 0.0}
    rad = [
        (closed[axis] - zero) / scale for axis, (zero, scale) in zip(driver.axes, driver.model_units(), strict=True)
    ]
    model = driver.arm_model({})
    assert model is not None
    tip, tool = Chain(model.table, driver.axes).points(rad)[-1], stand.tool.place(closed)
    assert tool is not None
    assert math.dist(tip, tool) < FINGER_M
    assert stand.tool.place({**closed, "elbow_flex": math.nan}) is None


def test_a_turn_is_a_rotation_vector_about_the_axes_of_the_base() -> None:
    stand = Stand("panda")
    turned = stand.tool.moved(stand.positions, {"ee.wz": 1.0}, 0.1)
    assert not isinstance(turned, Refused)
    pose = stand.tool.pose({**stand.positions, **turned})
    assert [pose[key] for key in POSE_KEYS[:3]] == pytest.approx(
        [stand.pose[key] for key in POSE_KEYS[:3]], abs=1e-4
    )
    again = stand.tool.targets(pose, stand.positions)
    assert again == pytest.approx(turned, abs=1e-3)
    assert np.linalg.norm([pose[key] for key in TURN_KEYS]) <= np.pi + 1e-6


def test_the_gripper_has_the_key_of_lerobot_and_other_axes_pass() -> None:
    stand = Stand("so101")
    assert stand.pose[GRIPPER_KEY] == 10.0
    place = {key: stand.pose[key] for key in POSE_KEYS[:3]}
    assert stand.tool.targets({**place, GRIPPER_KEY: 30.0}, stand.positions) == pytest.approx(
        {**stand.positions, "gripper": 30.0}, abs=1e-2
    )
    assert stand.tool.targets({GRIPPER_KEY: 30.0}, stand.positions) == {"gripper": 30.0}


@pytest.mark.parametrize(
    ("action", "text"),
    [
        ({"ee.x": 0.2}, "Give all of ee.x, ee.y, ee.z"),
        ({"ee.wx": 0.2, "ee.wy": 0.0, "ee.wz": 0.0}, "a part of the tool's pose is missing"),
        ({"ee.x": 0.2, "ee.y": 0.0, "ee.z": 0.1, "ee.rx": 0.0}, "ee.rx is no key of the tool's pose"),
        ({"ee.x": 0.2, "ee.y": 0.0, "ee.z": 0.1, "elbow_flex.pos": 0.0}, "elbow_flex.pos and a pose"),
        ({"ee.x": math.nan, "ee.y": 0.0, "ee.z": 0.1}, "ee.x is nan. Give a finite number"),
        ({"ee.x": 0.2, "ee.y": "left", "ee.z": 0.1}, "ee.y is 'left'"),
        ({"ee.x": 0.9, "ee.y": 0.0, "ee.z": 0.1}, "cannot move on to xyz=(0.9000, 0.0000, 0.1000)"),
    ],
)
def test_an_action_that_cannot_be_followed_is_refused(action: dict[str, float], text: str) -> None:
    stand = Stand("so101")
    refusal = stand.tool.targets(action, stand.positions)
    assert isinstance(refusal, Refused)
    assert text in refusal.text


def test_a_policy_of_a_robot_without_an_arm_cannot_give_poses() -> None:
    driver = driver_of("crazyflie")
    description = describe_driver(type(driver), "crazyflie", "", type(driver).resolve("crazyflie", {}))
    infer = with_tool(lambda observation, _: [{"ee.x": 0.1, "ee.y": 0.0, "ee.z": 0.1}], description, False)
    with pytest.raises(NoTool, match="no model of an arm is known for crazyflie"):
        infer({}, "")


class Left:
    """A policy that moves the tool to the left, from the pose that it reads."""

    reads_pose = True

    def __init__(self) -> None:
        self.begun: dict[str, float] = {}
        self.steps = 0

    def get_actions_sync(self, observation: dict[str, float], instruction: str) -> list[dict[str, float]]:
        self.begun = self.begun or {key: observation[key] for key in POSE_KEYS[:3]}
        self.steps += 1
        return [{**self.begun, "ee.y": self.begun["ee.y"] + 0.001 * self.steps, GRIPPER_KEY: 20.0}]


def test_a_policy_moves_the_tool_of_a_robot_by_poses(ready: RealRobot) -> None:
    policy = Left()
    json_of(ready.run_policy(policy, n_steps=40, wait=True))
    before, after = policy.begun["ee.y"], json_of(ready.get_pose())["xyz"][1]
    assert 0.02 < after - before < 0.05
    json_of(ready.run_policy(lambda observation: {"ee.x": 2.0, "ee.y": 0.0, "ee.z": 0.0}, n_steps=5))
    until(lambda: not task(ready)["running"], "it ends")
    assert "the tool cannot move on to xyz=(2.0000" in task(ready)["exit_detail"]
