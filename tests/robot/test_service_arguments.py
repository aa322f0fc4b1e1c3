"""A service accepts arguments by position or by name, and connects by itself, as ``send_action`` does."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.verbs import name_values
from strands_actors.caller.resolve.planning import plan
from strands_actors.kernel.messages import Refused
from tests.answers import json_of, state, why


@pytest.mark.parametrize(
    ("robot", "service", "values", "named", "expected"),
    [
        ("spot", "set_twist", (0.3, 0.0, 0.1), {}, {"vx": 0.3, "vy": 0.0, "wz": 0.1}),
        ("stretch3", "set_twist", (0.1, 0.2), {}, {"vx": 0.1, "wz": 0.2}),
        ("crazyflie", "takeoff", (0.5,), {"duration": 2.0}, {"height": 0.5, "duration": 2.0}),
        ("unitree_go2", "release_sport_mode", (3,), {}, {"attempts": 3}),
        ("earthrover", "speak", (), {"text": "hello"}, {"text": "hello"}),
    ],
)
def test_arguments_may_be_given_by_position(
    robot: str, service: str, values: tuple[Any, ...], named: dict[str, Any], expected: dict[str, Any]
) -> None:
    assert name_values(plan(robot, "real", transport="twin"), service, values, named) == expected


@pytest.mark.parametrize(
    ("service", "values", "named", "text"),
    [
        ("takeoff", (0.5, 2.0, 1.0), {}, "takeoff: 3 values were given. It takes height, duration"),
        ("takeoff", (0.5,), {"height": 0.4}, "takeoff: height is given twice. It takes height, duration"),
        ("emergency_stop", (1,), {}, "emergency_stop: 1 values were given. It takes no arguments"),
    ],
)
def test_too_many_arguments_are_refused_with_the_accepted_ones(
    service: str, values: tuple[Any, ...], named: dict[str, Any], text: str
) -> None:
    refusal = name_values(plan("crazyflie", "real", transport="twin"), service, values, named)
    assert isinstance(refusal, Refused) and refusal.text == text


def test_a_service_connects_by_itself_and_a_stop_does_not() -> None:
    drone = Robot("crazyflie", mode="real", transport="twin")
    try:
        assert "not connected" in why(drone.emergency_stop())
        assert "It takes height, duration" in why(drone.takeoff(0.5, 2.0, 1.0))
        assert drone.tree() is None, "a refused service does not connect"
        json_of(drone.takeoff(0.5))
        assert state(drone) == "armed"
    finally:
        drone.cleanup()
