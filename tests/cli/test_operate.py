"""``stop``, ``estop`` and ``resume`` act on a robot that runs in another process."""

from __future__ import annotations

import os
import shutil
import signal
from pathlib import Path
from typing import cast

import pytest
import trio

from strands_actors.caller.processes.directory import Directory
from strands_actors.caller.processes.run_directory import Note
from strands_actors.contract.driver import Reason
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.root.locks import Locks
from strands_actors.supervisors.stop_result import StopResult, Unreachable
from strands_actors.surfaces.cli import operate

from .command import Command, RobotProcess, refusal_code

MOVE = {"shoulder_pan": 3.0}


def test_estop_locks_until_resume(cli: Command, robot: RobotProcess) -> None:
    assert robot.call("send_action", MOVE)["status"] == "success"

    done = cli.run("estop", "so101")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("so101: limp, 6 motors confirmed")
    assert done.stdout.count("\n") == 1

    assert "so101  e-stopped by the command line" in cli.run("tree").stdout
    assert refusal_code(robot.call("send_action", MOVE)) == "locked_out"
    assert "disarmed" in robot.call("start_task", "wave", None, "localhost", "mock")["content"][0]["text"]

    done = cli.run("resume", "so101")
    assert done.returncode == 0, done.stderr
    assert "armed" in done.stdout
    assert robot.call("send_action", MOVE)["status"] == "success"


@pytest.mark.long
def test_stop_disarms_without_a_lock(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("stop", "nobody", "--all")
    assert done.returncode == 0, done.stderr
    assert refusal_code(robot.call("send_action", MOVE)) == "disarmed"
    assert robot.call("resume")["status"] == "success"
    assert robot.call("send_action", MOVE)["status"] == "success"


def test_estop_reaches_a_robot_with_a_frozen_wire(cli: Command, robot: RobotProcess) -> None:
    (tree,) = cli.json("tree")["robots"]
    (wire,) = [process["pid"] for process in tree["processes"] if process["role"] == "wire"]
    os.kill(wire, signal.SIGSTOP)
    done = cli.run("estop", "so101")
    assert done.returncode == 0, done.stderr
    assert refusal_code(robot.call("send_action", MOVE)) in ("locked_out", "unreachable", "not_connected")
    resumed = robot.call("resume")
    assert resumed["status"] == "success", resumed


@pytest.mark.long
def test_every_robot_at_once(cli: Command, robot: RobotProcess) -> None:
    with RobotProcess(cli) as other:
        done = cli.run("estop", "--all")
        assert done.returncode == 0, done.stderr
        assert sorted(line.partition(":")[0] for line in done.stdout.splitlines()) == ["so101", "so101-2"]
        for each in (robot, other):
            assert refusal_code(each.call("send_action", MOVE)) == "locked_out"


def test_saf_018_a_lock_outlives_the_script_and_is_lifted_without_one(cli: Command) -> None:
    """Kill the process and start it again, as systemd does."""
    with RobotProcess(cli) as robot:
        done = cli.run("estop", "so101")
        assert done.returncode == 0, done.stderr
        assert "locked until `strands-actors resume so101`" in done.stdout
        robot.process.kill()
    cli.wait_until_gone()

    with RobotProcess(cli, expected="e-stopped by the command line") as robot:
        assert refusal_code(robot.call("send_action", MOVE)) == "locked_out"
    cli.wait_until_gone()

    done = cli.run("resume", "so101")
    assert done.returncode == 0, done.stderr
    assert "e-stop by the command line" in done.stdout
    assert "The robot is not running, so nothing was energised" in done.stdout
    done = cli.run("resume", "so101")
    assert done.returncode == 2, done.stdout
    with RobotProcess(cli) as robot:
        assert robot.call("send_action", MOVE)["status"] == "success"


@pytest.mark.long
def test_saf_018_resume_all_lifts_a_lock_that_no_tree_holds(cli: Command) -> None:
    with RobotProcess(cli), RobotProcess(cli):
        assert cli.run("estop").returncode == 0
    cli.wait_until_gone()
    done = cli.run("resume", "--all")
    assert done.returncode == 0, done.stderr
    assert [line.partition(":")[0] for line in done.stdout.splitlines()] == ["so101", "so101-2"]
    assert cli.run("resume", "--all").returncode == 2


def test_saf_018_locks_that_cannot_be_read_keep_no_robot_from_being_resumed(
    cli: Command, robot: RobotProcess
) -> None:
    assert cli.run("estop").returncode == 0
    locks = Path(cli.environment["STRANDS_ACTORS_DATA"]) / "locks"
    shutil.rmtree(locks)
    locks.write_text("no directory")
    done = cli.run("resume", "so101")
    assert done.returncode == 1
    assert "so101: armed" in done.stdout
    assert "the locks of e-stops: the locks cannot be read" in done.stderr
    assert robot.call("send_action", MOVE)["status"] == "success"


def test_saf_005_an_unusable_run_directory_is_reported(cli: Command, robot: RobotProcess) -> None:
    directory = cli.environment["STRANDS_ACTORS_RUN"]
    os.chmod(directory, 0o755)
    try:
        done = cli.run("estop")
    finally:
        os.chmod(directory, 0o700)
    assert done.returncode == 1, done
    assert "is open to others: chmod 700 it" in done.stderr
    assert "Traceback" not in done.stderr
    assert cli.run("estop").returncode == 0


class Silent:
    """A directory of robots in which no robot confirms a stop."""

    async def stop(self, note: Note, reason: Reason, by: str, lock: bool = False) -> StopResult:
        return Unreachable(Refused("unconfirmed", "neither wire nor root answers"), ("shoulder_pan", "gripper"))


def test_saf_018_an_unanswered_estop_locks_the_port_too(run_dir: Path) -> None:
    """The next tree may get another name, because that of a dead tree may stay taken for a while."""
    note = Note("so101", "so101", 1, [], port="192.0.2.10")
    done, line = trio.run(operate.estop, cast("Directory", Silent()), note)
    assert not done
    assert "Not confirmed by shoulder_pan, gripper" in line
    assert "BUT" not in line
    locks = run_dir / "data" / "locks"
    for robot, port, locked in (("so101-2", "192.0.2.10", True), ("so101", "", True), ("so101-2", "", False)):
        assert (Locks(locks, robot, port).find() is not None) == locked
    assert operate.lift("so101")[0]
    assert Locks(locks, "so101-2", "192.0.2.10").find() is None
