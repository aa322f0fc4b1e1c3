"""Test the kinematics of the simulated base."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .kortex_client import blob, messages, real_of
from .world import HOME, World, angles, near, numbers

FORWARD, INVERSE = 0x200E9, 0x200EA
OTHERS = (HOME, (30.0, 340.0, 150.0, 260.0, 40.0, 300.0, 10.0), (280.0, 60.0, 10.0, 90.0, 200.0, 60.0, 120.0))


def forward(world: World, degrees: tuple[float, ...]) -> list[float]:
    fields = world.call(FORWARD, angles(degrees))
    return [real_of(fields, field) for field in range(1, 7)]


def test_home_has_the_pose_that_the_vendors_examples_show() -> None:
    world = World()
    assert forward(world, HOME) == pytest.approx([0.577, 0.001, 0.434, 90.0, 0.0, 90.0], abs=5e-3)
    assert world.pose() == pytest.approx(forward(world, HOME), abs=5e-3)


@pytest.mark.parametrize("degrees", OTHERS)
def test_the_inverse_finds_the_angles_near_a_guess(degrees: tuple[float, ...]) -> None:
    world = World()
    pose = forward(world, degrees)
    guess = tuple(angle - 1.0 for angle in degrees)
    answer = world.call(INVERSE, blob(1, numbers(pose)) + blob(2, angles(guess, identifiers=False)))
    found = tuple(real_of(angle, 2) for angle in messages(answer, 1))
    assert near(found, degrees, 2.0)
    again = forward(world, found)
    assert np.allclose(again[:3], pose[:3], atol=1e-3) and near(again[3:], pose[3:], 0.2)


def test_what_has_no_solution_is_an_error() -> None:
    world = World()
    away = numbers((2.0, 0.0, 0.4, 90.0, 0.0, 90.0))
    assert world.refusal(INVERSE, blob(1, away) + blob(2, angles(HOME))) == (3, 56)
    here = numbers(world.pose())
    assert world.refusal(INVERSE, blob(1, here) + blob(2, angles(HOME[:6]))) == (3, 57)
    assert world.refusal(FORWARD, angles(HOME[:6])) == (3, 57)
    assert world.refusal(FORWARD, angles((math.nan, *HOME[1:]))) == (3, 3)
    assert near(world.degrees(), HOME)
