"""Test how the simulated robot moves links to poses: straight, by springs, or to the least cost."""

from __future__ import annotations

import numpy as np
import pytest

from strands_actors.drivers.rby1.commands import Finish
from strands_actors.drivers.rby1.protocol import Control
from strands_actors.drivers.rby1.twin.kinematics import error_of
from strands_actors.drivers.rby1.twin.parts import BODY, Aim, CartesianMove, LinkSpring, Optimum, Reach, Spring

from .test_twin import Client, Robot
from .test_twin_motions import RIGHT, commanded, energised, moved, pose, push, reach, request


@pytest.mark.parametrize("reference", ["base", "link_torso_5"])
def test_a_link_moves_straight_to_its_pose(reference: str) -> None:
    robot, client = energised(), Client()
    aim = reach(robot, reference=reference)
    begin = commanded(robot, "ee_right", reference)
    assert (
        robot.command(client, request(CartesianMove(path=(3,), joints=RIGHT, minimum_s=1.0, reaches=(aim,))))
        is None
    )
    robot.wait(0.5)
    here = commanded(robot, "ee_right", reference)
    assert here.place == pytest.approx((begin.place + aim.pose.place) / 2, abs=0.01)
    robot.wait(1.0)
    assert client.reasons == [Finish.OK]
    here = pose(robot, "ee_right", reference)
    assert here.place == pytest.approx(aim.pose.place, abs=0.02)
    assert here.rotation == pytest.approx(aim.pose.rotation, abs=0.05)


def test_a_way_takes_the_time_that_its_limits_need() -> None:
    robot, client = energised(), Client()
    slow = reach(robot, linear_m_s=0.05)
    robot.command(client, request(CartesianMove(path=(3,), joints=RIGHT, reaches=(slow,))))
    robot.wait(1.9)
    assert client.reasons == []
    robot.wait(0.3)
    assert client.reasons == [Finish.OK]


def test_the_body_moves_both_hands_and_the_torso() -> None:
    robot, client = energised(), Client()
    reaches = tuple(reach(robot, link, z=-0.1) for link in ("link_torso_5", "ee_right", "ee_left"))
    robot.command(client, request(CartesianMove(path=(3,), joints=BODY, minimum_s=1.0, reaches=reaches)))
    robot.wait(2.0)
    assert client.reasons == [Finish.OK]
    for each in reaches:
        assert pose(robot, each.link).place == pytest.approx(each.pose.place, abs=0.03)


def test_a_joints_aim_uses_the_freedom_of_the_arm() -> None:
    robot, client = energised(), Client()
    move = CartesianMove(
        path=(3,), joints=RIGHT, minimum_s=1.0, reaches=(reach(robot),), aims=(Aim("right_arm_2", 0.3),)
    )
    robot.command(client, request(move))
    robot.wait(2.0)
    assert client.reasons == [Finish.OK]
    assert robot.plant.position_rad[RIGHT[2]] == pytest.approx(0.3, abs=0.03)


def test_a_pose_out_of_reach_ends_near_the_singular_position() -> None:
    robot, client = energised(), Client()
    far = Reach(reference="base", link="ee_right", pose=moved(commanded(robot, "ee_right"), x=2.0))
    robot.command(client, request(CartesianMove(path=(3,), joints=RIGHT, minimum_s=1.0, reaches=(far,))))
    robot.wait(3.0)
    assert client.reasons == [Finish.UNEXPECTED_STATE]
    assert robot.control is Control.IDLE


def test_a_cartesian_spring_reaches_its_pose_and_gives_way() -> None:
    robot, client = energised(), Client()
    aim = reach(robot)
    move = CartesianMove(
        path=(3,), joints=RIGHT, minimum_s=1.0, hold_s=2.0, reaches=(aim,), spring=Spring((60.0,) * 7)
    )
    robot.command(client, request(move))
    robot.wait(1.5)
    assert pose(robot, "ee_right").place == pytest.approx(aim.pose.place, abs=0.03)
    push(robot, "right_6", (0.0, 0.0, -40.0))
    robot.wait(1.0)
    assert pose(robot, "ee_right").place[2] < aim.pose.place[2] - 0.03
    robot.wait(1.0)
    assert client.reasons == [Finish.OK]


def test_a_spring_pulls_a_link_to_its_pose() -> None:
    robot, client = energised(), Client()
    aim = reach(robot)
    spring = LinkSpring(
        path=(3,), joints=RIGHT, hold_s=3.0, reach=aim, translation=(1000.0,) * 3, rotation=(50.0,) * 3, damping=1.0
    )
    robot.command(client, request(spring))
    robot.wait(2.0)
    here = pose(robot, "ee_right").place
    assert here == pytest.approx(aim.pose.place, abs=0.03)
    push(robot, "right_6", (0.0, 20.0, 0.0))
    robot.wait(0.9)
    way = pose(robot, "ee_right").place[1] - here[1]
    assert 0.005 < way < 0.06, "some 2 cm: 20 N at 1000 N/m, less the friction of the gears"
    robot.wait(0.3)
    assert client.reasons == [Finish.OK]


def test_an_optimum_weighs_its_costs() -> None:
    robot, client = energised(), Client()
    aim = reach(robot)
    optimum = Optimum(
        path=(3,),
        joints=RIGHT,
        reaches=(Reach(reference="base", link="ee_right", pose=aim.pose, weights=(1.0, 1.0)),),
        aims=(Aim("right_arm_2", 0.3, weight=0.1),),
        stop_cost=1e-5,
    )
    robot.command(client, request(optimum))
    robot.wait(2.0)
    assert client.reasons == [Finish.OK]
    assert pose(robot, "ee_right").place == pytest.approx(aim.pose.place, abs=0.03)


def test_the_centre_of_mass_moves_to_its_place() -> None:
    robot, client = energised(), Client()
    kinematics = robot._joints.kinematics
    kinematics.place(robot._target)
    center, jacobian = kinematics.mass_center("base")
    step = np.full(22, 1e-5)
    kinematics.place(np.array(robot._target) + step)
    assert kinematics.mass_center("base")[0] - center == pytest.approx(jacobian @ step, abs=1e-9)
    goal = center + np.array((0.02, 0.0, 0.0))
    optimum = Optimum(path=(3,), joints=BODY, reaches=(), mass=("base", goal, 1.0), stop_cost=1e-6)
    robot.command(client, request(optimum))
    robot.wait(1.0)
    assert client.reasons == [Finish.OK]
    kinematics.place(robot._target)
    assert kinematics.mass_center("base")[0] == pytest.approx(goal, abs=2e-3)


def test_an_optimum_that_cannot_be_reached_ends_by_its_patience() -> None:
    for patience, ends in ((10, [Finish.OK]), (0, [])):
        robot, client = energised(), Client()
        far = Reach(reference="base", link="ee_right", pose=moved(commanded(robot, "ee_right"), x=2.0))
        optimum = Optimum(path=(3,), joints=RIGHT, reaches=(far,), least_change=2e-3, patience=patience)
        robot.command(client, request(optimum))
        robot.wait(5.0)
        assert client.reasons == ends


@pytest.mark.parametrize("link", ["link_torso_5", "link_right_arm_0", "link_left_arm_3", "ee_left"])
@pytest.mark.parametrize("reference", ["base", "link_torso_5", "ee_right"])
def test_the_derivative_of_a_pose_is_that_of_its_difference(link: str, reference: str) -> None:
    if link == reference:
        return
    kinematics = Robot()._joints.kinematics
    chance = np.random.default_rng(7)
    rad, step = chance.uniform(-0.8, 0.8, 22), chance.uniform(-1.0, 1.0, 22) * 1e-5
    kinematics.place(rad)
    before, jacobian = kinematics.relative(reference, link), kinematics.jacobian(reference, link)
    kinematics.place(rad + step)
    assert error_of(kinematics.relative(reference, link), before) == pytest.approx(jacobian @ step, abs=1e-8)
