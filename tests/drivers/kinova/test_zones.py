"""Test the protection zones of the simulated base: no motion of the tool enters them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from .kortex_client import inside, joint_speeds, messages, number, whole
from .world import ABORT, END, EXECUTE_ACTION, TWIST, World, reach_pose, sphere, twist, zone

CREATE, READ, DELETE, READ_ALL = 0x20014, 0x20016, 0x20017, 0x20018
SPEEDS, BASE = 0x20084, 3
CYLINDER, PRISM = 1, 3
ASIDE = np.array(((0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
"""A quarter of a turn about z."""


def below(world: World, distance_m: float = 0.1, radius_m: float = 0.05, on: int = 1) -> bytes:
    """Return a sphere below the tool, with its surface at this distance."""
    x, y, z = world.tool_m()
    return sphere((x, y, z - distance_m - radius_m), radius_m, on)


def sink(world: World, seconds: float = 6.0) -> float:
    """Move the tool down for some time, and return the way in m."""
    start = world.tool_m()[2]
    world.call(TWIST, twist((0, 0, -0.05, 0, 0, 0), BASE))
    world.run(seconds)
    return float(start - world.tool_m()[2])


def test_a_velocity_stops_before_a_zone_and_may_leave_it() -> None:
    world = World()
    world.call(CREATE, below(world))
    assert sink(world) == pytest.approx(0.1, abs=4e-3)
    assert world.state() == 7 and world.faults() == (0, [0] * 7)
    world.call(TWIST, twist((0, 0, 0.05, 0, 0, 0), BASE))
    before = world.tool_m()[2]
    world.run(1.0)
    assert world.tool_m()[2] - before > 0.04


def test_joint_speeds_stop_before_a_zone() -> None:
    world = World()
    world.call(CREATE, below(world))
    world.call(SPEEDS, joint_speeds([10.0 * (joint == 1) for joint in range(7)]))
    world.run(6.0)
    assert world.pose()[2] > 0.25


def test_a_tool_in_a_zone_may_leave_it() -> None:
    world = World()
    world.call(CREATE, sphere(world.tool_m().tolist(), 0.1))
    assert sink(world, 4.0) == pytest.approx(0.2, abs=0.01)


def test_an_action_into_a_zone_is_aborted() -> None:
    world = World()
    world.watch_actions()
    world.call(CREATE, below(world))
    x, y, z, *turn = world.pose()
    world.call(EXECUTE_ACTION, reach_pose((x, y, z - 0.2, *turn)))
    assert (world.finish()[-1], world.abort_details) == (ABORT, 53)
    assert world.tool_m()[2] > z - 0.105


@pytest.mark.parametrize("how", ["disabled", "deleted"])
def test_a_zone_that_does_not_count_stops_nothing(how: str) -> None:
    world = World()
    world.watch_actions()
    made = world.call(CREATE, below(world, on=int(how == "deleted")))
    if how == "deleted":
        world.call(DELETE, number(1, whole(made, 1)))
    x, y, z, *turn = world.pose()
    world.call(EXECUTE_ACTION, reach_pose((x, y, z - 0.2, *turn)))
    assert world.finish()[-1] == END


def test_prisms_and_cylinders_have_their_shape_and_their_orientation() -> None:
    for shape, dimensions, stops in (
        (PRISM, (0.05, 0.4, 0.1), True),
        (PRISM, (0.4, 0.05, 0.1), False),
        (CYLINDER, (0.2, 0.1), True),
        (CYLINDER, (0.05, 0.1), False),
    ):
        world = World()
        x, y, z = world.tool_m()
        # It is 0.1 m aside along x of the base, which is along y of the zone turned by a quarter.
        world.call(CREATE, zone(shape, (x + 0.1, y, z - 0.15), dimensions, ASIDE))
        assert sink(world) == pytest.approx(0.1 if stops else 0.3, abs=0.012), (shape, dimensions)


def test_zones_are_read_and_deleted() -> None:
    world = World()
    payload = sphere((1.0, 2.0, 3.0), 0.5)
    handle = number(1, whole(world.call(CREATE, payload), 1))
    assert len(messages(world.call(READ_ALL), 1)) == 1
    read = world.call(READ, handle)
    assert (read[2], whole(read, 4), whole(inside(read, 5), 1)) == ([b"a zone"], 1, 2)
    world.call(DELETE, handle)
    assert world.call(READ_ALL) == {}
    for function in (READ, DELETE):
        assert world.refusal(function, handle) == (3, 17)


@pytest.mark.parametrize(
    "payload",
    [
        zone(2, (0, 0, 0), (0.1, 0.1)),
        zone(2, (0, 0, 0), (0.0,)),
        zone(9, (0, 0, 0), (0.1,)),
        zone(2, (0, 0, 0), (0.1,), 2.0 * np.eye(3)),
        zone(2, (math.nan, 0, 0), (0.1,)),
        b"",
    ],
)
def test_a_zone_that_is_none_is_refused(payload: bytes) -> None:
    world = World()
    assert world.refusal(CREATE, payload) == (3, 3)
    assert world.call(READ_ALL) == {}
