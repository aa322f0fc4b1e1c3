"""Test commands of velocity on the simulated base: the tool's twist, and the limits of the joints."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .kortex_client import joint_speeds, messages, real_of
from .world import ABORT, EXECUTE_ACTION, HOME, STOP, TWIST, World, near, reach_angles, twist

MIXED, TOOL, BASE = 1, 2, 3
SPEEDS = 0x20084


@pytest.mark.parametrize(
    ("frame", "values", "moved_m", "turned_deg"),
    [
        (BASE, (0.05, 0, 0, 0, 0, 0), (0.1, 0, 0), (0, 0, 0)),
        (BASE, (0, 0, -0.05, 0, 0, 10), (0, 0, -0.1), (0, 0, 20)),
        # At home the tool points forward: its axes x, y, z are y, z, x of the base.
        (TOOL, (0, 0.03, 0, 0, 0, 5), (0, 0, 0.06), (10, 0, 0)),
        # Its axes turn with it, so this is an arc.
        (TOOL, (0, 0, 0.05, 0, 10, 0), (0.098, 0.017, 0), (0, 0, 20)),
        (MIXED, (0, 0.05, 0, 0, 0, 5), (0, 0.1, 0), (10, 0, 0)),
        (0, (0, 0.05, 0, 0, 0, 5), (0, 0.1, 0), (10, 0, 0)),
    ],
)
def test_a_twist_moves_the_tool_along_the_axes_of_its_frame(
    frame: int, values: tuple[float, ...], moved_m: tuple[float, ...], turned_deg: tuple[float, ...]
) -> None:
    world = World()
    start, before = world.tool_m(), world.base.kinematics.pose(world.base.plant.position_rad).rotation
    world.call(TWIST, twist(values, frame))
    world.run(2.0)
    assert np.allclose(world.tool_m() - start, moved_m, atol=8e-3)
    turn = world.base.kinematics.pose(world.base.plant.position_rad).rotation @ before.T
    vector = np.degrees([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2.0
    assert np.allclose(vector, np.degrees(np.sin(np.radians(turned_deg))), atol=1.5)


def test_a_twist_is_measured_and_lasts_until_a_stop_whatever_its_duration() -> None:
    world = World()
    world.call(TWIST, twist((-0.02, 0, 0, 0, 0, 5), BASE, duration=100))
    world.run(3.0)
    measured = [world.of_base(field) for field in range(19, 25)]
    assert measured == pytest.approx([-0.02, 0, 0, 0, 0, 5], abs=0.3)
    assert measured[0] == pytest.approx(-0.02, abs=2e-3)
    world.call(STOP)
    world.run(0.5)
    assert [world.of_base(field) for field in range(19, 25)] == pytest.approx([0.0] * 6, abs=1e-3)


@pytest.mark.parametrize(
    ("values", "frame", "error"),
    [
        ((0.6, 0, 0, 0, 0, 0), BASE, (3, 60)),
        ((0, 0, 0, 0, 80, 80), BASE, (3, 60)),
        ((math.nan, 0, 0, 0, 0, 0), BASE, (3, 59)),
        ((0.1, 0, 0, 0, 0, 0), 7, (3, 3)),
    ],
)
def test_a_twist_that_the_arm_does_not_have_is_refused(
    values: tuple[float, ...], frame: int, error: tuple[int, int]
) -> None:
    world = World()
    assert world.refusal(TWIST, twist(values, frame)) == error
    world.run(0.5)
    assert near(world.degrees(), HOME, 0.1)


def test_near_a_singular_position_no_joint_becomes_too_fast() -> None:
    world = World()
    world.call(TWIST, twist((0.4, 0, 0, 0, 0, 0), BASE))
    fastest = [0.0] * 7

    def look() -> None:
        speeds = world.base.plant.velocity_rad_s
        fastest[:] = [max(a, abs(b)) for a, b in zip(fastest, speeds, strict=True)]

    world.run(4.0, look)
    assert max(fastest[:4]) < 1.45 and max(fastest[4:]) < 1.3
    assert world.state() == 7


@pytest.mark.parametrize("joint", [3, 5])
def test_a_joint_stops_at_its_limit_without_a_fault(joint: int) -> None:
    world = World()
    world.call(SPEEDS, joint_speeds([40.0 * (each == joint) for each in range(7)]))
    world.run(8.0)
    _, high = world.base.arm._ranges[joint]
    assert world.base.plant.position_rad[joint] == pytest.approx(high, abs=5e-3)
    assert world.state() == 7 and world.faults() == (0, [0] * 7)
    world.call(SPEEDS, joint_speeds([-20.0 * (each == joint) for each in range(7)]))
    world.run(1.0)
    assert world.base.plant.position_rad[joint] < high - 0.2


def test_the_tool_stops_where_a_joint_is_at_its_limit_and_may_come_back() -> None:
    world = World()
    start, turn = world.tool_m(), world.pose()[3:]
    world.call(TWIST, twist((-0.05, 0, 0, 0, 0, 0), BASE))
    world.run(3.0)
    low, _ = world.base.arm._ranges[3]
    assert world.base.plant.position_rad[3] == pytest.approx(low, abs=5e-3), "the elbow is folded"
    there = world.tool_m()
    assert np.allclose((there - start)[1:], 0.0, atol=2e-3) and near(world.pose()[3:], turn)
    world.run(2.0)
    assert np.allclose(world.tool_m(), there, atol=1e-4) and world.state() == 7
    world.call(TWIST, twist((0.05, 0, 0, 0, 0, 0), BASE))
    world.run(1.0)
    assert world.tool_m()[0] - there[0] > 0.04


def test_a_joint_at_its_limit_leaves_the_motion_to_the_others_if_they_can() -> None:
    world = World()
    jacobian = world.base.kinematics.jacobian(world.base.arm.target)[1]
    # The speeds of this motion turn the first joint, and others can turn in its place.
    motion = jacobian @ np.array((0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    world.base.arm._ranges[0] = (world.base.arm.target[0] - 1.0, world.base.arm.target[0])
    world.base.arm.set_twist(motion, (False, False))
    wanted = np.array(world.base.arm._commanded_rates())
    assert wanted[0] == 0.0 and np.allclose(jacobian @ wanted, motion, atol=5e-3) and abs(wanted[2]) > 0.01


def test_a_command_of_velocity_aborts_an_action() -> None:
    world = World()
    world.watch_actions()
    world.call(EXECUTE_ACTION, reach_angles((10.0, *HOME[1:])))
    world.run(0.5)
    world.call(TWIST, twist((0, 0, 0.02, 0, 0, 0), BASE))
    assert world.events()[-1] == ABORT


def test_the_limits_can_be_read() -> None:
    world = World()
    limits = [real_of(each, 3) for each in messages(world.call(0x200B7), 1)]
    assert limits == pytest.approx([80.0] * 4 + [70.0] * 3, abs=0.1)
    twist_limits = world.call(0x200B9)
    assert (real_of(twist_limits, 1), real_of(twist_limits, 2)) == (0.5, 100.0)
