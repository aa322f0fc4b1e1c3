"""``stop``, ``estop`` and ``resume`` bind a robot that runs in another process."""

from __future__ import annotations

import os
import signal

from .command import Command, RobotProcess, refusal_code

MOVE = {"shoulder_pan": 3.0}


def test_estop_locks_until_resume(cli: Command, robot: RobotProcess) -> None:
    assert robot.call("send_action", MOVE)["status"] == "success"

    done = cli.run("estop", "so101")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("so101: limp, 6 motors confirmed")
    assert done.stdout.count("\n") == 1

    assert refusal_code(robot.call("send_action", MOVE)) == "locked_out"
    assert "disarmed" in robot.call("start_task", "wave", None, "localhost", "mock")["content"][0]["text"]

    done = cli.run("resume", "so101")
    assert done.returncode == 0, done.stderr
    assert "armed" in done.stdout
    assert robot.call("send_action", MOVE)["status"] == "success"


def test_stop_disarms_without_a_lock(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("stop", "--all")
    assert done.returncode == 0, done.stderr
    assert refusal_code(robot.call("send_action", MOVE)) == "disarmed"
    assert robot.call("resume")["status"] == "success"
    assert robot.call("send_action", MOVE)["status"] == "success"


def test_estop_reaches_a_robot_whose_wire_is_frozen(cli: Command, robot: RobotProcess) -> None:
    (tree,) = cli.json("tree")["robots"]
    (wire,) = [process["pid"] for process in tree["processes"] if process["role"] == "wire"]
    os.kill(wire, signal.SIGSTOP)
    done = cli.run("estop", "so101")
    assert done.returncode == 0, done.stderr
    assert refusal_code(robot.call("send_action", MOVE)) in ("locked_out", "unreachable", "not_connected")
    assert robot.call("resume")["status"] == "success"


def test_every_robot_at_once(cli: Command, robot: RobotProcess) -> None:
    with RobotProcess(cli) as other:
        done = cli.run("estop", "--all")
        assert done.returncode == 0, done.stderr
        assert sorted(line.partition(":")[0] for line in done.stdout.splitlines()) == ["so101", "so101-2"]
        for each in (robot, other):
            assert refusal_code(each.call("send_action", MOVE)) == "locked_out"
