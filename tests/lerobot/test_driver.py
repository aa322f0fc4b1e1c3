"""``driver="lerobot"`` with LeRobot's own SO101Follower and KochFollower, on our twins."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import lerobot
import pytest
from lerobot.robots import RobotConfig

from strands_actors import Robot
from strands_actors.drivers.plain.lerobot.types import TYPES, missing
from strands_actors.surfaces.cli.robots import show_robots
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why

from .calibration import NAME, write

LONG_S = 240.0
"""For another process to import torch, on a busy machine."""


def test_every_type_of_this_lerobot_is_a_robot_here_with_its_config_as_the_table_says() -> None:
    folder = Path(str(lerobot.__file__)).parent / "robots"
    registered = {
        name: module.parent.name
        for module in folder.glob("*/*.py")
        for name in re.findall(r'RobotConfig\.register_subclass\("(\w+)"\)', module.read_text())
    }
    assert len(registered) >= 14
    by_type = {kind.type: kind for kind in TYPES.values()}
    assert not set(registered) - set(by_type), "LeRobot has types that no robot here is"
    for name, module in registered.items():
        kind = by_type[name]
        assert kind.module == module
        importlib.import_module(f"lerobot.robots.{module}")
        fields = {field.name for field in dataclasses.fields(RobotConfig.get_choice_class(name))}
        assert not kind.port or kind.port in fields, name
    lacking = {kind.type for kind in TYPES.values() if missing(kind).startswith("pip install -U")}
    assert lacking == set(by_type) - set(registered)


def test_list_says_who_really_works_here(capsys: pytest.CaptureFixture[str]) -> None:
    show_robots(as_json=True)
    rows = {row["robot"]: row for row in json.loads(capsys.readouterr().out)["robots"]}
    for robot in ("so100", "so101", "koch", "omx", "bi_so101", "hope_jr_hand", "earthrover"):
        assert rows[robot]["missing"] is None and "lerobot" in rows[robot]["coverage"], rows[robot]
    assert "pip install" in rows["reachy2"]["missing"] and "unitree_sdk2py" in rows["unitree_g1"]["missing"]


class Arm(NamedTuple):
    robot: Any
    twin: Twin


@pytest.fixture(params=["so101", "koch"])
def arm(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Arm]:
    write(tmp_path)
    known = {"tool_name": NAME, "calibration_dir": str(tmp_path)}
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
    os.kill(pids(robot)["wire"], signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "it is limp")
    until(lambda: status(robot)["connected"] and state(robot) == "disarmed", "there is another wire", LONG_S)
    twin.log.no_setpoint_after_safe(killed_ns)
    twin.log.silent_after(killed_ns, "enable")
    json_of(robot.resume())
    json_of(robot.send_action({"shoulder_pan": goal - 5.0}))
