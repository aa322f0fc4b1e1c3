"""An agent carries a cube in simulation by ``get_pose`` and ``move_to`` alone, as the example does."""

from __future__ import annotations

import runpy
from typing import Any

import pytest

from tests.cli.command import ROOT

OFF_M = 0.015
"""The tool of an SO-101 ends some millimetres off its goal, and the cube slides a little between the fingers."""


def place_of_cube(arm: Any) -> tuple[float, ...]:
    """Return the position of the cube, which is the last body of the scene."""
    qpos: tuple[float, ...] = arm._call(arm._world.pose).qpos
    return qpos[-7:-4]


@pytest.mark.parametrize("name", ["so101", "ur5e"])
def test_an_agent_picks_a_cube_up_and_puts_it_down_10_cm_to_the_left(name: str) -> None:
    example = runpy.run_path(str(ROOT / "examples" / "pick_and_place.py"))
    with example["robots"](name) as tools:
        x, y, z = place_of_cube(tools[0])
        assert example["carry"](name, tools) == []
        moved = place_of_cube(tools[0])
    assert moved == pytest.approx((x, y + example["LEFT_M"], z), abs=OFF_M)
