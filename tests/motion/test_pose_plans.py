"""Plans of motions to a pose, without a robot: exact ends, straight lines, speeds, and refusals in words."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from strands_actors.caller.poses.arm import Arm, Pose, turn_between
from strands_actors.caller.poses.plans import PosePlan
from strands_actors.caller.poses.request import Box, quat_of, read_request, rpy_of
from strands_actors.caller.poses.timing import TimedPlan, limits_of, motion_of, time_plan
from strands_actors.caller.session.motions import Motion
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.model.tool import Tool, tool_of
from strands_actors.drivers.ur.arms import arm_of
from strands_actors.drivers.ur.twin.kinematics import Kinematics
from strands_actors.drivers.xarm.arms import arm_of as xarm_of
from strands_actors.kernel.messages import Refused

from .arms import ROBOTS, Desk, asked, desk, driver_of, reachable

NEAR_M, NEAR_RAD, STRAIGHT_M = 1e-3, math.radians(0.5), 2e-3


def made(plan: PosePlan | Refused) -> PosePlan:
    assert isinstance(plan, PosePlan), plan.text
    return plan


def refused(plan: object) -> Refused:
    assert isinstance(plan, Refused), plan
    return plan


def assert_near(reached: Pose, wanted: Pose) -> None:
    assert float(np.linalg.norm(reached.xyz - wanted.xyz)) < NEAR_M
    assert float(np.linalg.norm(turn_between(reached.quat, wanted.quat))) < NEAR_RAD


def timed(at: Desk, plan: PosePlan, speed: float = 0.1) -> Motion:
    """Return the motion of a plan, as the handle makes it."""
    reading, period_s = at.reading(plan.waypoints[0]), 1 / at.driver.timing.control_hz
    result = time_plan(at.driver, plan, speed, reading, period_s)
    assert isinstance(result, TimedPlan), result
    motion = motion_of(at.driver, result, reading, period_s)
    assert isinstance(motion, Motion), motion
    return motion


def rows(at: Desk, motion: Motion) -> Any:
    """Return the joint positions in rad of each setpoint."""
    joints = [at.driver.axes[axis] for axis in at.units.axes]
    values = [motion.action(step) for step in range(motion.n_steps + 1)]
    return (np.array([[row[joint] for joint in joints] for row in values]) - at.units.zero) / at.units.scale


def numbers(text: str) -> list[float]:
    return [float(number) for number in text.strip("()").split(", ")]


def beside(here: Pose, y: float = 0.05, z: float = 0.0) -> list[float]:
    return [float(here.xyz[0]), float(here.xyz[1]) + y, float(here.xyz[2]) + z]


@pytest.mark.parametrize("robot", ROBOTS)
def test_two_hundred_random_poses_that_can_be_reached_are_reached(robot: str) -> None:
    at = desk(robot)
    for pose in reachable(at.arm, 200):
        plan = made(at.planned(xyz=pose.xyz, quat=pose.quat, linear=False))
        assert_near(at.arm.pose(plan.waypoints[-1]), pose)
        assert ((plan.waypoints >= at.arm.low - 1e-9) & (plan.waypoints <= at.arm.high + 1e-9)).all()


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_line_is_straight_and_no_joint_is_too_fast(robot: str) -> None:
    at = desk(robot)
    here = at.arm.pose(at.ready)
    plan = made(at.planned(xyz=beside(here, 0.08, -0.04)))
    motion = timed(at, plan, speed=1.0)
    path = rows(at, motion)
    start, way = here.xyz, plan.goal.xyz - here.xyz
    for rad in path:
        off = at.arm.pose(rad).xyz - start
        assert float(np.linalg.norm(off - way * (off @ way) / (way @ way))) < STRAIGHT_M
    speeds = np.abs(np.diff(path, axis=0)).max(axis=0) / motion.period_s
    most = [at.driver.table[axis].speed for axis in at.units.axes] / np.abs(at.units.scale)
    assert (speeds <= most).all(), "the speed of the tool gives way to the speeds of the joints"
    assert np.allclose(path[0], at.ready, atol=1e-9)


def test_the_tool_is_as_fast_as_asked_in_the_middle() -> None:
    at = desk("ur5e")
    motion = timed(at, made(at.planned(xyz=beside(at.arm.pose(at.ready), 0.1))), speed=0.05)
    places = np.array([at.arm.pose(rad).xyz for rad in rows(at, motion)])
    fastest = np.linalg.norm(np.diff(places, axis=0), axis=1).max() / motion.period_s
    assert fastest == pytest.approx(0.05, rel=0.02)


def test_a_line_keeps_the_orientation_and_five_joints_as_nearly_as_they_can() -> None:
    six, five = desk("ur5e"), desk("so101")
    for at, most in ((six, NEAR_RAD), (five, math.radians(20))):
        here = at.arm.pose(at.ready)
        plan = made(at.planned(xyz=beside(here)))
        assert float(np.linalg.norm(plan.goal.xyz - beside(here))) < NEAR_M
        assert float(np.linalg.norm(turn_between(here.quat, plan.goal.quat))) < most


def test_the_model_of_a_ur_agrees_with_its_closed_form() -> None:
    at, arm = desk("ur5e"), arm_of("ur5e")
    closed = Kinematics(arm.dh_m, [(axis.low, axis.high) for axis in arm.axes])
    for rad in np.random.default_rng(1).uniform(-3, 3, (20, 6)):
        assert np.allclose(at.arm.pose(rad).xyz, closed.flange(rad.tolist()).place, atol=1e-6)


def test_a_pose_of_the_tool_is_relative_to_it() -> None:
    at = desk("ur5e")
    here = at.arm.pose(at.ready)  # the tool points down
    down = made(at.planned(xyz=(0, 0, 0.05), frame="tool"))
    assert np.allclose(down.goal.xyz, here.xyz - np.array((0, 0, 0.05)), atol=1e-4)
    turned = made(at.planned(rpy=(0, 0, 30), frame="tool"))
    assert np.allclose(turned.goal.xyz, here.xyz, atol=1e-4)
    angle = float(np.linalg.norm(turn_between(here.quat, turned.goal.quat)))
    assert math.degrees(angle) == pytest.approx(30, abs=0.1)


@pytest.mark.parametrize("robot", ROBOTS)
def test_a_pose_out_of_reach_is_refused_with_the_nearest_that_is_not(robot: str) -> None:
    at = desk(robot)
    refusal = refused(at.planned(xyz=(0.3, 3.0, 0.3)))
    assert refusal.code == "out_of_reach" and "nearest pose is xyz=(" in refusal.remedy
    xyz, rpy = refusal.limit.removeprefix("xyz=").split(", rpy=")
    plan = made(at.planned(xyz=numbers(xyz), rpy=numbers(rpy), linear=False))
    assert_near(plan.goal, Pose(np.array(numbers(xyz)), np.array(quat_of(numbers(rpy)))))


def test_an_orientation_that_five_joints_do_not_have_is_refused_with_the_nearest() -> None:
    at = desk("so101")
    here = at.arm.pose(at.ready)
    roll, pitch, yaw = rpy_of(here.quat.tolist())
    refusal = refused(at.planned(xyz=here.xyz, rpy=(roll, pitch, yaw + 40)))
    assert refusal.code == "out_of_reach" and "leave the orientation out" in refusal.remedy
    for linear in (True, False):
        plan = made(at.planned(xyz=here.xyz, rpy=numbers(refusal.limit), linear=linear))
        assert_near(plan.goal, Pose(here.xyz, np.array(quat_of(numbers(refusal.limit)))))


def test_a_line_through_a_singularity_is_refused_and_another_way_is_named() -> None:
    at = desk("ur5e")
    straight_wrist = np.array((0.0, -1.6, 1.5, -1.5, 0.0, 0.0))
    here = at.arm.pose(straight_wrist)
    sideways = here.xyz + np.array((0.05, 0.0, 0.0))
    lines = [
        at.planned(straight_wrist, xyz=here.xyz, rpy=rpy) for rpy in ((90, 0, 40), (60, 30, 0), (120, -30, 10))
    ] + [at.planned(straight_wrist, xyz=sideways)]
    refusals = [line for line in lines if isinstance(line, Refused)]
    assert refusals and all("linear=False" in refusal.text for refusal in refusals)


def test_the_arm_keeps_out_of_boxes_on_the_way_and_at_the_end() -> None:
    free = desk("ur5e")
    here = free.arm.pose(free.ready)
    goal = beside(here, 0.3)
    made(free.planned(xyz=goal))
    wall = Box((goal[0] - 0.03, goal[1] - 0.15, goal[2] - 0.05), (0.1, 0.02, 0.1))
    refusal = refused(desk("ur5e", (wall,)).planned(xyz=goal))
    assert refusal.code == "collision" and "would enter keep_out 0 after" in refusal.reason
    at_end = Box((goal[0], goal[1], goal[2]), (0.1, 0.1, 0.1))
    assert "would enter keep_out 0" in refused(desk("ur5e", (at_end,)).planned(xyz=goal, linear=False)).reason
    around = Box((float(here.xyz[0]), float(here.xyz[1]), float(here.xyz[2])), (0.1, 0.1, 0.1))
    assert "is in keep_out 0 already" in refused(desk("ur5e", (around,)).planned(xyz=goal)).reason


def test_a_pose_in_which_the_arm_touches_itself_is_refused() -> None:
    at = desk("ur5e")
    folded = np.array((0.0, -1.57, 2.95, -1.4, -1.57, 0.0))
    touch = at.arm.touch(folded)
    assert touch is not None and touch.box is None
    here = at.arm.pose(folded)
    refusal = refused(at.planned(xyz=here.xyz, quat=here.quat))
    assert refusal.code == "collision" and f"{touch.link} would touch" in refusal.reason


def test_the_drift_since_the_plan_is_blended_out_and_a_real_motion_makes_it_void() -> None:
    at = desk("kuka_iiwa")
    plan = made(at.planned(xyz=beside(at.arm.pose(at.ready))))
    period_s = 1 / at.driver.timing.control_hz
    result = time_plan(at.driver, plan, 0.1, at.reading(at.ready), period_s)
    assert isinstance(result, TimedPlan)
    drifted = motion_of(at.driver, result, at.reading(at.ready + 0.01), period_s)
    assert isinstance(drifted, Motion)
    path = rows(at, drifted)
    assert np.allclose(path[0], at.ready + 0.01) and np.allclose(path[-1], plan.waypoints[-1])
    moved = refused(motion_of(at.driver, result, at.reading(at.ready + 0.2), period_s))
    assert moved.code == "moved"


@pytest.mark.parametrize(
    ("pose", "text"),
    [
        ({}, "no target is given"),
        ({"xyz": (1, 2)}, "xyz is (1, 2). Give 3 numbers in metres"),
        ({"xyz": (300, 0, 0)}, "at most 10"),
        ({"xyz": (math.nan, 0, 0)}, "Give 3 numbers"),
        ({"xyz": "abc"}, "xyz is 'abc'"),
        ({"rpy": (0, 0, 700)}, "3 angles in degrees, at most 360"),
        ({"quat": (1, 1, 1, 1)}, "4 numbers w, x, y, z of length 1"),
        ({"rpy": (0, 0, 0), "quat": (1, 0, 0, 0)}, "rpy and quat are both given"),
        ({"xyz": (0, 0, 0), "frame": "world"}, "frame is 'world'. Give base or tool"),
        ({"xyz": (0, 0, 0), "speed": 0}, "speed is 0. Give m/s, above 0"),
        ({"xyz": (0, 0, 0), "linear": "yes"}, "linear is 'yes'. Give True or False"),
        ({"xyz": (0, 0, 0), "keep_out": [{"center": (0, 0, 0)}]}, 'Give {"center": (x, y, z), "size": (x, y, z)}'),
        ({"xyz": (0, 0, 0), "keep_out": "wall"}, "a list of at most 32 boxes"),
    ],
)
def test_arguments_that_are_no_pose_are_refused(pose: dict[str, Any], text: str) -> None:
    assert text in refused(read_request(**pose)).text


def test_angles_and_quaternions_are_the_same_orientation() -> None:
    for rpy in ((10.0, 20.0, 30.0), (-170.0, 5.0, 90.0), (0.0, -89.0, 0.0)):
        assert rpy_of(quat_of(rpy)) == pytest.approx(rpy)
    request = asked(xyz=np.array((0.1, 0.2, 0.3)), quat=[0, 0, 0, 1.01])
    assert request.xyz == (0.1, 0.2, 0.3) and request.quat == (0.0, 0.0, 0.0, 1.0)


def test_an_xarm_whose_joints_turn_the_other_way_is_recognised_by_its_ranges() -> None:
    driver = driver_of("xarm7")
    usual = driver.arm_model({})
    assert usual is not None
    for arm_type in xarm_of("xarm7").types:
        low, high = zip(*arm_type.range_rad, strict=True)
        model = driver.arm_model({"range_low_rad": low, "range_high_rad": high})
        assert model is not None and model.ranges == arm_type.range_rad
        other = Arm(model, *limits_of(driver, model))
        assert np.allclose(other.pose(other.home).xyz, desk("xarm7").arm.pose(np.array(usual.home)).xyz, atol=1e-6)


def test_a_model_of_the_user_has_the_tool_at_its_site_or_before_its_fingers() -> None:
    limbs, closing = "", ""
    for number in range(4):
        axis = "0 0 1" if number % 2 else "0 1 0"
        limbs += f'<body name="limb{number}" pos="0 0 .2"><joint name="j{number}" axis="{axis}"/><geom size=".02"/>'
        closing += "</body>"
    fingers = "".join(
        f'<body name="finger{side}"><joint name="f{side}" type="slide"/><geom size=".01"/></body>' for side in "lr"
    )
    for inside, site, link in (('<site name="tcp" pos="0 0 .1"/>', "tcp", "limb3"), ("", "", "limb3")):
        text = f"<mujoco><worldbody>{limbs}{inside}{fingers}{closing}</worldbody></mujoco>"
        model = mujoco.MjModel.from_xml_string(text)
        tool = tool_of(model, ["j0", "j1", "j2", "j3", "fl", "fr"])
        assert tool == Tool(site, link, ("j0", "j1", "j2", "j3"))
    legs = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{fingers}</worldbody></mujoco>")
    assert tool_of(legs, ["fl", "fr"]) is None
