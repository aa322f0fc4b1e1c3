"""Simulated robots with legs: the twin's onboard controller keeps them standing, and commanded joints
follow, with torques as on the real wire.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import SimRobot
from strands_actors.testing import WireLog
from tests.answers import json_of, task_ended, until, why

LEGS = {
    "unitree_g1": "left_elbow",
    "unitree_h1": "left_elbow",
    "unitree_h1_2": "left_elbow_joint",
    "unitree_go2": "FR_hip_joint",
    "b2": "FR_hip_joint",
}


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "wire.ndjson"
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(path))
    return path


def events(log: Path) -> list[str]:
    """Return the robot's own events, such as ``fell`` and ``stood``."""
    return [entry.kind for entry in WireLog(log).entries() if entry.sender == "robot"]


@pytest.fixture
def g1(run_dir: Path, log: Path) -> Iterator[SimRobot]:
    with Robot("unitree_g1") as sim:
        yield sim


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("robot", LEGS)
def test_a_simulated_robot_stands_and_a_commanded_joint_moves(run_dir: Path, log: Path, robot: str) -> None:
    joint = LEGS[robot]
    with Robot(robot) as sim:
        began = sim.get_observation()
        goal = began[joint] + 0.3
        json_of(sim.send_action({joint: goal}))
        until(lambda: abs(sim.get_observation()[joint] - goal) < 0.06, "the joint is there")
        json_of(sim.step(1000))
        assert abs(sim.get_observation()[joint] - goal) < 0.06, "a command holds until the next one"
        others = {axis: value for axis, value in sim.get_observation().items() if axis != joint}
        assert all(abs(value - began[axis]) < 0.2 for axis, value in others.items())
        assert sim.render(64, 48).shape == (48, 64, 3)
        assert json_of(sim.reset())["position"][joint] == pytest.approx(began[joint], abs=0.05)
        json_of(sim.stop())
        json_of(sim.step(1000))
    assert "fell" not in events(log)


def test_torques_act_as_on_the_real_wire(g1: SimRobot, log: Path) -> None:
    began = g1.get_observation()["left_elbow"]
    json_of(g1.send_action({"left_elbow": {"q": 0.0, "kp": 0.0, "kd": 1.0, "tau": 4.0}}))
    json_of(g1.step(200))
    pushed = g1.get_observation()["left_elbow"]
    assert pushed > began + 0.2, "a torque alone turns the joint"
    json_of(g1.send_action({"left_elbow": {"q": began, "kp": 60.0, "kd": 2.0}}))
    json_of(g1.step(1000))
    assert g1.get_observation()["left_elbow"] == pytest.approx(began, abs=0.1)
    assert "is not a joint" in why(g1.send_action({"left_toe": 0.0}))
    assert "Use q, dq, tau, kp, kd" in why(g1.send_action({"left_elbow": {"q": 0.0, "speed": 1.0}}))
    assert "fell" not in events(log)


def test_without_torque_on_every_joint_the_robot_falls(g1: SimRobot, log: Path) -> None:
    limp: dict[str, Any] = {axis: {"q": 0.0, "kp": 0.0, "kd": 0.0} for axis in g1.get_observation()}
    json_of(g1.send_action(limp))
    json_of(g1.step(1500))
    until(lambda: "fell" in events(log), "the robot falls")
    json_of(g1.reset())
    json_of(g1.step(500))
    assert events(log).count("fell") == 1, "after the reset the robot stands"


def test_after_a_policy_has_moved_an_arm_the_robot_still_stands(g1: SimRobot, log: Path) -> None:
    began = g1.get_observation()["right_elbow"]
    json_of(g1.run_policy(lambda seen: {"right_elbow": began + 0.2}, n_steps=100))
    assert task_ended(g1)["exit_reason"] == "n_steps"
    time.sleep(0.5)  # longer than a streamed setpoint lives, so it ends in a hold under the onboard controller
    assert json_of(g1.get_status())["state"] in ("holding", "armed")
    json_of(g1.send_action({"right_elbow": began}))
    assert "fell" not in events(log)


def test_the_real_driver_on_its_wire_takes_control_and_returns_it(g1: SimRobot, log: Path) -> None:
    json_of(g1.send_action({"left_elbow": 0.3}))
    with Robot("unitree_g1", mode="real", transport="twin", sim=g1) as real:
        for _ in range(20):
            json_of(real.send_action({"left_elbow": real.get_observation()["left_elbow"]}))
        assert "held by the robot on its wire" in why(g1.send_action({"left_elbow": 0.0}))
        json_of(real.stop())
    json_of(g1.reset())
    json_of(g1.send_action({"left_elbow": 0.2}))
    until(lambda: abs(g1.get_observation()["left_elbow"] - 0.2) < 0.06, "the simulation commands the joint again")
