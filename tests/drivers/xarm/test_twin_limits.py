"""Test the twin's reduced mode and its safety boundary."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import ERROR, INVALID, Mode, Register, State
from strands_actors.drivers.xarm.twin.registers import Other

from .test_twin import World
from .test_twin_modes import line, speed, tool

NARROW = p.floats([end for _ in range(7) for end in (-2.0, 2.0)])


def reduced(world: World, rad_s: float = 0.5, mm_s: float = 50.0) -> None:
    for register, data in (
        (Other.REDUCED_RAD_S, p.floats((rad_s,))),
        (Other.REDUCED_MM_S, p.floats((mm_s,))),
        (Other.REDUCED_RANGE, NARROW),
        (Other.SET_REDUCED, b"\1"),
    ):
        assert not world.say(register, data) & INVALID


def boundary(world: World, *sides: int) -> None:
    assert not world.say(Other.BOUNDARY, struct.pack("<6i", *sides)) & INVALID
    assert not world.say(Other.SET_FENCE, b"\1") & INVALID


def test_the_settings_are_read_back() -> None:
    world = World()
    assert world.controller.obey(Other.GET_REDUCED, b"")[1] == b"\0"
    reduced(world)
    boundary(world, 500, -500, 600, -600, 700, 0)
    state = world.controller.obey(Other.REDUCED_STATE, b"")[1]
    assert len(state) == 79 and world.controller.obey(Other.GET_REDUCED, b"")[1] == b"\1"
    assert struct.unpack_from(">B6h", state) == (1, 500, -500, 600, -600, 700, 0)
    assert struct.unpack_from("<2f", state, 13) == (50.0, 0.5)
    assert struct.unpack_from("<14f", state, 21) == (-2.0, 2.0) * 7 and state[77] == 1
    world.controller.wake_up()
    assert world.controller.obey(Other.REDUCED_STATE, b"")[1][0] == 0


@pytest.mark.parametrize("on", [False, True])
def test_joints_and_tool_are_slower_in_the_reduced_mode(on: bool) -> None:
    world = World()
    if on:
        reduced(world)
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_JOINT, p.floats((2.0, *world.home[1:])) + speed(2.0))
    world.run(0.5)
    assert world.position[0] == pytest.approx(0.25 if on else 1.0, abs=0.15)
    world.arm(Mode.POSITION)
    world.run(1.0)
    start = tool(world)
    world.say(Register.MOVE_LINE, line(*start[:2], start[2] - 150.0, *start[3:], mm_s=200.0))
    world.run(0.5)
    assert start[2] - tool(world)[2] == pytest.approx(25.0 if on else 100.0, abs=15.0)


@pytest.mark.parametrize("mode", [Mode.POSITION, Mode.SERVO, Mode.VELOCITY])
def test_the_smaller_range_is_error_23_in_the_reduced_mode_only(mode: Mode) -> None:
    for on in (False, True):
        world = World()
        world.say(Other.REDUCED_RANGE, p.floats([end for _ in range(7) for end in (-0.1, 1.3)]))
        world.say(Other.SET_REDUCED, bytes((on,)))
        world.say(Register.MOTION_ENABLE, b"\x08\x01")
        world.arm(mode)
        goal = (-0.2, *world.home[1:])
        match mode:
            case Mode.POSITION:
                world.say(Register.MOVE_JOINT, p.floats(goal) + speed())
            case Mode.SERVO:
                world.servo(goal)
            case _:
                world.say(Register.JOINT_VELOCITY, p.floats([-0.5, *[0.0] * 6]) + b"\1")
        world.run(0.5)
        assert world.controller.error == (23 if on else 0)


def test_servo_targets_that_are_faster_than_the_reduced_speed_are_error_24() -> None:
    world = World()
    reduced(world, rad_s=0.5)
    world.arm()
    target, steps = 0.0, 0
    while world.controller.error == 0 and steps < 20:
        target += 0.012
        world.servo(world.at(joint1=target))
        world.run(0.012)
        steps += 1
    assert world.controller.error == 24 and steps < 10


def test_the_checks_know_the_reduced_range_and_the_boundary() -> None:
    world = World()
    pose = p.floats(tool(world))
    joints = p.floats(world.at(joint1=2.5))
    assert world.controller.obey(Other.CHECK_JOINTS, joints)[1] == b"\0"
    assert world.controller.obey(Other.CHECK_POSE, pose)[1] == b"\0"
    reduced(world)
    boundary(world, 300, -300, 300, -300, 700, 0)
    assert world.controller.obey(Other.CHECK_JOINTS, joints)[1] == b"\1"
    assert world.controller.obey(Other.CHECK_POSE, pose)[1] == b"\1"


def test_the_tool_stops_at_the_boundary_with_error_35() -> None:
    world = World()
    x, y, z, *turn = tool(world)
    boundary(world, 600, -600, 100, -100, 800, 0)
    world.arm(Mode.POSITION)
    world.say(Register.MOVE_LINE, line(x, y + 200.0, z, *turn))
    world.run(2.0)
    assert (world.controller.error, world.controller.state) == (35, State.STOPPED)
    assert 80.0 < tool(world)[1] - y < 115.0
    world.say(Register.CLEAR_ERROR)
    world.say(Other.SET_FENCE, b"\0")
    world.arm(Mode.POSITION)
    assert not world.say(Register.MOVE_LINE, line(x, y + 200.0, z, *turn)) & ERROR
    world.run(2.0)
    assert tool(world)[1] - y == pytest.approx(200.0, abs=1.0)


@pytest.mark.parametrize(
    ("register", "data"),
    [
        (Other.REDUCED_MM_S, p.floats((0.0,))),
        (Other.REDUCED_RAD_S, p.floats((-1.0,))),
        (Other.REDUCED_RAD_S, p.floats((float("nan"),))),
        (Other.REDUCED_RANGE, p.floats([1.0, -1.0] * 7)),
        (Other.REDUCED_RANGE, NARROW[:-4]),
        (Other.BOUNDARY, struct.pack("<6i", -500, 500, 600, -600, 700, 0)),
        (Other.BOUNDARY, b"\0" * 20),
        (Other.SET_REDUCED, b"\2"),
        (Other.SET_FENCE, b""),
    ],
)
def test_impossible_settings_are_invalid_and_change_nothing(register: int, data: bytes) -> None:
    world = World()
    before = world.controller.obey(Other.REDUCED_STATE, b"")
    assert world.say(register, data) & INVALID
    assert world.controller.obey(Other.REDUCED_STATE, b"") == before
    assert np.allclose(world.position, world.home)
