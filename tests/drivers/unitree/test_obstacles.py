"""Test the service ``obstacles_avoid`` of a Go2's twin, on a clock that the test controls."""

from __future__ import annotations

import json
import math

import pytest

from strands_actors.drivers.common.physics.scenery import Object
from strands_actors.drivers.unitree import rpc
from strands_actors.drivers.unitree.rpc import Request
from strands_actors.drivers.unitree.twin import obstacles as o
from strands_actors.drivers.unitree.twin.gait import REST
from strands_actors.drivers.unitree.twin.standing import StandingBody
from strands_actors.drivers.unitree.walking.sport import LIE

from .test_twin import Twin

WALL_M = 1.5
"""Distance of the wall from the middle of the robot."""


def dog(wall_deg: float | None = None) -> Twin:
    """Return a Go2 that clients walk by the service, with a wall in this direction."""
    twin = Twin("unitree_go2", keeps_s=0.0)
    if wall_deg is not None:
        turn = math.radians(wall_deg)
        place = (WALL_M * math.cos(turn), WALL_M * math.sin(turn), 0.5)
        half = turn / 2.0
        wall = Object(
            "wall",
            "box",
            place,
            (math.cos(half), 0.0, 0.0, math.sin(half)),
            (0.1, 3.0, 1.0),
            (1.0,) * 4,
            50.0,
            True,
        )
        StandingBody(twin.onboard).scenery.add_object(wall)
    assert twin.ask(o.SERVICE, o.USE_REMOTE, is_remote_commands_from_api=True) == (0, {})
    return twin


def place_of(twin: Twin) -> tuple[float, float, float]:
    assert twin.onboard.gait is not None
    x, y = twin.onboard.gait.position
    return x, y, twin.onboard.gait.heading_rad


def move(twin: Twin, x: float, y: float, yaw: float, mode: int = o.VELOCITY) -> None:
    assert twin.ask(o.SERVICE, o.MOVE, x=x, y=y, yaw=yaw, mode=mode) == (0, {})


@pytest.mark.parametrize(("twist", "wall_deg"), [((0.5, 0.0), 0.0), ((-0.5, 0.0), 180.0), ((0.0, 0.5), 90.0)])
def test_it_stops_before_an_obstacle(twist: tuple[float, float], wall_deg: float) -> None:
    twin = dog(wall_deg)
    assert twin.ask(o.SERVICE, o.SWITCH_SET, enable=True) == (0, {})
    assert twin.ask(o.SERVICE, o.SWITCH_GET) == (0, {"enable": True})
    move(twin, *twist, 0.0)
    twin.run(4.0)
    far_m = math.hypot(*place_of(twin)[:2])
    assert 0.4 < far_m < WALL_M - o.STOP_M and twin.onboard.gait is not None and twin.onboard.gait.twist == REST
    move(twin, *twist, 0.0)
    twin.run(0.5)
    assert math.hypot(*place_of(twin)[:2]) == pytest.approx(far_m, abs=0.01), "it does not begin to walk again"
    move(twin, -twist[0], -twist[1], 0.0)
    twin.run(0.5)
    assert math.hypot(*place_of(twin)[:2]) == pytest.approx(far_m - 0.25, abs=0.02), "it may walk away"


def test_without_the_switch_it_walks_on() -> None:
    twin = dog(0.0)
    assert twin.ask(o.SERVICE, o.SWITCH_GET) == (0, {"enable": False})
    move(twin, 0.5, 0.0, 0.0)
    twin.run(2.2)
    assert place_of(twin)[0] == pytest.approx(1.1, abs=0.02)


def test_the_service_sport_does_not_avoid_obstacles() -> None:
    twin = dog(0.0)
    twin.ask(o.SERVICE, o.SWITCH_SET, enable=True)
    twin.ask("sport", rpc.MOVE, x=0.6, y=0.0, z=0.0)
    twin.run(2.0)
    assert place_of(twin)[0] == pytest.approx(1.2, abs=0.02)


def test_a_move_has_no_effect_before_the_remote_is_taken_over_and_ends_when_it_is_returned() -> None:
    twin = Twin("unitree_go2", keeps_s=0.0)
    move(twin, 0.5, 0.0, 0.0)
    twin.run(0.5)
    assert place_of(twin) == (0.0, 0.0, 0.0)
    twin.ask(o.SERVICE, o.USE_REMOTE, is_remote_commands_from_api=True)
    move(twin, 0.5, 0.0, 0.0)
    twin.run(0.5)
    twin.ask(o.SERVICE, o.USE_REMOTE, is_remote_commands_from_api=False)
    twin.run(0.5)
    assert place_of(twin)[0] == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize(("mode", "x", "y"), [(o.ABSOLUTE, 1.0, 0.5), (o.INCREMENT, 0.0, 1.0)])
def test_it_walks_to_a_place(mode: int, x: float, y: float) -> None:
    twin = dog()
    move(twin, 0.0, 0.0, math.pi / 2, o.ABSOLUTE)
    twin.run(4.0)
    assert place_of(twin) == pytest.approx((0.0, 0.0, math.pi / 2), abs=0.1)
    move(twin, 1.0, 0.5, -1.0, mode)
    twin.run(6.0)
    # An increment counts in the robot's frame, which is turned to the left: forward is y.
    heading = -1.0 if mode == o.ABSOLUTE else math.pi / 2 - 1.0
    there = (x, y) if mode == o.ABSOLUTE else (-0.5, 1.0)
    assert place_of(twin) == pytest.approx((*there, heading), abs=0.1)
    assert twin.onboard.gait is not None and twin.onboard.gait.twist == REST


def test_a_robot_that_lies_does_not_walk() -> None:
    twin = dog()
    assert twin.onboard.gait is not None
    twin.onboard.gait.become(LIE)
    move(twin, 0.5, 0.0, 0.0)
    twin.run(0.5)
    assert place_of(twin) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("api", "parameter", "code"),
    [
        (o.SWITCH_SET, '{"enable": 1}', rpc.BAD_DATA),
        (o.SWITCH_SET, "", rpc.BAD_DATA),
        (o.USE_REMOTE, '{"enable": true}', rpc.BAD_DATA),
        (o.MOVE, '{"x": 0.1, "y": 0.0, "yaw": 0.0, "mode": 3}', rpc.BAD_DATA),
        (o.MOVE, '{"x": "far"}', rpc.BAD_DATA),
        (1005, "", rpc.NOT_IMPLEMENTED),
        (rpc.SERVER_VERSION, "", rpc.OK),
    ],
)
def test_the_answers_of_the_service(api: int, parameter: str, code: int) -> None:
    answer = dog().onboard.serve(o.SERVICE, Request(1, api, parameter))
    assert answer is not None and answer.code == code
    if api == rpc.SERVER_VERSION:
        assert json.loads(answer.data) == "1.0.0.2"


def test_only_a_go2_has_the_service() -> None:
    have = [
        robot
        for robot in ("unitree_go2", "b2", "unitree_g1", "unitree_h1")
        if o.SERVICE in Twin(robot).onboard.services
    ]
    assert have == ["unitree_go2"]
