"""What the tests of strands-robots assert of its factory and its registry, as behaviours of ours: each
is tried through the public names alone, without a robot."""

from __future__ import annotations

from typing import Any

import pytest

from strands_actors import HardwareDriver, Robot, list_native_drivers, list_robots, register_native_driver
from strands_actors.drivers import DRIVER_SURFACE, get_native_driver_class, resolve_driver

ARM = {"mode": "real", "port": "/dev/ttyACM0"}
GRIPPER = {"mode": "real", "port": "192.0.2.20"}
UR = {"mode": "real", "port": "192.0.2.30"}
G1 = {"mode": "real", "port": "192.168.123.161"}
NAN = float("nan")


class Half:
    """Too little for a driver."""

    SUPPORTED_ROBOTS = ("half_robot",)


@pytest.mark.parametrize(
    ("robot", "keywords", "says"),
    [
        ("so101", {"driver": "vendor"}, "vendor"),
        ("so101", {**ARM, "driver": "vendor"}, "vendor"),
        ("so101", {**ARM, "transport": "carrier"}, "carrier"),
        ("so101", {"baud_rate": 1_000_000}, "baud"),
        ("ability_hand", {**ARM, "driver": "strands"}, "ability_hand"),
        ("robotiq_2f85", {**GRIPPER, "unit_id": 300}, "unit_id"),
        ("robotiq_2f85", {**GRIPPER, "stroke_mm": 0}, "stroke_mm"),
        ("robotiq_2f85", {**GRIPPER, "speed": "fast"}, "speed"),
        ("ur5e", {**UR, "control_frequency": 0}, "control_frequency"),
        ("ur5e", {**UR, "control_frequency": float("inf")}, "control_frequency"),
        ("ur5e", {**UR, "control_frequency": True}, "control_frequency"),
        ("ur5e", {**UR, "model": "ur99"}, "model"),
        ("unitree_g1", {**G1, "battery_floor_pct": NAN}, "battery_floor_pct"),
        ("unitree_g1", {**G1, "battery_floor_pct": 101}, "battery_floor_pct"),
        ("unitree_g1", {**G1, "battery_floor_pct": True}, "battery_floor_pct"),
        ("so101", {**ARM, "timeout": 0}, "timeout"),
        ("so101", {**ARM, "motor_ids": (1, 1)}, "motor_ids"),
        ("so101", {**ARM, "motor_ids": (0, 254)}, "motor_ids"),
    ],
)
def test_what_cannot_be_used_is_refused_when_the_robot_is_made(
    robot: str, keywords: dict[str, Any], says: str
) -> None:
    with pytest.raises((ValueError, TypeError), match=says):
        Robot(robot, **keywords)


def test_the_registry_is_one() -> None:
    assert set(list_native_drivers()) <= set(list_robots())
    assert get_native_driver_class("g1") is get_native_driver_class("unitree_g1")
    assert {resolve_driver(robot) for robot in list_native_drivers()} == {"strands"}
    assert resolve_driver("so101", "lerobot") == "lerobot"


def test_a_class_without_the_members_of_a_driver_is_refused_and_they_are_named() -> None:
    with pytest.raises(TypeError, match="send_action"):
        register_native_driver("half_robot", Half)
    assert not isinstance(Half(), HardwareDriver)
    assert not [name for name in DRIVER_SURFACE if name.startswith("_")]


def test_without_a_robot_every_verb_answers_in_an_envelope() -> None:
    gripper = Robot("robotiq_2f85", **GRIPPER)
    assert isinstance(gripper, HardwareDriver)
    answers: list[Any] = [
        gripper.send_action({"gripper": 0.5, "aperture_mm": 3.0}),
        gripper.run_policy(lambda seen: {}),
        gripper.start_task("close it"),
        gripper.get_task_status(),
        gripper.stop_task(),
        dict(gripper.get_status()),
    ]
    assert [answer["status"] for answer in answers[:3]] == ["error"] * 3
    assert all(isinstance(answer["content"], list) for answer in answers)


def test_every_robot_that_strands_robots_knows_is_known_here() -> None:
    """By name at least: one without a driver says so, and how it simulates all the same."""
    assert {"aloha", "anymal_c", "openarm", "wx250s", "z1"} <= set(list_robots())
    with pytest.raises(ValueError, match=r"aloha has no native driver. a model of it simulates: register_robot"):
        Robot("aloha")
    assert resolve_driver("openarm") == "lerobot"
