"""``tree`` shows the running robots from another process."""

from __future__ import annotations

import os
import signal
from typing import Any, cast

import pytest

from strands_actors.supervisors.gate.messages import Status
from strands_actors.supervisors.root.messages import TreeReport
from strands_actors.surfaces.cli.top.feed import RobotSnapshot
from strands_actors.surfaces.cli.top.rows import state as top_state
from strands_actors.surfaces.cli.trees import state_of
from tests.trees import ATTEMPTS

from .command import Command, RobotProcess

PROCESS_ROLES = {"caller", "root", "wire", "policy", "twin"}


def only(trees: dict[str, Any]) -> dict[str, Any]:
    (robot,) = trees["robots"]
    assert isinstance(robot, dict)
    return robot


def pids(robot: dict[str, Any]) -> dict[str, int]:
    return {process["role"]: process["pid"] for process in robot["processes"]}


def test_tree_without_a_running_robot(cli: Command) -> None:
    assert cli.json("tree") == {"robots": []}
    assert "no robot" in cli.run("tree").stdout


def test_a_running_robot(cli: Command, robot: RobotProcess) -> None:
    tree = only(cli.json("tree"))
    assert list(tree) == ["robot", "state", "epoch", "locked_by", "processes", "actors"]
    assert (tree["robot"], tree["state"]) == ("so101", "armed")
    assert tree["epoch"] >= 1
    assert set(pids(tree)) == {"caller", "root", "spawner", "wire", "standby", "twin"}
    assert pids(tree)["caller"] == robot.process.pid
    for process in tree["processes"]:
        assert list(process) == ["role", "pid", "restarts"]
        assert process["restarts"] == 0
        os.kill(process["pid"], 0)
    by_role = {actor["role"]: actor for actor in tree["actors"]}
    assert {"gate", "watchdog", "transport", "guardian", "root"} <= set(by_role)
    for actor in tree["actors"]:
        assert list(actor) == ["address", "role", "pid", "state", "restarts"]
        assert actor["pid"] in pids(tree).values()
        assert actor["state"] == "running"
    assert by_role["gate"]["address"] == "strands/so101/actor/gate"
    assert by_role["gate"]["pid"] == pids(tree)["wire"]
    assert by_role["guardian"]["pid"] == pids(tree)["root"]


def test_tree_follows_a_task_and_a_stop(cli: Command, robot: RobotProcess) -> None:
    for _ in range(ATTEMPTS):  # on a busy machine a rollout may end before the command reads it
        assert robot.call("resume")["status"] == "success"
        assert robot.call("start_task", "wave", None, "localhost", "mock")["status"] == "success"
        if "policy" in (found := pids(only(cli.json("tree")))):
            break
    os.kill(found["policy"], 0)
    assert robot.call("stop")["status"] == "success"
    tree = only(cli.json("tree"))
    assert tree["state"] == "disarmed"
    drawn = cli.run("tree").stdout
    for word in ("so101", "disarmed", "caller", "root", "wire", "twin", "gate", "running"):
        assert word in drawn


@pytest.mark.long
def test_a_frozen_root_is_listed_as_unreachable(cli: Command, robot: RobotProcess) -> None:
    root = pids(only(cli.json("tree")))["root"]
    os.kill(root, signal.SIGSTOP)
    assert only(cli.json("tree")) == {
        "robot": "so101",
        "state": "unreachable",
        "epoch": 0,
        "locked_by": "",
        "processes": [{"role": "root", "pid": root, "restarts": 0}],
        "actors": [],
    }
    assert robot.call("resume")["status"] == "success"
    assert only(cli.json("tree"))["state"] == "armed"


@pytest.mark.long
def test_two_robots(cli: Command, robot: RobotProcess) -> None:
    with RobotProcess(cli):
        assert [tree["robot"] for tree in cli.json("tree")["robots"]] == ["so101", "so101-2"]


@pytest.mark.parametrize("state", ["unconfirmed", "failed", "lost", "stopping", "unreachable"])
def test_an_e_stop_hides_no_state_that_is_not_safe(state: str) -> None:
    assert state_of(state, "me").plain == f"{state}, e-stopped by me"
    assert state_of("disarmed", "me").plain == "e-stopped by me"
    for mode, shown in (("disarmed", "e-stopped"), (state, state)):
        status = Status(mode, 1, True, "", "me", "", "", None, -1.0, (), 0, 0, 0, "", None)
        tree = TreeReport("so101", mode, 1, (), ())
        assert top_state(RobotSnapshot(0.0, cast(Any, None), tree, status, {})).plain == shown
