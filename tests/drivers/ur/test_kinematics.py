"""Compare the twin's kinematics with the DH chain and with the moving body."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from strands_actors.drivers.ur.arms import TABLES, arm_of
from strands_actors.drivers.ur.twin.kinematics import Kinematics
from strands_actors.drivers.ur.twin.pose import ORIGIN, Frame, between, frame_of, moved
from tests.drivers.ur.test_arms import flange


def kinematics_of(robot: str) -> Kinematics:
    arm = arm_of(robot)
    return Kinematics(arm.dh_m, [(axis.low, axis.high) for axis in arm.axes])


def near(one: Frame, other: Frame) -> bool:
    return np.allclose(np.array(one), np.array(other), atol=1e-6)


@pytest.mark.parametrize("robot", TABLES.robots)
def test_forward_is_the_chain_and_inverse_undoes_it(robot: str) -> None:
    arm, kinematics, chance = arm_of(robot), kinematics_of(robot), random.Random(robot)
    for _ in range(40):
        joints = [chance.uniform(axis.low, axis.high) for axis in arm.axes]
        frame, chain = kinematics.flange(joints), flange(arm, joints)
        assert np.allclose(frame.place, chain[:3, 3], atol=1e-9)
        assert np.allclose(np.array([frame.x, frame.y, frame.z]).T, chain[:3, :3], atol=1e-9)
        assert near(frame_of(frame.pose()), frame)
        found = kinematics.joints(frame, joints)
        assert found is not None and kinematics.within(found)
        assert near(kinematics.flange(found), frame)
        followed = kinematics.joints(frame, joints, follow=True)
        assert followed is not None and np.allclose(followed, joints, atol=1e-5)


def test_a_pose_out_of_reach_has_no_joint_solution() -> None:
    kinematics = kinematics_of("ur5e")
    assert kinematics.joints(frame_of((5.0, 5.0, 5.0, 0.0, 0.0, 0.0)), [0.0] * 6) is None
    assert kinematics.joints(frame_of((0.0, 0.0, 0.5, 0.0, 0.0, 0.0)), [0.0] * 6) is None
    assert not kinematics.within([9.0] * 6)


def test_poses_turn_half_and_not_at_all() -> None:
    for angle in (0.0, 1e-12, 1e-4, 1.0, math.pi - 1e-7, math.pi):
        for axis in ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8)):
            pose = (1.0, 2.0, 3.0, *(part * angle for part in axis))
            assert near(frame_of(frame_of(pose).pose()), frame_of(pose))
    frame, other = frame_of((1, 2, 3, 0.1, 0.2, 0.3)), frame_of((0, -1, 1, 1.0, -0.5, 0.2))
    assert near(frame.then(frame.inverse()), ORIGIN)
    assert near(moved(frame, *between(frame, other)), other)
