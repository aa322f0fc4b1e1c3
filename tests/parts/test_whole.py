"""A robot of two simulated arms is one robot for its user: commands, e-stop, rollout, dataset, leaders, agents."""

from __future__ import annotations

import contextlib
import json
import time
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Teleoperator, estop, record_dataset
from strands_actors.policies import MockPolicy
from strands_actors.testing import WireLog

from .cells import Cell, is_limp, ok, opened, until

AXES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture
def cell(tmp_path: Path) -> Any:
    with opened(tmp_path) as cell:
        yield cell


def test_two_arms_are_one_robot(cell: Cell, tmp_path: Path) -> None:
    """One start of the processes serves all of this, since it takes seconds."""
    _commands(cell)
    _refusals(cell)
    _estop(cell)
    _rollout_and_dataset(cell, tmp_path / "set")
    _leaders(cell)


def _commands(cell: Cell) -> None:
    robot = cell.robot
    assert list(robot.get_observation()) == [f"{part}_{axis}" for part in ("left", "right") for axis in AXES]
    moved = ok(robot.send_action({"left.shoulder_pan": 2.0, "right_shoulder_pan.pos": -2.0}))
    assert moved["commanded"] == {"left_shoulder_pan": 2.0, "right_shoulder_pan": -2.0}
    until(lambda: robot.get_observation()["left_shoulder_pan"] > 1.0, "left did not move")
    until(lambda: robot.get_observation()["right_shoulder_pan"] < -1.0, "right did not move")
    roles = {process["role"] for process in robot.tree()["processes"]}
    assert {"root", "wire", "standby", "left/root", "left/wire", "left/standby", "right/wire"} <= roles


def _refusals(cell: Cell) -> None:
    """A setpoint that one part would refuse reaches no part."""
    since_ns = time.monotonic_ns()
    refused = cell.robot.send_action({"left_shoulder_pan": 3.0, "right_shoulder_pan": 900.0})
    assert refused["status"] == "error" and "right" in refused["content"][0]["text"]
    assert not any(_goals_changed(log, since_ns) for log in cell.logs.values())


def _goals_changed(log: WireLog, since_ns: int) -> bool:
    return len({entry.data for entry in log.host("setpoint", since_ns)}) > 1


def _estop(cell: Cell) -> None:
    since_ns = time.monotonic_ns()
    estop()
    for part, log in cell.logs.items():
        until(lambda log=log: is_limp(log, since_ns), f"{part} did not stop")  # type: ignore[misc]
    until(lambda: ok(cell.robot.get_status())["locked_by"], "no lock")
    assert cell.robot.send_action({"left_shoulder_pan": 0.0})["status"] == "error"
    until(lambda: cell.robot.resume()["status"] == "success", "the lock was not lifted")
    assert ok(cell.robot.get_status())["locked_by"] is None


def _rollout_and_dataset(cell: Cell, root: Path) -> None:
    with record_dataset(cell.robot, root, task="wave", fps=20) as recording, recording.episode():
        run = ok(cell.robot.run_policy(MockPolicy(), "wave", duration=0.5, wait=True))
    assert run["exit_reason"] == "duration"
    features = json.loads((root / "meta/info.json").read_text())["features"]
    names = [f"{part}_{axis}.pos" for part in ("left", "right") for axis in AXES]
    assert features["action"]["names"] == names == features["observation.state"]["names"]


def _leaders(cell: Cell) -> None:
    """Each leader leads its arm by the changes of its joints."""
    robot = cell.robot
    leaders = {part: Teleoperator("so101_leader", transport="twin", relative=True) for part in ("left", "right")}
    with contextlib.ExitStack() as stack:
        for leader in leaders.values():
            stack.enter_context(leader)
            leader.move_by_hand({"shoulder_pan": 0.0})
        ok(robot.attach_teleop(leaders, deadman="key"))
        moved_by: dict[str, float] = {}

        def state() -> Any:
            """Hold the dead-man. Press it anew if a busy machine has interrupted the leading."""
            status = ok(robot.get_task_status())["teleop"]
            robot.operate(status["state"] != "idle" or not status["held"])
            return status

        until(lambda: state()["state"] == "engaged", "the leaders do not lead", state)
        before = robot.get_observation()
        for part, angle in (("left", 8.0), ("right", -8.0)):
            leaders[part].move_by_hand({"shoulder_pan": angle})

        def has_followed() -> bool:
            state()
            now = robot.get_observation()
            moved_by.update({key: now[key] - before[key] for key in now.keys() & before.keys()})
            return moved_by["left_shoulder_pan"] > 4.0 and moved_by["right_shoulder_pan"] < -4.0

        until(has_followed, "the arms do not follow", lambda: (moved_by, state()))
        ok(robot.stop_task())
