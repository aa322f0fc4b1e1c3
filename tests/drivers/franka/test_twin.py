"""Test the twin's controller: its guards end a motion for the same faults as a real one, and name them."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import pytest

from strands_actors.drivers.common.physics.body import Commander
from strands_actors.drivers.franka import protocol as p
from strands_actors.drivers.franka.arms import HOME_RAD, arm_of, arms
from strands_actors.drivers.franka.generator import Trajectory, limits_of
from strands_actors.drivers.franka.twin.body import FrankaBody
from strands_actors.drivers.franka.twin.controller import Controller
from strands_actors.drivers.franka.twin.description import urdf
from strands_actors.drivers.franka.twin.model_library import model_library

HOME = tuple(HOME_RAD)
ZEROS = (0.0,) * 7
Path7 = Callable[[int], float]
"""Returns the target of joint 1 for each millisecond."""


def controller_of(robot: str = "panda") -> Controller:
    arm = arm_of(robot)
    return Controller(arm, arm.fci)


def follow(controller: Controller, path: Path7, ticks: int) -> tuple[int, str] | None:
    """Send joint 1 along a path. Return the end of the motion, if it ends."""
    for at in range(ticks):
        controller.take(p.Command(at, (path(at), *HOME[1:]), ZEROS, ZEROS, False))
        ended = controller.tick()
        if ended is not None:
            return ended
    return None


def begin(controller: Controller) -> None:
    assert controller.start(7, p.Controller.JOINT_IMPEDANCE, p.Generator.JOINT_POSITION - 1) == "motion_started"


@pytest.mark.parametrize(
    ("path", "reason"),
    [
        (lambda at: 0.01, "joint_position_motion_generator_start_pose_invalid"),
        (lambda at: 0.0 if at < 5 else 0.01, "joint_motion_generator_velocity_limits_violation"),
        (lambda at: 0.0 if at < 5 else 1e-4, "joint_motion_generator_velocity_discontinuity"),
        (lambda at: 0.0 if at < 5 else 1.4e-5, "joint_motion_generator_acceleration_discontinuity"),
        (lambda at: math.nan, "input_error"),
    ],
)
def test_a_path_that_no_arm_follows_ends_the_motion(path: Path7, reason: str) -> None:
    controller = controller_of()
    begin(controller)
    ended = follow(controller, path, 20)
    if reason == "input_error":
        assert ended == (7, "input_error_aborted")
        return
    assert ended == (7, "reflex_aborted")
    assert controller.mode is p.RobotMode.REFLEX
    state = controller.dialect.state(controller.state())
    assert state.reasons == (reason,)
    assert controller.start(8, 0, 0) == "not_possible"
    assert controller.recover()
    assert controller.dialect.state(controller.state()).reasons == ()


def test_a_path_past_the_range_ends_the_motion() -> None:
    controller = controller_of()
    begin(controller)
    limits = limits_of(arm_of("panda"), 1.0)
    trajectory = Trajectory(limits, HOME)
    trajectory.aim((3.2, *HOME[1:]))
    ended = None
    while ended is None:
        controller.take(p.Command(0, trajectory.step(), ZEROS, ZEROS, False))
        ended = controller.tick()
    assert controller.reasons == {"joint_motion_generator_position_limits_violation"}


def test_near_the_end_of_its_range_an_fr3_may_not_be_fast() -> None:
    controller = controller_of("fr3")
    begin(controller)
    limits = limits_of(arm_of("panda"), 1.0)  # its joints may be as fast at their ends
    trajectory = Trajectory(limits, HOME)
    trajectory.aim((2.74, *HOME[1:]))
    ended = None
    while ended is None and not trajectory.arrived:
        controller.take(p.Command(0, trajectory.step(), ZEROS, ZEROS, False))
        ended = controller.tick()
    assert controller.reasons  # which guard acts first depends on the arm


def test_saf_013_the_motion_survives_nineteen_missed_commands_and_ends_with_the_twentieth() -> None:
    events: list[str] = []
    controller = Controller(arm_of("panda"), 5, events.append)
    begin(controller)
    assert follow(controller, lambda at: 0.0, 3) is None
    for _ in range(p.MISSED_TICKS - 1):
        assert controller.tick() is None
    controller.take(p.Command(0, HOME, ZEROS, ZEROS, False))
    assert controller.tick() is None
    assert controller.dialect.state(controller.state()).success_rate == pytest.approx(4 / 23)
    for _ in range(p.MISSED_TICKS - 1):
        assert controller.tick() is None
    assert controller.tick() == (7, "reflex_aborted")
    assert controller.reasons == {"communication_constraints_violation"}
    assert events == ["reflex"]


def test_a_finished_motion_leaves_the_arm_at_its_target() -> None:
    controller = controller_of()
    begin(controller)
    controller.take(p.Command(0, HOME, ZEROS, ZEROS, True))
    assert controller.tick() == (7, "success")
    assert (controller.mode, controller.q_d) == (p.RobotMode.IDLE, HOME)
    assert not controller.take(p.Command(0, HOME, ZEROS, ZEROS, False)), "without a motion a command has no effect"


@pytest.mark.parametrize(
    ("law", "generator"),
    [
        (p.Controller.JOINT_IMPEDANCE, p.Generator.NONE),  # Only torques need no generator.
        (p.Controller.OTHER, p.Generator.JOINT_POSITION),
        (p.Controller.JOINT_IMPEDANCE, p.Generator.NONE + 1),
        (7, p.Generator.CARTESIAN_POSITION),
    ],
)
def test_motions_that_no_controller_has_are_refused(law: int, generator: int) -> None:
    controller = controller_of()
    assert controller.start(1, law, generator - 1) == "invalid_argument"
    assert controller.mode is p.RobotMode.IDLE


def test_a_controller_that_was_switched_off_restarts_its_count_and_its_arm_moves_on() -> None:
    controller = controller_of()
    for _ in range(50):
        controller.tick()
    controller.reset()
    controller.tick()
    assert controller.dialect.state(controller.state()).message_id == 1
    controller.set_targets((0.5, *HOME[1:]))
    for _ in range(2000):
        controller.tick()
    assert controller.plant.position_rad[0] == pytest.approx(0.5, abs=1e-3)


def test_the_body_is_the_simulations_until_a_motion_begins() -> None:
    controller = controller_of()
    body = FrankaBody(controller)
    assert set(body.commanders) == {Commander.NONE}
    body.energise(True)
    body.set_targets((0.2, *HOME[1:]))
    body.step(1000)
    assert body.felt().position[0] == pytest.approx(0.2, abs=1e-3)
    begin(controller)
    assert set(body.commanders) == {Commander.WIRE}
    body.set_targets(HOME)
    assert controller.q_d[0] == pytest.approx(0.2)
    controller.stop("success")
    assert set(body.commanders) == {Commander.NONE}, "the body does not return to the simulation by itself"
    body.reset()
    assert body.felt().position[0] == 0.0


@pytest.mark.parametrize("robot", arms())
def test_where_the_flange_is_in_the_vendors_start_pose(robot: str) -> None:
    pose = controller_of(robot).pose()
    assert pose[12:15] == pytest.approx((0.30689, 0.0, 0.59028), abs=1e-4)


@pytest.mark.parametrize("robot", ["fr3", "fr3_v2"])
def test_the_description_has_the_parts_that_libfranka_needs(robot: str) -> None:
    joints = [joint for joint in ElementTree.fromstring(urdf(arm_of(robot))) if joint.tag == "joint"]
    assert [joint.get("name") for joint in joints[:7]] == list(arm_of(robot).keys)
    for joint in joints[:7]:
        ends = joint.find("position_based_velocity_limits")
        assert ends is not None and {"velocity_offset", "deceleration_limit"} == set(ends.keys())


def test_the_model_library_is_one_that_the_system_loads(tmp_path: Path) -> None:
    path = tmp_path / "model.so"
    path.write_bytes(model_library())
    library = ctypes.CDLL(str(path))
    q, filled = (ctypes.c_double * 7)(), (ctypes.c_double * 49)(*[1.0] * 49)
    library.M_NE(q, q, ctypes.c_double(1.0), q, filled)
    assert list(filled) == [0.0] * 49
    filled = (ctypes.c_double * 49)(*[1.0] * 49)
    library.c_NE(q, q, q, ctypes.c_double(1.0), q, filled)
    assert list(filled) == [0.0] * 7 + [1.0] * 42
    for joint in range(1, 10):
        for name in ("O_T_J", "O_J_J", "Ji_J_J"):
            assert getattr(library, f"{name}{joint}")
