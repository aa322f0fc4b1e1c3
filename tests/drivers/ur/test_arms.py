"""Test each model: the twin has the arm that the vendor published."""

from __future__ import annotations

import math
import random

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.ur.arms import JOINTS, TABLES, Arm, arm_of
from strands_actors.drivers.ur.twin.model import HOME_RAD, plant_of

ROBOTS = ("ur3e", "ur5e", "ur7e", "ur10e", "ur12e", "ur16e", "ur8long", "ur15", "ur18", "ur20", "ur30")

DH_ALPHA_RAD = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)

REACH_M = {"ur3e": 0.5, "ur5e": 0.85, "ur10e": 1.3, "ur16e": 0.9, "ur15": 1.3, "ur20": 1.75, "ur30": 1.3}
"""Reach as advertised. It includes a part of the wrist beyond the two long links."""


def flange(arm: Arm, radians: list[float]) -> np.ndarray:
    """Return the pose of the flange by the DH chain, as a 4 x 4 matrix."""
    d1, a2, a3, d4, d5, d6 = arm.dh_m
    pose = np.eye(4)
    rows = zip(radians, (d1, 0, 0, d4, d5, d6), (0, a2, a3, 0, 0, 0), DH_ALPHA_RAD, strict=True)
    for theta, d, a, alpha in rows:
        c, s, ca, sa = math.cos(theta), math.sin(theta), math.cos(alpha), math.sin(alpha)
        step = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [0, sa, ca, d], [0, 0, 0, 1]]
        pose = pose @ np.array(step)
    return pose


def test_all_models_are_there() -> None:
    assert tuple(TABLES.robots) == ROBOTS
    with pytest.raises(ValueError, match="ur5e"):
        arm_of("ur6")


@pytest.mark.parametrize("robot", ROBOTS)
def test_the_twin_has_the_kinematics_of_the_row(robot: str) -> None:
    arm = arm_of(robot)
    plant = plant_of(arm)
    chance = random.Random(robot)
    for _ in range(10):
        radians = [chance.uniform(-3, 3) for _ in JOINTS]
        plant.data.qpos[:] = radians
        mujoco.mj_kinematics(plant.model, plant.data)
        body, pose = plant.data.body("wrist_3"), flange(arm, radians)
        assert np.allclose(body.xpos, pose[:3, 3], atol=1e-9)
        assert np.allclose(body.xmat.reshape(3, 3), pose[:3, :3], atol=1e-9)


def test_published_poses_of_the_ur5e() -> None:
    """With all joints at zero the arm lies stretched along -x."""
    pose = flange(arm_of("ur5e"), [0.0] * 6)
    assert np.allclose(pose[:3, 3], [-0.8172, -0.2329, 0.0628], atol=1e-9)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_row_is_whole_and_plausible(robot: str) -> None:
    arm = arm_of(robot)
    for row in (arm.range_deg, arm.speed_deg_s, arm.effort_nm, arm.link_kg):
        assert len(row) == len(JOINTS)
        assert all(number > 0 for number in row)
    assert math.isclose(arm.axes[2].high, math.pi), "the elbow has half the range of the others"
    assert all(120 <= speed <= 360 for speed in arm.speed_deg_s)
    stretched = -arm.dh_m[1] - arm.dh_m[2]
    assert 0.85 < stretched / REACH_M.get(robot, stretched) < 1.05


def test_the_twin_holds_its_own_weight_and_keeps_to_its_speed() -> None:
    arm = arm_of("ur20")
    plant = plant_of(arm)
    for joint in range(6):
        plant.set_torque(joint, True)
    for tick in range(50):
        plant.catch_up(tick * 0.02)
    assert np.allclose(plant.position_rad, HOME_RAD, atol=1e-3)
    plant.set_target(0, 3.0)
    fastest = 0.0
    for tick in range(50, 200):
        plant.catch_up(tick * 0.02)
        fastest = max(fastest, plant.velocity_rad_s[0])
    assert 0.9 * arm.axes[0].speed < fastest < 1.1 * arm.axes[0].speed
    assert abs(plant.position_rad[0] - 3.0) < 0.01
