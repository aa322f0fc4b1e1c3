"""Test the body behind a twin: gravity, servos, limits, and which servo turns which joint."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.common.kinematics.link_rows import parse_row, parse_rows, quaternion
from strands_actors.drivers.common.physics.jointed import LONGEST_CATCH_UP_S
from strands_actors.drivers.common.physics.model_rows import build
from strands_actors.drivers.common.physics.physics import Plant
from strands_actors.drivers.feetech.robots import TABLES as FEETECH

TABLES = FEETECH.robots
MODELS = Path(__file__).resolve().parents[4] / "shared" / "models"
"""The vendors' mesh models, if they lie next to the checkout."""


class Time:
    """Advance a plant in steps of a control loop."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.now_s = 100.0
        plant.catch_up(self.now_s)

    def run(self, seconds: float, each: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds / 0.01)):
            self.now_s += 0.01
            self.plant.catch_up(self.now_s)
            each()


def energise(plant: Plant) -> None:
    for index, rad in enumerate(plant.position_rad):
        plant.set_target(index, rad)
        plant.set_torque(index, True)


def test_a_limp_arm_falls_and_an_energised_one_does_not() -> None:
    limp, stiff = Plant.from_table(TABLES["so101"]), Plant.from_table(TABLES["so101"])
    lift = limp.joints.index("shoulder_lift")
    energise(stiff)
    Time(limp).run(2.0)
    Time(stiff).run(2.0)
    assert abs(limp.position_rad[lift]) > 0.2
    assert abs(stiff.position_rad[lift]) < 0.05  # droops like the real servo, which has no integral part
    assert limp.effort_nm[lift] == 0
    assert abs(stiff.effort_nm[lift]) > 0.1


def test_torque_off_in_the_air_lets_go_and_torque_on_does_not_jump() -> None:
    plant = Plant.from_table(TABLES["so101"])
    time = Time(plant)
    lift = plant.joints.index("shoulder_lift")
    energise(plant)
    plant.set_target(lift, -0.4)
    time.run(2.0)
    assert plant.position_rad[lift] == pytest.approx(-0.4, abs=0.05)
    for index in range(len(plant.joints)):
        plant.set_torque(index, False)
    time.run(0.5)
    fallen = plant.position_rad[lift]
    assert fallen > -0.3
    plant.set_torque(lift, True)  # the target is still far away, so the joint must travel and not jump
    time.run(0.02)
    assert abs(plant.position_rad[lift] - fallen) < 0.2


@pytest.mark.parametrize("robot", TABLES)
def test_servos_reach_their_targets_within_their_speed(robot: str) -> None:
    table = TABLES[robot]
    plant = Plant.from_table(table)
    time = Time(plant)
    energise(plant)
    targets = [sum(joint["range_rad"]) / 2 for joint in table["joints"]]
    for index, target in enumerate(targets):
        plant.set_target(index, target)
    fastest = [0.0] * len(targets)

    def watch() -> None:
        fastest[:] = map(max, fastest, map(abs, plant.velocity_rad_s))

    time.run(4.0, watch)
    assert plant.position_rad == pytest.approx(targets, abs=0.05)
    limits = [joint["speed_rad_s"] for joint in table["joints"]]
    assert all(speed < limit * 1.15 for speed, limit in zip(fastest, limits, strict=True)), fastest


def test_the_speed_limit_limits_the_joint() -> None:
    table = dict(TABLES["so101"], model_rows=TABLES["so101"]["model_rows"].replace(" 5.8 ", " .5 "))
    plant = Plant.from_table(table)
    time = Time(plant)
    energise(plant)
    plant.set_target(0, 1.5)
    time.run(1.0)
    assert 0.3 < plant.position_rad[0] < 0.55


def test_effort_is_limited_and_can_be_limited_more() -> None:
    plant = Plant.from_table(TABLES["so101"])
    time = Time(plant)
    energise(plant)
    plant.set_target(0, 3.0)  # past the end of the joint's range
    time.run(2.0)
    assert plant.effort_nm[0] == pytest.approx(plant.effort_limit_nm[0])
    plant.set_effort_share(0, 0.25)
    time.run(0.1)
    assert plant.effort_nm[0] == pytest.approx(plant.effort_limit_nm[0] / 4)


def test_a_stuck_joint_stays_and_comes_free() -> None:
    plant = Plant.from_table(TABLES["so101"])
    time = Time(plant)
    energise(plant)
    plant.set_stuck(1, True)
    plant.set_target(1, -0.5)
    time.run(1.0)
    assert abs(plant.position_rad[1]) < 0.01
    plant.set_stuck(1, False)
    time.run(2.0)
    assert plant.position_rad[1] == pytest.approx(-0.5, abs=0.05)


def test_a_stall_is_dropped_not_replayed() -> None:
    plant = Plant.from_table(TABLES["so101"])
    plant.catch_up(50.0)
    plant.catch_up(50.1)
    assert plant.data.time == pytest.approx(0.1, abs=0.003)
    plant.catch_up(1050.0)
    assert plant.data.time == pytest.approx(0.1 + LONGEST_CATCH_UP_S, abs=0.003)
    plant.catch_up(1050.1)
    assert plant.data.time == pytest.approx(0.2 + LONGEST_CATCH_UP_S, abs=0.003)
    plant.catch_up(1049.0)  # a clock that steps back causes no motion
    assert plant.data.time == pytest.approx(0.2 + LONGEST_CATCH_UP_S, abs=0.003)


SHUFFLED = """
<mujoco>
  <compiler angle="radian"/>
  <option gravity="0 0 0"/>
  <default><joint type="hinge" axis="0 1 0" armature="0.1" range="-2 2" limited="true"/></default>
  <worldbody>
    <body><joint name="hip"/><geom size=".05" mass=".1"/>
      <body pos="0 0 .1"><joint name="knee"/><geom size=".05" mass=".1"/>
        <body pos="0 0 .1"><joint name="ankle"/><geom size=".05" mass=".1"/></body></body></body>
  </worldbody>
  <actuator>
    <position name="hip" joint="ankle" forcerange="-1 1"/>
    <position name="ankle" joint="knee" forcerange="-1 1"/>
    <position name="knee" joint="hip" forcerange="-1 1"/>
  </actuator>
</mujoco>
"""


def test_a_servo_is_found_by_its_joint_not_by_order_or_name() -> None:
    plant = Plant(mujoco.MjSpec.from_string(SHUFFLED), ["knee", "hip", "ankle"])
    time = Time(plant)
    energise(plant)
    plant.set_target(0, 0.5)
    time.run(2.0)
    assert plant.data.joint("knee").qpos[0] == pytest.approx(0.5, abs=0.01)
    assert plant.position_rad == pytest.approx([0.5, 0, 0], abs=0.02)


@pytest.mark.parametrize("robot", TABLES)
def test_rows_and_joints_of_a_table_agree(robot: str) -> None:
    table = TABLES[robot]
    rows = {row.joint: row for row in parse_rows(table["model_rows"]) if row.joint}  # the others are welded
    assert {joint["key"] for joint in table["joints"]} == set(rows)
    for joint in table["joints"]:
        assert rows[joint["key"]].limits == pytest.approx(joint["range_rad"], abs=1e-6)
        assert rows[joint["key"]].velocity == joint["speed_rad_s"]
    plant = Plant.from_table(table)
    for joint, rad in zip(table["joints"], plant.position_rad, strict=True):
        low, high = joint["range_rad"]
        assert rad == min(max(0.0, low), high)


@pytest.mark.parametrize("robot", ["so101", "open_duck_mini"])
def test_no_servo_can_count_past_one_turn(robot: str) -> None:
    for joint in TABLES[robot]["joints"]:
        assert all(0 <= 2048 + rad * 4096 / (2 * np.pi) <= 4095 for rad in joint["range_rad"])


MESH_MODELS: dict[str, tuple[str, dict[str, str]]] = {
    "so100": (
        "robot_descriptions/mujoco_menagerie/trs_so_arm100/so_arm100.xml",
        {
            "shoulder_pan": "Rotation",
            "shoulder_lift": "Pitch",
            "elbow_flex": "Elbow",
            "wrist_flex": "Wrist_Pitch",
            "wrist_roll": "Wrist_Roll",
            "gripper": "Jaw",
        },
    ),
    "so101": ("robot_descriptions/SO-ARM100/Simulation/SO101/so101_new_calib.xml", {}),
    "open_duck_mini": ("extra/open_duck_mini_v2/robot.xml", {}),
}


def frames_of_joints(model: Any, angles: dict[str, float]) -> dict[str, Any]:
    """Return the 3 x 3 + 3 numbers of each joint's link, relative to the parent link of the first joint."""
    data = mujoco.MjData(model)
    for name, rad in angles.items():
        data.joint(name).qpos[0] = rad
    mujoco.mj_kinematics(model, data)
    first = model.joint(next(iter(angles))).bodyid[0]
    root = model.body_parentid[first]
    turn, place = data.xmat[root].reshape(3, 3), data.xpos[root]
    out = {}
    for name in angles:
        body = model.joint(name).bodyid[0]
        rotation = turn.T @ data.xmat[body].reshape(3, 3)
        out[name] = np.column_stack([rotation, turn.T @ (data.xpos[body] - place)])
    return out


@pytest.mark.parametrize("robot", MESH_MODELS)
def test_links_have_the_poses_of_the_vendors_model(robot: str) -> None:
    table = TABLES[robot]
    path, names = MESH_MODELS[robot]
    ours = build(table).compile()
    keys = [joint["key"] for joint in table["joints"]]
    generator = random.Random(1)
    at_zero = frames_of_joints(ours, dict.fromkeys(keys, 0.0))
    assert all(np.linalg.norm(frame[:, 3]) < 0.5 for frame in at_zero.values())  # a desktop robot
    if not (MODELS / path).exists():
        return
    theirs = mujoco.MjModel.from_xml_path(str(MODELS / path))
    for key in keys:
        low, high = theirs.joint(names.get(key, key)).range
        ours_low, ours_high = ours.joint(key).range
        assert ours_low == pytest.approx(low, abs=0.2)  # so100 omits what exceeds one turn
        assert ours_high == pytest.approx(high, abs=0.1)
    for _ in range(20):
        pose = {joint["key"]: generator.uniform(*joint["range_rad"]) for joint in table["joints"]}
        mine = frames_of_joints(ours, pose)
        other = frames_of_joints(theirs, {names.get(key, key): rad for key, rad in pose.items()})
        for key in keys:
            assert mine[key] == pytest.approx(other[names.get(key, key)], abs=2e-3), (robot, key)


def test_row_grammar() -> None:
    row = parse_row("link base joint -y 1,2,3 0,0,90 -1,.5 10 2 .3 - c.02")
    assert row.axis == (0.0, -1.0, 0.0)
    assert row.quat == pytest.approx((np.sqrt(0.5), 0, 0, np.sqrt(0.5)))
    assert (row.limits, row.effort, row.velocity, row.kg, row.com) == ((-1.0, 0.5), 10.0, 2.0, 0.3, None)
    assert parse_row("lift base j sz 0,0,0 0 0,1 5 .1 1 - -").slide
    assert quaternion("q:.5,-.5,-.5,-.5") == (0.5, -0.5, -0.5, -0.5)


@pytest.mark.parametrize("line", ["link base joint z", "link base j w 0,0,0 0 - - - - - -"])
def test_a_bad_row_is_named(line: str) -> None:
    with pytest.raises(ValueError, match=line):
        parse_row(line)
