"""Test the twin's Cartesian motions: where the end effector goes, and which limits end them.

The names of the errors are those of the vendor's ``franka::Errors``.
"""

from __future__ import annotations

import math
import random
import struct
from collections.abc import Callable, Sequence
from typing import Any

import mujoco
import numpy as np
import pytest

from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import HOME_RAD, arm_of, arms
from strands_actors.drivers.franka.twin import kinematics
from strands_actors.drivers.franka.twin.controller import Controller

ZEROS = (0.0,) * 7
IDENTITY = tuple(np.eye(4).ravel().tolist())
POSE, VELOCITY = p.Generator.CARTESIAN_POSITION, p.Generator.CARTESIAN_VELOCITY
Numbers = Sequence[float]


def controller_of(robot: str = "panda") -> Controller:
    arm = arm_of(robot)
    return Controller(arm, arm.fci)


def begin(controller: Controller, generator: int, law: int = p.Controller.JOINT_IMPEDANCE) -> None:
    assert controller.start(7, law, generator - 1) == "motion_started"


def by_pose(pose: Numbers, elbow: Numbers = (), finished: bool = False) -> p.Command:
    return p.Command(0, ZEROS, ZEROS, ZEROS, finished, tuple(pose), (0.0,) * 6, tuple(elbow))


def by_twist(twist: Numbers, elbow: Numbers = (), finished: bool = False) -> p.Command:
    return p.Command(0, ZEROS, ZEROS, ZEROS, finished, IDENTITY, tuple(twist), tuple(elbow))


def field(controller: Controller, name: str) -> tuple[float, ...]:
    return controller.dialect.get(controller.state(), name)


def send(controller: Controller, command: p.Command) -> tuple[int, str] | None:
    controller.take(command)
    return controller.tick()


def shifted(pose: Numbers, by: Numbers) -> list[float]:
    return [*pose[:12], *(here + far for here, far in zip(pose[12:15], by, strict=True)), 1.0]


def turned(pose: Numbers, rad: float) -> list[float]:
    """Return a pose that is turned about the base's z."""
    matrix = kinematics.matrix(pose)
    matrix[:3, :3] = kinematics.rotation_of(np.array((0.0, 0.0, rad))) @ matrix[:3, :3]
    return kinematics.numbers(matrix)


def smooth(share: float) -> float:
    """Return how far a motion has come at a share of its time, without a jump in speed or acceleration."""
    return share**3 * (10.0 - 15.0 * share + 6.0 * share**2)


def settle(controller: Controller) -> None:
    for _ in range(400):
        controller.tick()


# -- kinematics


@pytest.mark.parametrize("robot", arms())
def test_the_flange_is_where_the_body_has_it(robot: str) -> None:
    plant, chance = controller_of(robot).plant, random.Random(7)
    arm = arm_of(robot)
    for _ in range(20):
        joints = [chance.uniform(low, high) for low, high in zip(arm.low, arm.high, strict=True)]
        plant.data.qpos[:7] = joints
        mujoco.mj_forward(plant.model, plant.data)
        expected = plant.pose_of("link7", (0.0, 0.0, 0.107))
        assert kinematics.numbers(kinematics.pose(joints)) == pytest.approx(expected, abs=1e-9)


def test_the_jacobian_is_the_derivative_of_the_pose() -> None:
    joints, step = np.array(HOME_RAD) + 0.1, 1e-6
    columns = kinematics.jacobian(joints.tolist())
    before = kinematics.pose(joints.tolist())
    for joint in range(7):
        there = joints.copy()
        there[joint] += step
        after = kinematics.pose(there.tolist())
        moved = (after[:3, 3] - before[:3, 3]) / step
        rotated = kinematics.rotation_vector(after[:3, :3] @ before[:3, :3].T) / step
        assert columns[:, joint] == pytest.approx([*moved, *rotated], abs=1e-5)


def test_a_pose_is_solved_with_its_elbow_and_one_that_is_out_of_reach_is_not() -> None:
    joints = [rad + 0.05 for rad in HOME_RAD]
    solved = kinematics.solve(kinematics.pose(joints), joints[2], HOME_RAD)
    assert solved == pytest.approx(joints, abs=1e-8)
    far = kinematics.pose(joints)
    far[0, 3] += 5.0
    assert kinematics.solve(far, joints[2], HOME_RAD) is None


# -- where it goes


@pytest.mark.parametrize("robot", arms())
def test_the_end_effector_goes_along_the_poses(robot: str) -> None:
    controller = controller_of(robot)
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    for at in range(2001):
        far = 0.1 * smooth(at / 2000)
        ended = send(controller, by_pose(turned(shifted(start, (far, far, -far)), far), finished=at == 2000))
        assert ended is None or at == 2000, controller.reasons
        if at == 1000:
            assert field(controller, "O_T_EE_c")[12] == pytest.approx(start[12] + 0.05, abs=1e-5)
            assert field(controller, "O_dP_EE_c")[0] == pytest.approx(0.1 * 1.875 / 2.0, rel=1e-3)
            assert max(map(abs, field(controller, "dq_d"))) > 0.05
    assert ended == (7, "success") and controller.mode is p.RobotMode.IDLE
    settle(controller)
    assert controller.pose() == pytest.approx(turned(shifted(start, (0.1, 0.1, -0.1)), 0.1), abs=1e-4)
    assert controller.plant.position_rad[2] == pytest.approx(HOME_RAD[2], abs=1e-4), "the elbow stays where it is"


def test_the_end_effector_goes_at_a_velocity() -> None:
    controller = controller_of()
    begin(controller, VELOCITY)
    start = controller.pose()
    for at in range(2001):
        share = 1.0 - math.cos(2.0 * math.pi * at / 2000)
        ended = send(controller, by_twist((0.05 * share, 0.0, 0.02 * share, 0.0, 0.0, 0.1 * share), (), at == 2000))
    assert ended == (7, "success"), controller.reasons
    settle(controller)
    assert controller.pose() == pytest.approx(turned(shifted(start, (0.1, 0.0, 0.04)), 0.2), abs=1e-4)


def test_the_elbow_goes_while_the_end_effector_stands() -> None:
    controller = controller_of()
    begin(controller, POSE)
    start, (elbow, sign) = field(controller, "O_T_EE_d"), field(controller, "elbow_d")
    assert (elbow, sign) == (pytest.approx(HOME_RAD[2]), -1.0)
    for at in range(2001):
        ended = send(controller, by_pose(start, (elbow + 0.4 * smooth(at / 2000), sign), at == 2000))
        if at == 1000:
            assert field(controller, "delbow_c")[0] == pytest.approx(0.4 * 1.875 / 2.0, rel=1e-3)
    assert ended == (7, "success"), controller.reasons
    settle(controller)
    assert controller.pose() == pytest.approx(start, abs=1e-4)
    assert controller.plant.position_rad[2] == pytest.approx(0.4, abs=1e-4)


def test_the_end_effectors_frame_is_the_clients() -> None:
    """A tool of 10 cm, turned by 45 degrees."""
    controller = controller_of()
    before = kinematics.matrix(controller.pose())
    tool = np.eye(4)
    tool[:3, :3] = kinematics.rotation_of(np.array((0.0, 0.0, math.pi / 4)))
    tool[2, 3] = 0.1
    assert controller.store("ne_to_ee", struct.pack("<16d", *kinematics.numbers(tool))) == b"\0"
    assert controller.pose() == pytest.approx(kinematics.numbers(before @ tool), abs=1e-9)
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    assert start == pytest.approx(controller.pose(), abs=1e-5)
    joints = controller.plant.position_rad
    for at in range(1001):
        ended = send(controller, by_pose(turned(start, 0.2 * smooth(at / 1000)), finished=at == 1000))
    assert ended == (7, "success"), controller.reasons
    settle(controller)
    assert controller.pose()[12:15] == pytest.approx(start[12:15], abs=1e-4), "it turns about the tool's tip"
    assert controller.plant.position_rad[6] == pytest.approx(joints[6] - 0.2, abs=0.02)


def test_a_path_goes_on_without_commands() -> None:
    controller = controller_of()
    begin(controller, VELOCITY)
    for at in range(500):
        assert send(controller, by_twist((0.1 * smooth(at / 499), 0.0, 0.0, 0.0, 0.0, 0.0))) is None
    here = field(controller, "O_T_EE_c")[12]
    for _ in range(10):
        assert controller.tick() is None
    assert field(controller, "O_T_EE_c")[12] == pytest.approx(here + 1e-3, rel=1e-3), "at the same velocity"
    for _ in range(10):
        ended = controller.tick()
    assert ended == (7, "reflex_aborted") and controller.reasons == {"communication_constraints_violation"}


def test_torques_of_a_client_that_uses_the_controllers_inverse_kinematics() -> None:
    """As libfranka's example joint_impedance_control: the state shows the joints of the commanded pose."""
    controller = controller_of()
    begin(controller, POSE, p.Controller.EXTERNAL)
    start = field(controller, "O_T_EE_d")
    for at in range(3001):
        q_d, q, dq = (field(controller, name) for name in ("q_d", "q", "dq"))
        wanted = [300.0 * (goal - here) - 25.0 * speed for goal, here, speed in zip(q_d, q, dq, strict=True)]
        last = field(controller, "tau_J_d")
        tau = tuple(before + min(1.0, max(-1.0, nm - before)) for nm, before in zip(wanted, last, strict=True))
        pose = shifted(start, (0.08 * smooth(min(1.0, at / 2000)), 0.0, 0.0))
        command = by_pose(pose, finished=at == 3000)._replace(tau=tau)
        ended = send(controller, command)
        assert ended is None or at == 3000, controller.reasons
    assert ended == (7, "success")
    assert controller.pose()[12] == pytest.approx(start[12] + 0.08, abs=5e-3)


# -- which limits end it


def ends_with(controller: Controller, commands: Callable[[int], p.Command], ticks: int = 50) -> set[str]:
    for at in range(ticks):
        ended = send(controller, commands(at))
        if ended is not None:
            assert ended == (7, "reflex_aborted") and controller.mode is p.RobotMode.REFLEX
            return controller.reasons
    return set()


def _skewed(pose: Numbers) -> list[float]:
    return [pose[0] + 0.01, *pose[1:]]


POSES: dict[str, Callable[[Numbers, int], Numbers]] = {
    "cartesian_position_motion_generator_invalid_frame": lambda start, at: _skewed(start),
    "cartesian_position_motion_generator_start_pose_invalid": lambda start, at: shifted(start, (0.01, 0.0, 0.0)),
    "cartesian_motion_generator_velocity_limits_violation": lambda start, at: shifted(
        start, (0.01 if at > 5 else 0.0, 0.0, 0.0)
    ),
    "cartesian_motion_generator_velocity_discontinuity": lambda start, at: shifted(
        start, (5e-5 if at > 5 else 0.0, 0.0, 0.0)
    ),
    "cartesian_motion_generator_acceleration_discontinuity": lambda start, at: shifted(
        start, (0.0, 8.5e-6 if at > 5 else 0.0, 0.0)
    ),
}


@pytest.mark.parametrize("reason", POSES)
@pytest.mark.parametrize("robot", ["panda", "fr3"])
def test_poses_that_no_arm_follows(robot: str, reason: str) -> None:
    controller = controller_of(robot)
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    assert ends_with(controller, lambda at: by_pose(POSES[reason](start, at))) == {reason}


@pytest.mark.parametrize(
    ("rad", "reason"),
    [
        (0.01, "cartesian_motion_generator_velocity_limits_violation"),
        (1e-4, "cartesian_motion_generator_velocity_discontinuity"),
        (2e-5, "cartesian_motion_generator_acceleration_discontinuity"),
    ],
)
def test_turns_that_no_arm_follows(rad: float, reason: str) -> None:
    controller = controller_of()
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    assert ends_with(controller, lambda at: by_pose(turned(start, rad if at > 5 else 0.0))) == {reason}


@pytest.mark.parametrize(
    ("speed", "reason"),
    [
        (2.0, "cartesian_motion_generator_velocity_limits_violation"),
        (0.1, "cartesian_motion_generator_velocity_discontinuity"),
        (0.01, "cartesian_motion_generator_acceleration_discontinuity"),
    ],
)
def test_velocities_that_no_arm_follows(speed: float, reason: str) -> None:
    controller = controller_of()
    begin(controller, VELOCITY)
    twist = (speed, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert ends_with(controller, lambda at: by_twist(twist if at > 5 else (0.0,) * 6)) == {reason}


@pytest.mark.parametrize(
    ("elbow", "reason"),
    [
        ((0.1, -1.0), "cartesian_motion_generator_start_elbow_invalid"),
        ((0.0, 1.0), "cartesian_motion_generator_elbow_sign_inconsistent"),
    ],
)
def test_an_elbow_that_is_not_the_arms(elbow: Numbers, reason: str) -> None:
    controller = controller_of()
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    assert ends_with(controller, lambda at: by_pose(start, elbow)) == {reason}


def test_an_elbow_past_its_range() -> None:
    controller = controller_of()
    begin(controller, POSE)
    start = field(controller, "O_T_EE_d")
    far = arm_of("panda").high[2] + 0.01
    reasons = ends_with(controller, lambda at: by_pose(start, (0.0 if at < 5 else far, -1.0)))
    assert reasons == {"cartesian_motion_generator_elbow_limit_violation"}


@pytest.mark.parametrize(
    ("towards", "limit"), [((0.0, 0.0, 1.0), "velocity_limits"), ((-1.0, 0.0, 0.0), "position_limits")]
)
def test_a_way_that_the_joints_cannot_go(towards: Numbers, limit: str) -> None:
    """Straight up the arm stretches, and its joints get too fast. Towards the base a joint reaches its end."""
    controller = controller_of()
    begin(controller, VELOCITY)

    def command(at: int) -> p.Command:
        speed = 0.25 * smooth(min(1.0, at / 1000))
        return by_twist((*(speed * part for part in towards), 0.0, 0.0, 0.0))

    ended = ends_with(controller, command, 6000)
    assert ended == {f"cartesian_motion_generator_joint_{limit}_violation"}


def test_a_motion_cannot_start_at_a_singular_pose() -> None:
    controller = controller_of()
    # These joints were found by a search.
    controller.set_targets((0.0, 1.2, 0.0, -2.7, 0.0, 0.5276, 0.0))
    assert controller.start(7, p.Controller.JOINT_IMPEDANCE, POSE - 1) == "start_at_singular_pose"
    assert controller.mode is p.RobotMode.IDLE
    assert controller.start(7, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1) == "motion_started"


# -- torques and stiffness


def test_a_torque_that_jumps_ends_the_motion() -> None:
    controller = controller_of()
    begin(controller, p.Generator.JOINT_VELOCITY, p.Controller.EXTERNAL)

    def command(at: int) -> p.Command:
        return p.Command(0, ZEROS, ZEROS, (min(at, 5) * 0.9 + (2.0 if at > 5 else 0.0), *ZEROS[1:]), False)

    assert ends_with(controller, command) == {"controller_torque_discontinuity"}


def stretched(controller: Controller, law: int) -> float:
    """Return how far a torque of 5 Nm moves joint 1 in a motion that stands still."""
    controller.start(7, law, p.Generator.JOINT_POSITION - 1)
    goal = controller.q_d
    controller.plant.push((5.0, *ZEROS[1:]))
    for _ in range(1500):
        controller.take(p.Command(0, goal, ZEROS, ZEROS, False))
        assert controller.tick() is None
    far = controller.plant.position_rad[0] - goal[0]
    controller.stop("preempted")
    settle(controller)
    return far


def test_the_stiffness_of_the_joints_is_the_clients() -> None:
    controller = controller_of()
    stiff = stretched(controller, p.Controller.JOINT_IMPEDANCE)
    assert controller.store("joint_impedance", struct.pack("<7d", *[250.0] * 7)) == b"\0"
    assert stretched(controller, p.Controller.JOINT_IMPEDANCE) == pytest.approx(5.0 / 250.0, rel=0.05)
    assert stretched(controller, p.Controller.CARTESIAN_IMPEDANCE) == pytest.approx(stiff, rel=0.05)
    assert stiff < 5.0 / 500.0, "without a motion under that law the arm is stiff again"


def test_the_stiffness_of_the_end_effector_is_the_clients() -> None:
    controller = controller_of()
    assert controller.store("cartesian_impedance", struct.pack("<6d", *[200.0] * 3, *[20.0] * 3)) == b"\0"
    soft = stretched(controller, p.Controller.CARTESIAN_IMPEDANCE)
    arm_m = math.hypot(*controller.pose()[12:14])
    assert soft == pytest.approx(5.0 / (200.0 * arm_m**2 + 20.0), rel=0.1)
    controller.reset()
    assert stretched(controller, p.Controller.CARTESIAN_IMPEDANCE) < soft / 4, "a restart forgets it"


@pytest.mark.parametrize(
    ("name", "row"),
    [
        ("joint_impedance", [-1.0] * 7),
        ("joint_impedance", [20000.0] * 7),
        ("joint_impedance", [100.0] * 6),
        ("cartesian_impedance", [5000.0] * 3 + [10.0] * 3),
        ("cartesian_impedance", [100.0] * 6 + [1.0]),
        ("ne_to_ee", [2.0] * 16),
        ("ee_to_k", [math.nan] * 16),
        ("load", [-1.0] + [0.0] * 12),
    ],
)
def test_a_setting_that_no_controller_takes(name: str, row: Sequence[Any]) -> None:
    controller = controller_of()
    assert controller.store(name, struct.pack(f"<{len(row)}d", *row)) == b"\2"
    assert name not in controller.settings


def test_settings_do_not_change_during_a_motion() -> None:
    controller = controller_of()
    begin(controller, POSE)
    load = struct.pack("<13d", 1.0, *[0.0] * 12)
    assert controller.store("load", load) == b"\1"
    controller.stop("preempted")
    assert controller.store("load", load) == b"\0"


def test_joints_that_jump_after_the_inverse_kinematics() -> None:
    """Close to a singular pose a slow end effector lets the joints accelerate too much."""
    controller = controller_of()
    controller.set_targets((0.0, 1.2, 0.0, -2.7, 0.0, 0.8, 0.0))
    begin(controller, VELOCITY)
    twist = np.zeros(6)

    def command(at: int) -> p.Command:
        twist[:3] = 0.0, 0.006 * min(at, 20), 0.0
        return by_twist(twist.tolist())

    (reason,) = ends_with(controller, command, 200)
    assert reason in {
        "cartesian_motion_generator_joint_velocity_discontinuity",
        "cartesian_motion_generator_joint_acceleration_discontinuity",
    }
