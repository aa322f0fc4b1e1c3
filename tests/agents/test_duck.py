"""A simulated robot with two legs walks by a network of the Microduck community's form, and stands when its policy
ends or dies."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import SimRobot
from tests.answers import json_of, pids, task_ended, until, why

from . import small_duck
from .tiny_onnx import constant, linear

STILT = """<mujoco><compiler angle="radian"/><worldbody><geom type="plane" size="0 0 .1"/>
  <body name="trunk" pos="0 0 .211"><freejoint/>
   <geom type="box" size=".03 .03 .03" mass=".3" contype="0" conaffinity="0"/>
   <body pos="0 0 -.2"><joint name="ankle" axis="0 1 0" range="-1 1" damping=".02"/>
    <geom type="box" size=".08 .05 .005" pos="0 0 -.005" mass=".1"/></body></body></worldbody>
  <actuator><position joint="ankle" kp=".3" kv=".02"/></actuator>
  <keyframe><key name="leaning" qpos="0 0 .211 .9998 0 .02 0 0"/></keyframe></mujoco>"""
"""A weight on a stick with one ankle. The servo is too soft to hold it upright, as the servos of a duck are."""

BALANCE = {
    "format": "strands-actors-onnx", "version": 1, "file": "policy.onnx", "control_hz": 100,
    "joints": [{"name": "ankle", "unit": "rad"}],
    "observation": [{"block": "gravity"}, {"block": "sensor", "key": "gyro_rad_s", "size": 3}],
    "action": {"kind": "absolute", "clip": True},
}  # fmt: skip


@pytest.fixture
def duck(run_dir: Path, tmp_path: Path) -> Iterator[SimRobot]:
    model, _ = small_duck.write(tmp_path)
    with Robot("duck", urdf_path=model) as robot:
        assert isinstance(robot, SimRobot)
        yield robot


def forward_m(robot: SimRobot) -> float:
    forward: float = json_of(robot.state())["base_xyz_m"][0]
    return forward


def stands(robot: SimRobot, height_m: float) -> bool:
    state = json_of(robot.state())
    return bool(state["base_xyz_m"][2] > height_m and max(map(abs, state["rpy_rad"][:2])) < 0.3)


def test_a_skill_of_schema_2_walks_and_the_duck_stands_when_its_policy_is_killed(
    duck: SimRobot, tmp_path: Path
) -> None:
    began_m = forward_m(duck)
    done = json_of(duck.run(tmp_path / "walk", seconds=2.0))
    assert (done["exit_reason"], done["refused"], done["unconfirmed"]) == ("duration", 0, [])
    walked_m = forward_m(duck)
    assert walked_m > began_m + 0.03 and stands(duck, 0.08)
    json_of(duck.start_task("", policy_provider="onnx", folder=str(tmp_path / "walk"), control_frequency=50.0))
    until(lambda: forward_m(duck) > walked_m + 0.02, "it walks again")
    os.kill(pids(duck)["policy"], signal.SIGKILL)
    task_ended(duck)
    time.sleep(1.0)
    assert stands(duck, 0.08), json_of(duck.state())
    still_m = forward_m(duck)
    time.sleep(0.2)
    assert forward_m(duck) == pytest.approx(still_m, abs=0.002)


def balancing(folder: Path, network: bytes) -> tuple[Path, Path]:
    (folder / "stilt.xml").write_text(STILT)
    skill = folder / "balance"
    skill.mkdir()
    (skill / "policy.onnx").write_bytes(network)
    (skill / "manifest.json").write_text(json.dumps(BALANCE))
    return folder / "stilt.xml", skill


def test_a_controller_on_board_keeps_a_robot_standing_that_falls_without_one(run_dir: Path, tmp_path: Path) -> None:
    # The ankle turns against the tilt and its speed.
    model, skill = balancing(tmp_path, linear([[12.0], [0.0], [0.0], [0.0], [1.0], [0.0]], [0.0]))
    falls = Robot("falls", urdf_path=model, keyframe="leaning")
    holds = Robot("holds", urdf_path=model, keyframe="leaning", onboard=skill)
    with falls, holds:
        assert isinstance(falls, SimRobot) and isinstance(holds, SimRobot)
        json_of(falls.step(1500))
        json_of(holds.step(1500))
        assert not stands(falls, 0.15)
        assert stands(holds, 0.15)
        # A policy that only keeps the ankle replaces the controller, until it ends.
        (skill / "policy.onnx").write_bytes(constant(6, [0.0]))
        json_of(holds.run(skill, seconds=0.2))
        json_of(holds.step(1500))
        assert stands(holds, 0.15)


@pytest.mark.parametrize("onboard", ["nowhere", "."])
def test_a_controller_on_board_is_the_folder_of_an_onnx_policy(run_dir: Path, tmp_path: Path, onboard: str) -> None:
    model, _ = small_duck.write(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match=r"onboard|holds no policy"):
        Robot("duck", urdf_path=model, onboard=tmp_path / "empty" / onboard)
    with pytest.raises(ValueError, match="onboard is for a model of yours"):
        Robot("so101", onboard=tmp_path)
    assert "steps" not in why(Robot("so101").run("sine", seconds=-1.0))
