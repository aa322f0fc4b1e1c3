"""Drive a robot that is a node of another program on a ROS 2 graph: ``Robot(..., driver="ros2", table=...)``."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from strands_actors import Robot
from strands_actors.drivers.ros2.driver import Ros2Driver
from strands_actors.drivers.ros2.link import Reports
from strands_actors.drivers.ros2.table import read_table
from strands_actors.kernel.channels.ros2.definitions import CANCEL, FOLLOW
from strands_actors.kernel.channels.ros2.type_hash import type_hash
from tests.answers import json_of, pids, state, until, why
from tests.ports import free_port

from .peer import router

TABLE: dict[str, Any] = {
    "joints": {name: {"low": -2.0, "high": 2.0, "speed": 1.0} for name in ("shoulder", "elbow")},
    "follow_joint_trajectory": "/arm_controller/follow_joint_trajectory",
    "base": {"linear.x": 0.5, "angular.z": 1.0},
    "node_timeout_s": 0.5,
}
ARM = {key: value for key, value in TABLE.items() if key in ("joints", "follow_joint_trajectory")}


class Foreign(NamedTuple):
    """A node of another program, and the router of its graph."""

    port: int
    log: Path
    process: subprocess.Popen[str]

    def commands(self, what: str, since_ns: int = 0) -> list[list[float]]:
        """Return the values of the commands of one kind that the node has got since a time."""
        return [line["values"] for line in self.lines(what, since_ns)]

    def lines(self, what: str, since_ns: int = 0) -> list[dict[str, Any]]:
        lines = (json.loads(line) for line in self.log.read_text().splitlines())
        return [line for line in lines if line["what"] == what and line["t_ns"] >= since_ns]

    def robot(self, table: dict[str, Any]) -> Any:
        endpoint = f"tcp/127.0.0.1:{self.port}"
        # The long times let a busy machine pause the node and the processes of the robot.
        times = {"timeout_s": 30.0, "lifetime": 1.0}
        return Robot("my_base", mode="real", driver="ros2", port=endpoint, table=table, **times)


@pytest.fixture
def foreign(tmp_path: Path, run_dir: Path) -> Iterator[Foreign]:
    port, log = free_port(), tmp_path / "commands"
    hashes = {"send_goal": type_hash(f"{FOLLOW}_SendGoal"), "cancel_goal": type_hash(CANCEL)}
    arguments = [str(port), str(log), json.dumps(hashes)]
    command = [sys.executable, "-m", "tests.ros2.foreign_node", *arguments]
    with (
        router(f"tcp/127.0.0.1:{port}"),
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process,
    ):
        try:
            assert process.stdout is not None and "ready" in process.stdout.readline()
            yield Foreign(port, log, process)
        finally:
            process.kill()


def test_saf_001_a_foreign_node_is_driven_under_our_gates_and_stopped(foreign: Foreign) -> None:
    robot = foreign.robot(TABLE)
    try:
        assert robot.connect_eagerly() is None
        status = json_of(robot.get_status())
        assert status["driven_by"] == ["/foreign"] and status["also_commanded_by"] == []
        assert "Other nodes may command it" in status["caveats"][0]
        assert "last goal of the arm" in status["firmware_watchdog"]
        assert "past" in why(robot.send_action({"linear.x": 0.9}))
        assert robot.send_action({"shoulder": 1.5})["status"] == "error"  # too far for one goal
        assert not any(any(twist) for twist in foreign.commands("twist")) and not foreign.commands("goal")
        assert robot.send_action({"linear.x": 0.2})["status"] == "success"
        until(lambda: [0.2, 0.0] in foreign.commands("twist"), "it drives")
        until(lambda: state(robot) == "holding", "the twist has expired, and the base stands")

        def moves() -> bool:
            """Try again if a pause of the machine has ended the motion."""
            if robot.move_to({"shoulder": 0.5}, seconds=1.0)["status"] == "success":
                return True
            robot.resume()
            return False

        until(moves, "it comes to its end")
        until(lambda: abs(robot.get_observation()["shoulder"] - 0.5) < 0.02, "the arm has moved")
        goals = foreign.commands("goal")
        assert len(goals) > 5 and all(seconds <= 0.6 for *_, seconds in goals)
        before_ns = time.monotonic_ns()
        stopped = json_of(robot.stop())
        assert stopped["safe_state"] == "zero" and not stopped["unconfirmed"]
        assert len(foreign.commands("cancel", before_ns)) >= 3 and not foreign.commands("goal", before_ns)
    finally:
        robot.cleanup()


@pytest.mark.parametrize("fault", [signal.SIGKILL, pytest.param(signal.SIGSTOP, marks=pytest.mark.long)])
def test_saf_002_the_root_stops_a_foreign_arm_when_its_wire_process_fails(foreign: Foreign, fault: int) -> None:
    robot = foreign.robot(ARM)
    try:
        assert robot.connect_eagerly() is None
        assert robot.move_to({"shoulder": 1.5}, seconds=5.0, wait=False)["status"] == "success"
        until(lambda: len(foreign.commands("goal")) > 5, "it moves")
        os.kill(pids(robot)["wire"], fault)
        fault_ns = time.monotonic_ns()
        until(lambda: len(foreign.commands("cancel", fault_ns)) >= 3, "the root cancels the goal")
        first = foreign.lines("cancel", fault_ns)[0]
        assert not foreign.commands("goal", first["t_ns"])
        assert foreign.commands("goal")[-1][0] < 1.4  # it was on its way
    finally:
        robot.cleanup()


@pytest.mark.long
def test_a_node_that_goes_is_not_commanded_and_is_found_again(foreign: Foreign) -> None:
    robot = foreign.robot(ARM)
    try:
        assert robot.connect_eagerly() is None
        foreign.process.send_signal(signal.SIGSTOP)
        until(lambda: state(robot) in ("lost", "down"), "it is lost")
        assert robot.send_action({"shoulder": 0.1})["status"] == "error"
        foreign.process.send_signal(signal.SIGCONT)
        until(lambda: state(robot) == "disarmed", "it is found again", 20.0)
        assert robot.resume()["status"] == "success"
        assert robot.send_action({"shoulder": 0.1})["status"] == "success"
    finally:
        robot.cleanup()


# -- the table, pure


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        (None, "Give the topics and limits"),
        ({}, "neither joints nor a base"),
        ({"joints": ARM["joints"]}, "need follow_joint_trajectory"),
        ({"base": {"linear.x": -1.0}}, "above 0"),
        ({"base": {"linear.z": 1.0}}, "linear.z"),
        ({"bases": {}}, "bases"),
        ({**ARM, "joints": {"a": {"low": 1.0, "high": 0.0, "speed": 1.0}}}, "low below high"),
        ({"base": {"linear.x": 1.0}, "odom": "odom"}, "no full name of a topic"),
        ({"base": {"linear.x": 1.0}, "node_timeout_s": 0.0}, "node_timeout_s"),
        ("/no/such/file.toml", "No such file"),
    ],
)
def test_a_wrong_table_is_refused_with_its_reason(table: object, reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Robot("my_base", mode="real", driver="ros2", table=table)


def test_a_table_is_read_from_a_file_too(tmp_path: Path) -> None:
    file = tmp_path / "base.toml"
    file.write_text('odom = "/o"\n[base]\n"linear.x" = 0.5\n')
    assert read_table(str(file))["odom"] == "/o"
    driver = Ros2Driver("my_base", "", Ros2Driver.resolve("my_base", {"table": str(file)}))
    assert driver.axes == ("linear.x",) and "not known" in driver.firmware_watchdog


def test_a_wrong_router_is_refused() -> None:
    with pytest.raises(ValueError, match="Give the router"):
        Robot("my_base", mode="real", driver="ros2", table=TABLE, port="localhost:7447")


def test_a_simulation_is_refused() -> None:
    with pytest.raises(ValueError, match="its own simulation"):
        Robot("my_base", driver="ros2", table=TABLE)


def joints(stamp_ns: int, *positions: float, names: tuple[str, ...] = ("a", "b"), **more: Any) -> dict[str, Any]:
    stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    message = {"header": {"stamp": stamp}, "name": list(names), "position": list(positions), "velocity": []}
    return message | more


def test_speeds_are_computed_from_two_positions_if_the_node_reports_none() -> None:
    reports = Reports()
    reports.take_joints(joints(10**9, 0.0, 1.0), ("a", "b"), 1)
    reports.take_joints(joints(2 * 10**9, 0.5, 1.0), ("a", "b"), 2)
    assert reports.speeds == {"a": 0.5, "b": 0.0} and reports.joint_stamps.goes_on
    reports.take_joints(joints(3 * 10**9, 0.5, 1.0, velocity=[0.1, 0.2]), ("a", "b"), 3)
    assert reports.speeds == {"a": 0.1, "b": 0.2}
    reports.take_joints(joints(4 * 10**9, 9.0, names=("a",)), ("a", "b"), 4)  # a joint is missing
    reports.take_joints(joints(4 * 10**9, float("nan"), 1.0), ("a", "b"), 4)
    reports.take_joints(joints(3 * 10**9, 9.0, 9.0), ("a", "b"), 4)  # an old stamp
    assert reports.positions == {"a": 0.5, "b": 1.0} and reports.joint_stamps.new_ns == 3
