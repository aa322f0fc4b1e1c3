"""Test how the twin's arm behaves under a hand, and when something blocks it."""

from __future__ import annotations

import pytest

from strands_actors.drivers.xarm import protocol as p
from strands_actors.drivers.xarm.protocol import INVALID, Mode, Register, State
from strands_actors.drivers.xarm.twin.registers import COLLISION_SENSITIVITY

from .test_twin import World
from .test_twin_modes import speed

# -- teaching, and joints without power


def test_in_the_mode_for_teaching_a_hand_moves_the_arm_and_it_stays() -> None:
    world = World()
    world.arm(Mode.TEACH)
    plant = world.controller.plant
    plant.push([3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    world.run(0.3)
    plant.push([0.0] * 7)
    moved = world.position[0]
    assert moved > 0.05
    world.say(Register.SET_MODE, bytes((Mode.POSITION,)))
    world.say(Register.SET_STATE, b"\0")
    world.run(0.5)
    stood = world.position[0]
    plant.push([3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    world.run(0.5)
    assert world.position[0] == pytest.approx(stood, abs=0.02)
    assert world.controller.error == 0


def test_a_released_joint_turns_under_a_hand_and_others_do_not() -> None:
    world = World()
    world.arm(Mode.POSITION)
    assert world.say(18, b"\x01\x01") & INVALID == 0
    assert world.controller.state == State.STOPPED
    plant = world.controller.plant
    plant.push([3.0, 0.0, 3.0, 0.0, 0.0, 0.0, 0.0])
    world.run(0.3)
    assert world.position[0] > 0.05 and world.position[2] == pytest.approx(0.0, abs=5e-3)
    plant.push([0.0] * 7)
    world.say(18, b"\x01\x00")
    stood = world.position[0]
    plant.push([3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    world.run(0.3)
    assert world.position[0] == pytest.approx(stood, abs=5e-3), "its brake holds it"


# -- collisions


@pytest.mark.parametrize("mode", [Mode.POSITION, Mode.SERVO, Mode.VELOCITY, Mode.JOINT_ONLINE])
def test_a_blocked_arm_is_error_31_in_each_mode(mode: Mode) -> None:
    world = World()
    world.arm(mode)
    world.controller.jam(0, True)
    goal = p.floats((0.3, *world.home[1:])) + speed()
    velocity = p.floats((0.5, *[0.0] * 6)) + b"\1"
    match mode:
        case Mode.SERVO:
            world.servo(world.at(joint1=0.3))
        case Mode.VELOCITY:
            world.say(Register.JOINT_VELOCITY, velocity)
        case _:
            world.say(Register.MOVE_JOINT, goal)
    world.run(1.0)
    assert (world.controller.error, world.controller.state) == (31, State.STOPPED)
    world.say(Register.CLEAR_ERROR)
    world.controller.jam(0, False)
    world.arm(Mode.POSITION)
    assert world.say(Register.MOVE_JOINT, goal) == 0
    world.run(1.0)
    assert world.position[0] == pytest.approx(0.3, abs=5e-3), "free again, it moves"


def test_a_joint_that_is_jammed_stays_jammed_over_its_brakes() -> None:
    world = World()
    world.controller.jam(0, True)
    world.arm()
    world.say(Register.MOTION_ENABLE, b"\x08\x00")
    world.arm()
    world.servo(world.at(joint1=0.1))
    world.run(0.1)
    assert world.position[0] == pytest.approx(0.0, abs=5e-3)


def test_without_collision_detection_a_blocked_arm_pushes_on() -> None:
    world = World()
    world.say(COLLISION_SENSITIVITY, b"\0")
    world.arm()
    world.controller.jam(0, True)
    world.servo(world.at(joint1=0.3))
    world.run(1.0)
    assert world.controller.error == 0


def test_an_arm_at_full_speed_is_not_blocked() -> None:
    world = World()
    world.arm()
    target = 0.0
    for step in (*[0.037] * 40, *[-0.037] * 80, *[0.037] * 40):
        target += step
        assert world.servo(world.at(joint1=target)) == 0
        world.run(0.012)
    assert world.controller.error == 0
