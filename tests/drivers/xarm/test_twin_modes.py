"""Test which requests move the twin's arm in which mode and state, and what each mode does."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from strands_actors.drivers.common.physics.poses import angle_between
from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, MOTIONS, NOT_READY, Mode, Register, State
from strands_actors.drivers.xarm.twin.poses import pose_of

from .requests import POSITION_MOTIONS, REQUESTS, SERVO_MOTIONS
from .test_twin import World

JOINT_ONLINE = {Register.MOVE_JOINT, Register.MOVE_JOINT_ROUNDED, Register.MOVE_RELATIVE}
POSE_ONLINE = {
    Register.MOVE_LINE,
    Register.MOVE_LINE_ROUNDED,
    Register.MOVE_LINE_TOOL,
    Register.MOVE_LINE_AXIS_ANGLE,
}

FITS: dict[Mode, set[Register]] = {
    Mode.POSITION: set(POSITION_MOTIONS),
    Mode.SERVO: set(SERVO_MOTIONS),
    Mode.TEACH: set(),
    Mode.VELOCITY: {Register.JOINT_VELOCITY},
    Mode.POSE_VELOCITY: {Register.POSE_VELOCITY},
    Mode.JOINT_ONLINE: JOINT_ONLINE,
    Mode.POSE_ONLINE: POSE_ONLINE,
}
"""The motions that fit each mode. The request for ``MOVE_RELATIVE`` is one of the joints."""

FLIP = math.pi


def speed(rad_s: float = 1.0) -> bytes:
    return p.floats((rad_s, 20.0, 0.0))


def line(*pose: float, mm_s: float = 200.0) -> bytes:
    return p.floats((*pose, mm_s, 2000.0, 0.0))


def tool(world: World) -> tuple[float, ...]:
    return world.controller.pose()


# -- what fits


def test_the_table_has_each_motion_and_each_mode() -> None:
    assert set(FITS) == set(Mode)
    assert set().union(*FITS.values()) == MOTIONS


@pytest.mark.parametrize("mode", list(Mode))
def test_a_motion_of_another_mode_is_invalid_and_moves_nothing(mode: Mode) -> None:
    world = World()
    world.arm(mode)
    for register in MOTIONS - FITS[mode]:
        assert world.say(register, REQUESTS[register]) & INVALID, register
    world.run(0.3)
    assert np.allclose(world.position, world.home, atol=1e-3)
    assert world.controller.error == 0


@pytest.mark.parametrize(
    ("mode", "register"), [(mode, register) for mode, registers in FITS.items() for register in sorted(registers)]
)
def test_a_motion_of_its_mode_moves_the_arm(mode: Mode, register: Register) -> None:
    world = World()
    world.arm(mode)
    assert world.say(register, REQUESTS[register]) == 0
    world.run(1.0)
    assert world.controller.error == 0
    moved = float(np.abs(np.subtract(world.position, world.home)).max())
    assert moved > 5e-3 or register is Register.PAUSE


@pytest.mark.parametrize("state", [State.PAUSED, State.STOPPED])
@pytest.mark.parametrize("mode", [mode for mode in Mode if FITS[mode]])
def test_a_paused_or_stopped_arm_is_not_ready_and_does_not_move(mode: Mode, state: State) -> None:
    for register in FITS[mode]:
        world = World()
        world.arm(mode)
        world.say(Register.SET_STATE, bytes((state,)))
        assert world.say(register, REQUESTS[register]) & NOT_READY, register
        world.run(0.2)
        assert np.allclose(world.position, world.home, atol=1e-3), register
        world.say(Register.SET_STATE, b"\0")
        world.run(0.2)
        stood = np.allclose(world.position, world.home, atol=1e-3)
        assert stood is (state is State.STOPPED or register is Register.PAUSE), "only a pause keeps the motion"


@pytest.mark.parametrize("mode", [mode for mode in Mode if FITS[mode]])
def test_after_an_error_each_motion_is_refused_with_the_error(mode: Mode) -> None:
    world = World()
    world.arm(mode)
    world.controller.fail(31)
    for register in FITS[mode]:
        assert world.say(register, REQUESTS[register]) & (ERROR | NOT_READY) == ERROR | NOT_READY, register
    world.say(Register.CLEAR_ERROR)
    world.say(Register.MOTION_ENABLE, b"\x08\x01")
    assert world.say(Register.SET_STATE, b"\0") == 0
    world.run(0.3)
    assert np.allclose(world.position, world.home, atol=1e-3), "and none is kept for later"


@pytest.mark.parametrize("mode", [3, 8, 255])
def test_a_mode_that_does_not_exist_is_invalid(mode: int) -> None:
    world = World()
    world.arm()
    assert world.say(Register.SET_MODE, bytes((mode,))) & INVALID
    assert world.controller.mode == Mode.SERVO and world.controller.state == State.READY


def test_cut_or_impossible_requests_are_invalid_and_move_nothing() -> None:
    for mode, registers in FITS.items():
        for register in registers:
            world = World()
            world.arm(mode)
            assert world.say(register, REQUESTS[register][:-8]) & INVALID or len(REQUESTS[register]) > 36, register
            assert world.say(register, b"") & INVALID
            assert world.say(register, p.floats((math.nan,)) + REQUESTS[register][4:]) & INVALID
            assert world.say(register, p.floats((1e30,)) + REQUESTS[register][4:]) & INVALID
            world.run(0.1)
            assert np.allclose(world.position, world.home, atol=1e-3)


# -- position mode


def test_home_is_three_numbers_and_zero_of_all_joints() -> None:
    world = World()
    world.arm(Mode.POSITION)
    assert world.say(Register.MOVE_HOME, speed()) == 0
    world.run(0.5)
    assert world.controller.state == State.MOVING
    world.run(2.0)
    assert world.controller.state == State.READY
    assert np.allclose(world.position, 0.0, atol=1e-3)
    assert np.allclose(tool(world)[:3], (206.0, 0.0, 120.5), atol=1.0), "the vendor's zero position"


def test_a_line_is_straight_and_ends_at_its_pose() -> None:
    world = World()
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_LINE, line(400.0, 0.0, 300.0, FLIP, 0.0, 0.0))
    world.run(2.0)
    world.say(Register.MOVE_LINE, line(400.0, 200.0, 200.0, FLIP, 0.0, 0.5))
    off_mm = 0.0
    for _ in range(40):
        world.run(0.05)
        x, y, z, *_ = tool(world)
        off_mm = max(off_mm, abs(x - 400.0), abs(z - (300.0 - y / 2)))
    assert off_mm < 3.0
    got, goal = pose_of(tool(world)), pose_of((400.0, 200.0, 200.0, FLIP, 0.0, 0.5))
    assert np.linalg.norm(got.place - goal.place) < 0.5 and angle_between(got, goal) < 5e-3


def test_a_line_that_begins_in_a_singular_position_ends_at_its_pose() -> None:
    """In the zero position several axes of the wrist are parallel: no speed of the joints tilts the tool."""
    world = World()
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_HOME, speed())
    goal = (300.0, 0.0, 150.0, 2.2, 0.0, 0.0)
    world.say(Register.MOVE_LINE, line(*goal))
    world.run(5.0)
    assert world.controller.error == 0
    got = pose_of(tool(world))
    assert np.linalg.norm(got.place - goal[:3]) < 1.0 and angle_between(got, pose_of(goal)) < 5e-3


def test_a_line_has_its_speed() -> None:
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *turn = tool(world)
    world.say(Register.MOVE_LINE, line(x, y + 200.0, z, *turn, mm_s=100.0))
    world.run(1.0)
    assert tool(world)[1] - y == pytest.approx(100.0, abs=10.0)


def test_lines_are_queued_and_paused_and_a_stop_deletes_them() -> None:
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *turn = tool(world)
    for offset in (50.0, 100.0, 0.0):
        assert world.say(Register.MOVE_LINE, line(x, y + offset, z, *turn)) == 0
    assert world.controller.obey(Register.QUEUE, b"")[1] == b"\0\3"
    world.run(0.15)
    world.say(Register.SET_STATE, b"\x03")
    world.run(0.6)
    stood = tool(world)[1]
    world.run(0.5)
    assert tool(world)[1] == pytest.approx(stood, abs=0.5) and 5.0 < stood - y < 60.0
    world.say(Register.SET_STATE, b"\0")
    world.run(3.0)
    assert tool(world)[1] == pytest.approx(y, abs=0.5), "it goes on and does all of them"
    for offset in (50.0, 100.0):
        world.say(Register.MOVE_LINE, line(x, y + offset, z, *turn))
    world.run(0.1)
    world.say(Register.SET_STATE, b"\x04")
    world.run(0.5)
    assert world.controller.obey(Register.QUEUE, b"")[1] == b"\0\0" and tool(world)[1] - y < 45.0


@pytest.mark.parametrize(
    ("register", "data"),
    [
        (Register.MOVE_LINE, line(2000.0, 0.0, 300.0, FLIP, 0.0, 0.0)),
        (Register.MOVE_RELATIVE, p.floats((900.0, 0, 0, 0, 0, 0, 0, 200.0, 2000.0, 0.0, -1.0)) + b"\0\0"),
    ],
)
def test_a_line_out_of_reach_is_error_21(register: Register, data: bytes) -> None:
    world = World()
    world.arm(Mode.POSITION)
    assert world.say(register, data) & ERROR
    assert (world.controller.error, world.controller.state) == (21, State.STOPPED)


def test_a_queued_line_that_leaves_the_arms_reach_is_error_21_there() -> None:
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *turn = tool(world)
    assert world.say(Register.MOVE_LINE, line(x + 20.0, y, z, *turn)) == 0
    assert world.say(Register.MOVE_LINE, line(2000.0, y, z, *turn, mm_s=500.0)) == 0, "it is checked on its way"
    world.run(1.5)
    assert (world.controller.error, world.controller.state) == (21, State.STOPPED)
    assert 500.0 < tool(world)[0] < 800.0


def test_joints_out_of_range_are_error_23_also_when_they_come_late() -> None:
    world = World()
    world.arm(Mode.POSITION)
    far = p.floats((0.0, 0.0, 0.0, -0.3, 0.0, 0.0, 0.0)) + speed()
    assert world.say(Register.MOVE_JOINT, p.floats((0.2, *world.home[1:])) + speed()) == 0
    assert world.say(Register.MOVE_JOINT, far) == 0, "it is checked when its turn comes"
    world.run(1.0)
    assert world.controller.error == 23 and world.position[0] == pytest.approx(0.2, abs=0.01)


def test_a_check_says_which_error_a_motion_would_be_and_moves_nothing() -> None:
    world = World()
    world.arm(Mode.POSITION)
    rows = [
        (Register.MOVE_JOINT, p.floats((0.1, *world.home[1:])) + speed() + b"\1", 0),
        (Register.MOVE_JOINT, p.floats((0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0)) + speed() + b"\1", 23),
        (Register.MOVE_LINE, line(2000.0, 0.0, 0.0, FLIP, 0.0, 0.0) + p.floats((-1.0,)) + b"\0\0\1", 21),
        (Register.MOVE_HOME, speed() + b"\1", 0),
    ]
    for register, data, code in rows:
        assert world.controller.obey(register, data) == (0, bytes((0, 0, code))), register
    world.run(0.3)
    assert np.allclose(world.position, world.home, atol=1e-3) and world.controller.error == 0


def test_relative_motions_add_up() -> None:
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *_ = tool(world)
    world.say(Register.MOVE_RELATIVE, p.floats((0.3, 0, 0, 0, 0, 0, 0, 1.0, 10.0, 0.0, -1.0)) + b"\1\0")
    world.say(Register.MOVE_RELATIVE, p.floats((-0.3, 0, 0, 0, 0, 0, 0, 1.0, 10.0, 0.0, -1.0)) + b"\1\0")
    world.say(Register.MOVE_RELATIVE, p.floats((0, 30.0, -40.0, 0, 0, 0, 0, 200.0, 10.0, 0.0, -1.0)) + b"\0\0")
    world.run(2.5)
    assert np.allclose(tool(world)[:3], (x, y + 30.0, z - 40.0), atol=0.5)


def test_a_line_of_the_tool_is_in_its_frame() -> None:
    """At home the tool looks down, so its z axis is the -z axis of the base."""
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *_ = tool(world)
    world.say(Register.MOVE_LINE_TOOL, line(0.0, 0.0, 50.0, 0.0, 0.0, 0.0))
    world.run(1.5)
    assert np.allclose(tool(world)[:3], (x, y, z - 50.0), atol=1.0)


def test_an_infinite_number_keeps_the_present_value() -> None:
    """So newer clients write a value that the user did not give."""
    world = World()
    world.arm(Mode.POSITION)
    _, y, z, *_ = tool(world)
    world.say(Register.MOVE_LINE, line(420.0, math.inf, math.inf, math.inf, math.inf, math.inf))
    world.run(1.0)
    assert np.allclose(tool(world)[:3], (420.0, y, z), atol=0.5)
    world.say(Register.MOVE_JOINT, p.floats((0.2, *[math.inf] * 6)) + speed())
    here = world.position
    world.run(1.0)
    assert np.allclose(world.position, (0.2, *here[1:]), atol=2e-3)


def test_a_circle_goes_around_and_comes_back() -> None:
    world = World()
    world.arm(Mode.POSITION)
    x, y, z, *turn = tool(world)
    first, second = (x + 40.0, y + 40.0, z, *turn), (x + 80.0, y, z, *turn)
    world.say(Register.MOVE_CIRCLE, p.floats((*first, *second, 60.0, 1000.0, 0.0, 100.0)))
    radii, highest = [], 0.0
    for _ in range(100):
        world.run(0.05)
        px, py, *_ = tool(world)
        radii.append(math.hypot(px - x - 40.0, py - y))
        highest = max(highest, px)
    assert np.allclose(radii, 40.0, atol=2.0) and highest > x + 78.0
    assert np.allclose(tool(world)[:2], (x, y), atol=0.5)


def test_a_pause_in_the_queue_takes_its_time() -> None:
    world = World()
    world.arm(Mode.POSITION)
    world.say(Register.PAUSE, p.floats((1.0,)))
    world.say(Register.MOVE_JOINT, p.floats((0.2, *world.home[1:])) + speed())
    world.run(0.9)
    assert world.position[0] == pytest.approx(0.0, abs=1e-3)
    world.run(0.6)
    assert world.position[0] == pytest.approx(0.2, abs=5e-3)


# -- servo mode with poses


def test_servo_poses_are_followed() -> None:
    world = World()
    world.arm(Mode.SERVO)
    x, y, z, *turn = tool(world)
    for step in range(1, 51):
        assert world.say(Register.SERVO_POSE, line(x, y + step, z, *turn)) == 0
        world.run(0.01)
    world.run(0.3)
    assert tool(world)[1] == pytest.approx(y + 50.0, abs=0.5)
    for _ in range(10):
        data = p.floats((1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 100.0, 2000.0)) + struct.pack("<iB", 0, 1)
        assert world.say(Register.SERVO_POSE_AXIS_ANGLE, data) == 0
        world.run(0.01)
    world.run(0.3)
    assert tool(world)[0] == pytest.approx(x + 10.0, abs=0.5), "relative poses add up"


@pytest.mark.parametrize(("y_mm", "error"), [(900.0, 21), (300.0, 24)])
def test_a_servo_pose_out_of_reach_or_too_far_is_an_error(y_mm: float, error: int) -> None:
    world = World()
    world.arm(Mode.SERVO)
    x, _, z, *turn = tool(world)
    assert world.say(Register.SERVO_POSE, line(x, y_mm, z, *turn)) & ERROR
    assert world.controller.error == error


# -- velocities


def test_a_duration_of_zero_does_not_end() -> None:
    world = World()
    world.arm(Mode.VELOCITY)
    world.say(Register.JOINT_VELOCITY, p.floats([0.2, *[0.0] * 6]) + b"\x01" + p.floats((0.0,)))
    world.run(2.0)
    assert world.position[0] == pytest.approx(0.4, abs=0.03)


def test_the_tool_moves_at_a_speed_until_its_duration_ends() -> None:
    world = World()
    world.arm(Mode.POSE_VELOCITY)
    x, y, z, *_ = tool(world)
    world.say(Register.POSE_VELOCITY, p.floats((0.0, 50.0, 0.0, 0.0, 0.0, 0.0)) + b"\0" + p.floats((1.0,)))
    world.run(2.0)
    assert np.allclose(tool(world)[:3], (x, y + 50.0, z), atol=4.0)
    world.say(Register.POSE_VELOCITY, p.floats((0.0, 0.0, 50.0, 0.0, 0.0, 0.0)) + b"\1")
    world.run(1.0)
    assert tool(world)[2] == pytest.approx(z - 50.0, abs=5.0), "in the frame of the tool, without an end"


@pytest.mark.parametrize("mode", [Mode.VELOCITY, Mode.POSE_VELOCITY])
def test_a_velocity_ends_with_error_23_at_the_end_of_a_range(mode: Mode) -> None:
    world = World()
    world.arm(mode)
    joints = p.floats((0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0)) + b"\1"
    forward = p.floats((0.0, 0.0, 0.0, 0.0, 2.0, 0.0)) + b"\0"
    if mode == Mode.VELOCITY:
        world.say(Register.JOINT_VELOCITY, joints)
    else:
        world.say(Register.POSE_VELOCITY, forward)
    world.run(3.0)
    assert world.controller.error == 23
    for rad, (low, high) in zip(world.position, world.controller._arm_type.range_rad, strict=True):
        assert low - 0.02 < rad < high + 0.02


# -- online planning


def test_the_online_modes_replace_the_motion_that_runs() -> None:
    world = World()
    world.arm(Mode.JOINT_ONLINE)
    world.say(Register.MOVE_JOINT, p.floats((1.0, *world.home[1:])) + speed())
    world.run(0.3)
    world.say(Register.MOVE_JOINT, p.floats((-0.2, *world.home[1:])) + speed())
    assert len(world.controller._queue) == 1
    world.run(1.5)
    assert world.position[0] == pytest.approx(-0.2, abs=5e-3)
    world.say(Register.SET_MODE, bytes((Mode.POSE_ONLINE,)))
    world.say(Register.SET_STATE, b"\0")
    x, y, z, *turn = tool(world)
    world.say(Register.MOVE_LINE, line(x, y + 100.0, z, *turn))
    world.run(0.2)
    world.say(Register.MOVE_LINE, line(x, y - 30.0, z, *turn))
    world.run(1.5)
    assert tool(world)[1] == pytest.approx(y - 30.0, abs=0.5)
