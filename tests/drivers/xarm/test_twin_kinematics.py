"""Test the twin's poses, kinematics and safety functions without a controller."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from strands_actors.drivers.common.physics.poses import Pose, angle_between, between, rotation_of, vector_of
from strands_actors.drivers.xarm.arms import ArmType, arm_of
from strands_actors.drivers.xarm.twin.kinematics import Kinematics
from strands_actors.drivers.xarm.twin.limits import Limits
from strands_actors.drivers.xarm.twin.poses import numbers_of, pose_of, rpy_of
from strands_actors.drivers.xarm.twin.safety import CollisionWatch, StepLimit

TYPES = arm_of("xarm7").types
USUAL = arm_of("xarm7").usual


def near(one: Pose, other: Pose, mm: float = 0.1, rad: float = 1e-3) -> bool:
    return float(np.linalg.norm(one.place - other.place)) < mm and angle_between(one, other) < rad


# -- poses


@pytest.mark.parametrize("axis_angle", [False, True])
def test_six_numbers_are_one_pose(axis_angle: bool) -> None:
    chance = random.Random(3)
    for _ in range(200):
        numbers = [chance.uniform(-500, 500) for _ in range(3)] + [chance.uniform(-1.5, 1.5) for _ in range(3)]
        back = numbers_of(pose_of(numbers, axis_angle=axis_angle), axis_angle=axis_angle)
        assert back == pytest.approx(numbers, abs=1e-9)


def test_roll_is_first_and_yaw_last_about_fixed_axes() -> None:
    rotation = pose_of((0, 0, 0, math.pi / 2, 0, math.pi / 2)).rotation
    assert np.allclose(rotation @ (0, 1, 0), (0, 0, 1), atol=1e-12), "y goes up by the roll, and stays by the yaw"
    assert rpy_of(rotation) == pytest.approx((math.pi / 2, 0, math.pi / 2))


@pytest.mark.parametrize("vector", [(0, 0, 0), (1e-9, 0, 0), (math.pi, 0, 0), (0, math.pi, 0), (0, -2.2, 2.2)])
def test_a_rotation_vector_is_found_again(vector: tuple[float, float, float]) -> None:
    rotation = rotation_of(vector)
    assert np.allclose(rotation_of(vector_of(rotation)), rotation, atol=1e-7)


def test_between_two_poses_is_the_shorter_turn() -> None:
    start, end = pose_of((0, 0, 0, 3.0, 0, 0)), pose_of((100, 0, 0, -3.0, 0, 0))
    half = between(start, end, 0.5)
    assert half.place == pytest.approx((50, 0, 0)) and abs(rpy_of(half.rotation)[0]) == pytest.approx(math.pi)
    assert near(between(start, end, 1.0), end) and near(start @ (start.inverse @ end), end)


# -- kinematics


@pytest.mark.parametrize("arm_type", TYPES, ids=lambda arm_type: f"{arm_type.number}-{arm_type.serials[0]}")
def test_joint_positions_for_a_pose_have_this_pose_and_are_in_range(arm_type: ArmType) -> None:
    kinematics = Kinematics("xarm7", arm_type)
    assert kinematics.pose([0.0] * 7).place == pytest.approx((206.0, 0.0, 120.5), abs=0.01)
    chance, found = random.Random(1), 0
    for _ in range(40):
        goal = kinematics.pose([chance.uniform(max(low, -3), min(high, 3)) for low, high in arm_type.range_rad])
        solved = kinematics.solve(goal, [0.0] * 7)
        if solved is not None:
            found += 1
            assert near(kinematics.pose(solved), goal) and Limits(arm_type, 3.14).accepts(solved)
    assert found >= 38


def test_a_pose_out_of_reach_has_no_joint_positions() -> None:
    kinematics = Kinematics("xarm7", USUAL)
    assert kinematics.solve(pose_of((900, 0, 300, math.pi, 0, 0)), [0.0] * 7) is None
    assert kinematics.solve(pose_of((600, 0, 600, math.pi, 0, 0)), [0.0] * 7) is None
    kinematics.set_tool(pose_of((0, 0, 500, 0, 0, 0)))
    assert kinematics.solve(pose_of((1200, 0, 267, 0, math.pi / 2, 0)), [0.0] * 7) is not None, (
        "with a long tool it is"
    )
    kinematics.set_world(pose_of((5000, 0, 0, 0, 0, 0)))
    assert kinematics.solve(pose_of((6200, 0, 267, 0, math.pi / 2, 0)), [0.0] * 7) is not None


def test_the_jacobian_is_the_derivative_of_the_pose() -> None:
    kinematics = Kinematics("xarm7", USUAL)
    kinematics.set_tool(pose_of((10, 20, 130, 0.1, 0.2, 0.3)))
    kinematics.set_world(pose_of((100, 0, 50, 0, 0, 0.5)))
    at = np.array((0.1, -0.3, 0.2, 0.9, 0.3, 1.2, 0.4))
    pose, jacobian = kinematics.jacobian(at)
    for joint in range(7):
        moved = kinematics.pose(at + np.eye(7)[joint] * 1e-6)
        turn = np.array(vector_of(moved.rotation @ pose.rotation.T))
        assert np.allclose(np.concatenate((moved.place - pose.place, turn)) / 1e-6, jacobian[:, joint], atol=1e-2)


def test_speeds_of_the_joints_give_the_speed_of_the_tool() -> None:
    kinematics = Kinematics("xarm7", USUAL)
    at = np.array((0.1, -0.3, 0.2, 0.9, 0.3, 1.2, 0.4))
    twist = np.array((30.0, -20.0, 10.0, 0.1, 0.0, -0.2))
    _, jacobian = kinematics.jacobian(at)
    assert np.allclose(jacobian @ kinematics.rates(at, twist), twist, rtol=0.01, atol=0.1)


def test_the_offsets_of_tool_and_base_are_part_of_the_pose() -> None:
    kinematics = Kinematics("xarm7", USUAL)
    kinematics.set_tool(pose_of((0, 0, 100, 0, 0, 0)))
    assert kinematics.pose([0.0] * 7).place == pytest.approx((206.0, 0.0, 20.5), abs=0.01)
    kinematics.set_world(pose_of((0, 0, 500, 0, 0, 0)))
    assert kinematics.pose([0.0] * 7).place == pytest.approx((206.0, 0.0, 520.5), abs=0.01)


# -- safety functions


def test_the_largest_step_grows_with_the_time_since_the_last_one() -> None:
    for wait_s, allowed in ((0.0, 0.05), (0.01, 0.06), (0.05, 0.1), (0.1, 0.15), (5.0, 0.15)):
        for step, accepted in ((allowed * 0.99, True), (allowed * 1.01, False)):
            limit = StepLimit(lambda: 1.0)
            assert limit.accepts([0.01], [0.0], 0.0)
            assert limit.accepts([0.01], [0.0], 10.0)
            assert limit.accepts([0.02], [0.0], 20.0)
            # The joint has 0.01 rad of the last step to go, as long as it had no time for it.
            ahead = max(0.0, 0.01 - wait_s)
            assert limit.accepts([0.02 + step - ahead], [0.0], 20.0 + wait_s) is accepted, (wait_s, step)


@pytest.mark.parametrize(
    ("pushes", "rad_s", "ahead", "sensitivity", "blocked"),
    [
        (49.0, 0.0, 0.1, 3, True),
        (-49.0, 0.0, -0.1, 3, True),
        (30.0, 0.0, 0.1, 3, False),
        (36.0, 0.0, 0.1, 4, True),
        (49.0, 1.0, 0.1, 3, False),
        (49.0, 0.0, 0.0, 3, False),
        (49.0, 0.0, 0.1, 0, False),
        (49.0, 0.0, 0.1, 1, False),
    ],
)
def test_a_joint_that_pushes_and_stands_still_is_blocked_after_a_while(
    pushes: float, rad_s: float, ahead: float, sensitivity: int, blocked: bool
) -> None:
    watch = CollisionWatch([50.0, 50.0])
    seen = [
        watch.is_blocked(0.004, sensitivity, [0.0, ahead], [0.0, 0.0], [0.0, rad_s], [0.0, pushes])
        for _ in range(30)
    ]
    assert seen[-1] is blocked and not any(seen[:20])
