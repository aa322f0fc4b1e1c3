"""``driver="lerobot"`` with LeRobot's own SO101Follower and KochFollower, on our twins."""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.testing import Twin
from tests.answers import json_of, state, status, until, why
from tests.drivers.plain.rig import pid_of

MOTORS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
LONG_S = 240.0
"""For another process to import torch, on a busy machine."""


class Arm(NamedTuple):
    robot: Any
    twin: Twin


@pytest.fixture(params=["so101", "koch"])
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Arm]:
    motors = {
        motor: {"id": at, "drive_mode": 0, "homing_offset": 0, "range_min": 0, "range_max": 4095}
        for at, motor in enumerate(MOTORS, start=1)
    }
    (tmp_path / "black.json").write_text(json.dumps(motors))
    known = {"tool_name": "black", "calibration_dir": str(tmp_path)}
    with Twin(request.param, tmp_path) as twin:
        robot = Robot(request.param, mode="real", driver="lerobot", port=twin.port, **known)
        try:
            assert robot.connect_eagerly() is None
            yield Arm(robot, twin)
        finally:
            robot.cleanup()


def test_it_moves_is_refused_is_stopped_and_goes_on_after_its_wire_was_killed(arm: Arm) -> None:
    robot, twin = arm
    assert status(robot)["stop_channel"].startswith("torque off by our own codec")
    kinds = [frame.kind for frame in twin.log.entries() if frame.sender == "host"]
    assert kinds.index("setpoint") < kinds.index("enable"), "connecting energised it"
    before = robot.get_observation()
    goal = before["shoulder_pan"] + 10.0
    json_of(robot.send_action({"shoulder_pan": goal}))
    until(lambda: abs(robot.get_observation()["shoulder_pan"] - goal) < 2.0, "it moves")
    assert "400.0 deg is past" in why(robot.send_action({"shoulder_pan": 400.0}))
    stopped_ns = time.monotonic_ns()
    assert json_of(robot.stop())["safe_state"] == "limp"
    twin.log.no_setpoint_after_safe(stopped_ns)
    json_of(robot.resume())
    json_of(robot.send_action({"shoulder_pan": goal}))
    killed_ns = time.monotonic_ns()
    os.kill(pid_of(robot, "wire"), signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "it is limp")
    until(lambda: status(robot)["connected"] and state(robot) == "disarmed", "there is another wire", LONG_S)
    twin.log.no_setpoint_after_safe(killed_ns)
    twin.log.silent_after(killed_ns, "enable")
    json_of(robot.resume())
    json_of(robot.send_action({"shoulder_pan": goal - 5.0}))
