"""Test low-level servoing on the simulated base: the client gives each actuator its goal."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest

from .kortex_client import blob, inside, messages, number, real, real_of, whole
from .world import CLEAR_FAULTS, FEEDBACK, HOME, SET_MODE, TWIST, World, near, twist

REFRESH, REFRESH_COMMAND = 0x30001, 0x30002
GET_MODE, GET_CONTROL_MODE, SET_CONTROL_MODE = 0x20099, 0xA0006, 0xA0007
SINGLE, LOW_LEVEL = 2, 3
POSITION, TORQUE = 1, 3


def command(degrees: Sequence[float], torque_nm: Sequence[float] = (0.0,) * 7, gripper: bytes = b"") -> bytes:
    """Return ``BaseCyclic.Command``."""
    rows = zip(degrees, torque_nm, strict=False)
    actuators = b"".join(blob(2, number(1, 1) + number(2, 1) + real(3, at) + real(5, nm)) for at, nm in rows)
    return number(1, 1) + actuators + (blob(3, blob(3, gripper)) if gripper else b"")


def in_low_level() -> World:
    world = World()
    world.set_mode(LOW_LEVEL)
    return world


@pytest.mark.parametrize("function", [REFRESH, REFRESH_COMMAND])
def test_in_single_level_servoing_the_goals_are_refused(function: int) -> None:
    assert World().refusal(function, command(HOME)) == (3, 75)


@pytest.mark.parametrize("function", [REFRESH, REFRESH_COMMAND])
def test_the_actuators_follow_their_goals(function: int) -> None:
    world = in_low_level()
    goal = list(HOME)
    for _ in range(300):
        goal[0] += 0.1
        goal[5] -= 0.05
        world.call(function, command(goal))
        world.run(0.01)
    world.run(0.5)
    assert near(world.degrees(), goal)
    assert goal[0] == pytest.approx(30.0)


def test_the_answer_has_the_readings_and_the_other_call_has_none() -> None:
    world = in_low_level()
    answer = world.call(REFRESH, command(HOME))
    assert near([real_of(actuator, 4) for actuator in messages(answer, 3)], HOME)
    assert whole(inside(answer, 2), 2) == 6
    assert world.call(REFRESH_COMMAND, command(HOME)) == {}


def test_a_goal_too_far_away_is_a_fault_of_the_joint() -> None:
    world = in_low_level()
    world.call(REFRESH, command((*HOME[:2], HOME[2] + 20.0, *HOME[3:])))
    assert world.faults() == (0x10, [0, 0, 1, 0, 0, 0, 0])
    assert world.state() == 4
    world.run(0.5)
    assert near(world.degrees(), HOME)
    assert world.refusal(REFRESH, command(HOME)) == (3, 22)
    assert world.refusal(SET_MODE, number(1, SINGLE)) == (3, 22)
    world.call(CLEAR_FAULTS)
    assert (world.state(), world.faults()) == (7, (0, [0] * 7))
    assert whole(world.call(GET_MODE), 1) == SINGLE


@pytest.mark.parametrize(("sign", "bit"), [(1.0, 4), (-1.0, 8)])
def test_a_goal_out_of_range_is_a_fault_of_the_joint(sign: float, bit: int) -> None:
    world = in_low_level()
    goal = list(HOME)
    for _ in range(400):
        goal[5] += sign
        world.call(REFRESH, command(goal))
        world.run(0.05)
        if world.state() == 4:
            break
    assert world.faults()[1] == [0, 0, 0, 0, 0, bit, 0]
    assert abs(math.degrees(world.base.plant.position_rad[5]) - sign * 120.0) < 3.0


def test_each_actuator_needs_a_goal() -> None:
    world = in_low_level()
    assert world.refusal(REFRESH, command(HOME[:6])) == (3, 57)
    assert world.refusal(REFRESH, command((math.nan, *HOME[1:]))) == (3, 3)
    assert world.state() == 6


def test_the_gripper_follows_its_goal() -> None:
    world = in_low_level()
    motor = blob(3, number(1, 1) + real(3, 40.0) + real(4, 100.0))
    world.call(REFRESH, command(HOME, gripper=motor))
    world.run(1.0)
    assert real_of(inside(world.call(FEEDBACK), 4, 18, 7), 4) == pytest.approx(40.0)


def test_no_velocity_is_accepted_in_low_level_servoing() -> None:
    assert in_low_level().refusal(TWIST, twist((0.02, 0, 0, 0, 0, 0), 3)) == (3, 75)


# -- torque


def test_an_actuator_in_torque_control_gives_way_to_its_torque() -> None:
    world = in_low_level()
    assert world.call(GET_CONTROL_MODE, device=7)[1] == [POSITION]
    world.call(SET_CONTROL_MODE, number(1, TORQUE), device=7)
    assert world.call(GET_CONTROL_MODE, device=7)[1] == [TORQUE]
    assert world.call(GET_CONTROL_MODE, device=6)[1] == [POSITION]
    for _ in range(30):
        world.call(REFRESH, command(world.degrees(), (0,) * 6 + (2.0,)))
        world.run(0.01)
    turned = math.remainder(world.degrees()[6] - HOME[6], 360.0)
    assert turned > 1.0
    measured = [real_of(actuator, 6) for actuator in messages(world.call(FEEDBACK), 3)]
    assert measured[6] == -2.0, "the measured torque is reversed, as the vendor's example says"
    world.set_mode(SINGLE)
    assert world.call(GET_CONTROL_MODE, device=7)[1] == [POSITION]
    world.run(1.0)
    here = world.degrees()
    world.run(1.0)
    assert near(world.degrees(), here, 0.1) and near(here[:6], HOME[:6])


def test_without_torque_friction_slows_the_actuator_down() -> None:
    world = in_low_level()
    world.call(SET_CONTROL_MODE, number(1, TORQUE), device=1)
    speeds = []
    for step in range(100):
        here, *_ = world.degrees()
        world.call(REFRESH, command((here, *HOME[1:]), (5.0 * (step < 50), *[0.0] * 6)))
        world.run(0.02)
        speeds.append(world.base.plant.velocity_rad_s[0])
    assert 0.3 < speeds[49] < 5.0 and speeds[99] < 0.7 * speeds[49]
    assert near(world.degrees()[1:], HOME[1:])


def test_the_control_mode_is_one_of_an_actuator_in_low_level_servoing() -> None:
    world = World()
    assert world.refusal(SET_CONTROL_MODE, number(1, TORQUE), device=1) == (3, 75)
    world.set_mode(LOW_LEVEL)
    assert world.refusal(SET_CONTROL_MODE, number(1, 2), device=1) == (3, 3)
    for device in (0, 8, 9):
        assert world.refusal(SET_CONTROL_MODE, number(1, TORQUE), device=device) == (3, 52)
