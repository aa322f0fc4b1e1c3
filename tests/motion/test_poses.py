"""``get_pose`` and ``move_to`` with a pose, as scripts and agents call them: on twins, and in simulation."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import json_of, state, task, until, why

from .conftest import LIFETIME_S, READY

LEFT_M = 0.05


def xyz(robot: Any) -> list[float]:
    place: list[float] = json_of(robot.get_pose())["xyz"]
    return place


def beside(robot: Any, left_m: float = LEFT_M) -> list[float]:
    x, y, z = xyz(robot)
    return [x, y + left_m, z]


def test_an_so101_moves_its_tool_to_the_left_and_reads_the_pose_back(ready: RealRobot) -> None:
    goal = beside(ready)
    result = json_of(ready.move_to(xyz=goal, speed=0.2))
    assert result["pose"]["xyz"] == pytest.approx(goal, abs=1e-3)
    assert result["measured_pose"]["xyz"][1] == pytest.approx(goal[1], abs=0.005)
    # The servos yield a little to the weight of the arm.
    assert xyz(ready) == pytest.approx(goal, abs=0.012)
    assert "gripper" not in result["commanded"] and state(ready) == "armed"


def test_poses_that_cannot_be_reached_are_refused_before_anything_moves(ready: RealRobot, twin: Twin) -> None:
    began_ns, here = time.monotonic_ns(), xyz(ready)
    for pose, text in (
        ({"xyz": (0.0, 0.9, 0.1)}, "The nearest pose is xyz=("),
        ({"xyz": here, "rpy": (0, 0, 90)}, "The nearest orientation there is rpy=("),
        ({"xyz": beside(ready), "keep_out": [{"center": here, "size": (0.02, 0.02, 0.02)}]}, "is in keep_out 0"),
        ({"targets": {"gripper": 5.0}, "xyz": here}, "joint targets and a pose are both given"),
        ({"xyz": here, "seconds": 2.0}, "Leave seconds out, and give speed"),
        ({"speed": 0.1, "targets": {"gripper": 5.0}}, "speed is given without a pose"),
        ({}, "no target is given"),
        ({"xyz": (1, 2, "x")}, "Give 3 numbers in metres"),
    ):
        answer = ready.move_to(**pose)  # type: ignore[arg-type]
        assert text in why(answer), answer
        assert answer["content"][1]["json"]["refused"]["code"]
    moved = {entry.data for entry in twin.log.host("setpoint", began_ns)}
    assert len(moved) <= 1, "the last target is sent again, and no other"


def test_a_stop_ends_it_and_a_stopped_arm_still_has_a_pose(ready: RealRobot, twin: Twin) -> None:
    json_of(ready.move_to(xyz=beside(ready), speed=0.01, wait=False))
    until(lambda: task(ready)["running"], "it moves")
    assert "a task is already running" in why(ready.move_to(xyz=beside(ready)))
    stopped_ns = time.monotonic_ns()
    json_of(ready.stop())
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(stopped_ns) == 0
    assert len(xyz(ready)) == 3
    assert "resume() first" in why(ready.move_to(xyz=(0.2, 0.0, 0.2)))


SCRIPT = """
import sys
from strands_actors import Robot
arm = Robot("so101", mode="real", port=sys.argv[1], lifetime=1.0)  # a busy computer is late
arm.connect_eagerly()
x, y, z = arm.get_pose()["content"][0]["json"]["xyz"]
print(arm.move_to(xyz=(x, y + float(sys.argv[2]), z), speed=0.01))
"""


def test_saf_003_a_killed_script_ends_it(ready: RealRobot, twin: Twin, run_dir: Path) -> None:
    left_m = -0.1 if xyz(ready)[1] > 0 else 0.1
    ready.cleanup()
    began_ns = time.monotonic_ns()
    script = subprocess.Popen([sys.executable, "-c", SCRIPT, twin.port, str(left_m)])
    try:
        until(lambda: len({entry.data for entry in twin.log.host("setpoint", began_ns)}) > 8, "it moves")
        killed_ns = time.monotonic_ns()
    finally:
        script.kill()
        script.wait()
    until(lambda: twin.log.host("safe", killed_ns), "it is made safe")
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(killed_ns) == 0


def test_an_agent_reads_the_pose_and_moves_the_tool(ready: RealRobot) -> None:
    def use(**call: Any) -> Any:
        return asyncio.run(ready.use_tool(call, "agent"))

    x, y, z = json_of(use(action="get_pose"))["xyz"]
    moved = json_of(use(action="move_to", xyz=[x, y - 0.03, z], speed=0.2))
    assert moved["measured_pose"]["xyz"][1] == pytest.approx(y - 0.03, abs=0.005)
    assert "out of reach" in why(use(action="move_to", xyz=[3, 0, 0]))
    assert "xyz is 'left'. Give xyz as array" in why(use(action="move_to", xyz="left"))


def test_a_ur_moves_its_tool_to_the_left_and_its_controller_agrees(ur: RealRobot) -> None:
    goal, before = beside(ur), json_of(ur.get_pose())
    result = json_of(ur.move_to(xyz=goal, speed=0.2))
    assert result["measured_pose"]["xyz"] == pytest.approx(goal, abs=1e-3)
    assert json_of(ur.state())["tcp_pose"][:3] == pytest.approx(goal, abs=1e-3)
    after = json_of(ur.get_pose())
    assert after["apart_m"] < 1e-3
    assert abs(sum(a * b for a, b in zip(before["quat"], after["quat"], strict=True))) > 0.99999


def test_an_arm_that_an_operator_guards_needs_the_approval_for_a_pose_too(ur: RealRobot) -> None:
    call = {"action": "move_to", "xyz": beside(ur, -0.02)}
    refused = asyncio.run(ur.use_tool(call, "agent"))
    assert "needs an operator's approval" in why(refused)


def test_a_robot_without_an_arm_has_no_pose_and_a_simulation_has_the_same() -> None:
    sim = Robot("so101", lifetime=LIFETIME_S)
    try:
        json_of(sim.move_to(READY, seconds=0.5))
        goal = beside(sim)
        result = json_of(sim.move_to(xyz=goal, speed=0.3, linear=False))
        assert result["measured_pose"]["xyz"][1] == pytest.approx(goal[1], abs=0.005)
    finally:
        sim.cleanup()
    gripper = Robot("robotiq_2f85")
    try:
        gripper.ensure_connected()
        assert "no model of an arm is known for" in why(gripper.get_pose())
    finally:
        gripper.cleanup()
