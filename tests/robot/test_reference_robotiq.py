"""Behaviours of a gripper that the tests of strands-robots require, tested on one twin through the public
names.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, status, until, why

from .test_reference_feetech import ask

VERBS = ["open", "close", "move_to", "sensors", "status", "stop"]


@pytest.fixture(scope="module")
def twin_2f85(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("robotiq_2f85", tmp_path_factory.mktemp("2f85"), options={"activation_s": 0.2}) as twin:
        yield twin


@pytest.fixture(scope="module")
def gripper(twin_2f85: Twin) -> Iterator[RealRobot]:
    robot = Robot("robotiq_2f85", mode="real", port=twin_2f85.port)
    # before it is connected, because an agent's verb does not connect
    for verb in ("open", "close", "sensors"):
        assert "not connected" in why(ask(robot, action=verb))
    assert json_of(ask(robot, action="status"))["connected"] is False
    assert dict(robot.get_observation()) == {}
    assert robot.connect_eagerly() is None
    yield robot
    robot.cleanup()
    robot.cleanup()
    assert not robot.is_connected


def at(gripper: RealRobot, closed: float) -> None:
    """Wait until the fingers are there. The pads touch a little before either end of the counts."""
    until(lambda: abs(gripper.get_observation().get("gripper", 9.0) - closed) < 0.15, f"it is at {closed}")


def test_connecting_activates_the_gripper(gripper: RealRobot, twin_2f85: Twin) -> None:
    assert gripper.is_connected and status(gripper)["sensors"]["activation"] == [3.0]
    assert "enable" in [entry.kind for entry in twin_2f85.log.entries()]
    assert gripper.connect_eagerly() is None
    json_of(gripper.send_action({"gripper": 1.0}))
    at(gripper, 1.0)


@pytest.mark.parametrize(
    ("action", "position", "aperture_mm"),
    [
        ({"gripper": 0.0}, 0, 85.0),
        ({"gripper": 1.0}, 255, 0.0),
        ({"gripper": 0.5}, 128, pytest.approx(42.5, abs=0.3)),
        ({"gripper.pos": 0.0}, 0, 85.0),
        ({"gripper.pos": 1.0}, 255, 0.0),
        ({"position": 85.0}, 0, 85.0),
        ({"position": 0.0}, 255, 0.0),
        ({"aperture_mm": 40.0}, 135, pytest.approx(40.0, abs=0.4)),
        ({"aperture_mm": 0.0}, 255, 0.0),
    ],
)
def test_every_key_commands_the_position_that_it_names(
    gripper: RealRobot, action: dict[str, float], position: int, aperture_mm: Any
) -> None:
    sent = json_of(gripper.send_action(action))
    assert (sent["position"], sent["aperture_mm"], sent["robot"]) == (position, aperture_mm, "robotiq_2f85")


def test_speed_and_force_are_fractions_and_are_sent_as_counts(gripper: RealRobot) -> None:
    sent = json_of(gripper.send_action({"gripper": 1.0, "speed": 0.0, "force": 0.5}))
    assert (sent["speed"], sent["force"]) == (0, 128)
    sent = json_of(gripper.send_action({"gripper": 1.0}))
    assert (sent["speed"], sent["force"]) == (255, 255)


@pytest.mark.parametrize(
    ("action", "says"),
    [
        ({"gripper": 0.0, "position": 10.0}, "are both given"),
        ({"gripper": 0.0, "gripper.pos": 1.0}, "are both given"),
        ({"position": 85.0, "aperture_mm": 0.0}, "are both given"),
        ({"wrist_flex": 0.2}, "wrist_flex is not a key"),
        ({}, "has no position"),
        ({"speed": 0.5}, "has no position"),
        ({"gripper": float("nan")}, "gripper is nan"),
        ({"gripper": "shut"}, "gripper is shut"),
        ({"gripper": True}, "gripper is True"),
    ],
)
def test_an_invalid_action_is_refused_in_an_envelope(gripper: RealRobot, action: dict[str, Any], says: str) -> None:
    assert says in why(gripper.send_action(action))


def test_an_action_for_another_robot_and_a_policy_are_refused(gripper: RealRobot) -> None:
    assert "robot_name is 'so101'" in why(gripper.send_action({"gripper": 0.0}, robot_name="so101"))
    json_of(gripper.send_action({"gripper": 0.0}, robot_name=gripper.robot_name))
    assert "send_action" in why(gripper.run_policy(lambda seen: {"gripper": 0.0}))
    assert why(gripper.start_task("pick up the cube")).startswith("start_task")


def test_after_closing_on_nothing_the_gripper_reports_that_it_holds_nothing(gripper: RealRobot) -> None:
    json_of(gripper.send_action({"gripper": 1.0}))
    at(gripper, 1.0)
    until(lambda: status(gripper)["holding"] is False, "the status says that it holds nothing")
    assert gripper.get_observation()["gripper.pos"] == pytest.approx(1.0, abs=0.15)
    assert json_of(gripper.state())["aperture_mm"] == pytest.approx(0.0, abs=13.0)


def test_an_agents_verbs_are_those_of_the_schema(gripper: RealRobot) -> None:
    spec = gripper.tool_spec
    assert spec["name"] == "robotiq_2f85"
    action = spec["inputSchema"]["json"]["properties"]["action"]
    assert action["enum"] == VERBS and all(f"{verb}:" in action["description"] for verb in VERBS)
    assert json_of(ask(gripper, action="open"))["aperture_mm"] == 85.0
    at(gripper, 0.0)
    assert json_of(ask(gripper, action="close"))["aperture_mm"] == 0.0
    at(gripper, 1.0)
    assert json_of(ask(gripper, action="sensors"))["sensors"]["aperture_mm"] == [pytest.approx(0.0, abs=13.0)]
    writes = status(gripper)["writes"]
    for other in ("home", "sensor", ""):
        refusal = why(ask(gripper, action=other))
        assert repr(other) in refusal and ", ".join(VERBS) in refusal
    assert status(gripper)["writes"] - writes <= 1  # the last command may be resent


def test_a_stop_keeps_the_gripper_activated_at_its_position(gripper: RealRobot) -> None:
    json_of(gripper.send_action({"gripper": 0.0}))
    at(gripper, 0.0)
    json_of(gripper.send_action({"gripper": 1.0, "speed": 0.0}))
    until(lambda: gripper.get_observation()["gripper"] > 0.05, "the gripper closes")
    stopped = json_of(ask(gripper, action="stop"))
    assert stopped["stopped"] and stopped["safe_state"] == "hold"
    assert status(gripper)["sensors"]["activation"] == [3.0]
    assert gripper.get_observation()["gripper"] < 0.9
    json_of(gripper.resume())
    assert json_of(gripper.stop_task())["stopped"] is True
