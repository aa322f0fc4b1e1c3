"""The commands ``echo``, ``hz``, ``send`` and ``mesh`` as real processes."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.answers import until

from .command import Command, RobotProcess, refusal_code


@pytest.mark.long
def test_published_samples_are_shown(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("echo", "so101", "--count", "3", "--json")
    assert done.returncode == 0, done.stderr
    samples = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(samples) == 3
    state = next(sample for sample in samples if sample["key"] == "strands/so101/state")
    assert state["encoding"] == "application/json;strands.state.v1"
    assert state["seq"] >= 1 and "shoulder_pan" in state["value"]["joints"]

    (line,) = cli.run("echo", "strands/*/presence", "--count", "1").stdout.splitlines()
    assert line.startswith('strands/so101/presence  {"robot_id":"so101"')

    rates = {topic["key"]: topic["hz"] for topic in cli.json("hz", "so101", "--seconds", "2")["topics"]}
    assert 5 < rates["strands/so101/state"] < 15

    (seen,) = cli.json("mesh", "status")["robots"]
    assert (seen["robot"], seen["reachable"], seen["state"]) == ("so101", True, "armed")
    assert "so101 in process" in seen["lease"]
    assert cli.run("mesh", "status").stdout.startswith("so101 ")

    for arguments in (["echo", "nobody"], ["hz", "nobody", "--seconds", "1"]):
        done = cli.run(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        assert "nobody" in done.stderr and done.stderr.count("\n") == 1


@pytest.mark.long
def test_a_topic_without_a_publisher_is_reported_after_the_given_time(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("echo", "strands/so101/nothing", "--timeout", "3.5")
    assert (done.returncode, done.stdout) == (2, "")
    waiting, ended = done.stderr.splitlines()
    assert waiting.startswith("no sample of strands/so101/nothing has arrived yet") and waiting.endswith("so101")
    assert "no sample of strands/so101/nothing arrived for 3.5 s" in ended


@pytest.mark.long
def test_a_target_is_sent_once_the_script_has_given_the_lease_up(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("send", "so101", "shoulder_pan=5")
    assert (done.returncode, done.stdout) == (1, "")
    assert "holds the lease" in done.stderr and done.stderr.count("\n") == 1

    assert robot.call("release")["status"] == "success"
    done = cli.run("send", "so101", "shoulder_pan=5", "--for", "1", "--resume")
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("so101: shoulder_pan 5")
    here = robot.call("get_observation")["shoulder_pan"]
    assert abs(here - 5.0) < 2.0

    done = cli.run("send", "so101", "shoulder_pan=500", "--resume")
    assert (done.returncode, done.stdout) == (1, "")
    assert "past 110" in done.stderr

    done = cli.run("send", "so101", "shoulder_pan=far")
    assert done.returncode == 2 and "joint=number" in done.stderr


@pytest.mark.long
def test_a_released_robot_is_moved_without_a_resume(cli: Command, robot: RobotProcess) -> None:
    """Move by single commands. Between them the robot holds, and reports why."""
    assert robot.call("send_action", {"shoulder_pan": 2.0})["status"] == "success"
    assert robot.call("release")["status"] == "success"
    for target in (5, 8):
        done = cli.run("send", "so101", f"shoulder_pan={target}", "--for", "0.2")
        assert (done.returncode, done.stderr) == (0, "")
    cause = robot.call("get_status")["content"][0]["json"]["cause"]
    assert cause == "the writer gave its lease back"


@pytest.mark.long
def test_an_interrupted_send_leaves_the_robot_holding(cli: Command, robot: RobotProcess) -> None:
    assert robot.call("release")["status"] == "success"
    with cli.start("send", "so101", "shoulder_pan=20", "--for", "60", "--resume") as sending:
        assert sending.stdout is not None and sending.stderr is not None
        assert sending.stdout.readline().startswith("so101: ")
        sending.send_signal(signal.SIGINT)
        assert sending.wait(30) == 130
        assert sending.stderr.read() == ""
    until(lambda: state(robot) == "holding", "it holds")


def test_a_reader_that_has_seen_enough_is_no_error(cli: Command, robot: RobotProcess) -> None:
    with cli.start("echo", "so101") as echo:
        assert echo.stdout is not None and echo.stderr is not None
        assert echo.stdout.readline().startswith("strands/so101/")
        echo.stdout.close()
        assert echo.wait(30) == 0
        assert echo.stderr.read() == ""


def test_estop_alone_is_for_every_robot(cli: Command, robot: RobotProcess) -> None:
    (result,) = cli.json("estop")["robots"]
    assert (result["robot"], result["outcome"], result["safe_state"], result["locked"]) == (
        "so101",
        "safe",
        "limp",
        True,
    )
    assert refusal_code(robot.call("send_action", {"shoulder_pan": 3.0})) == "locked_out"
    (resumed,) = cli.json("resume", "--all")["robots"]
    assert resumed["done"]


@pytest.mark.long
def test_a_frozen_root_is_reported_and_its_wire_is_safe_by_itself(cli: Command, robot: RobotProcess) -> None:
    (tree,) = cli.json("tree")["robots"]
    (root,) = [process["pid"] for process in tree["processes"] if process["role"] == "root"]
    os.kill(root, signal.SIGSTOP)
    done = cli.run("estop")
    os.kill(root, signal.SIGCONT)
    assert done.returncode == 1
    assert "so101: NOT CONFIRMED" in done.stderr


def test_keys_are_made_once(cli: Command, tmp_path: Path) -> None:
    arguments = ("--robot", "arm", "--name", "screen", "--host", "arm.example")
    done = cli.json("mesh", "keys", str(tmp_path / "keys"), *arguments)
    names = sorted(Path(file).name for file in done["files"])
    assert names == sorted(
        f"{name}.{ending}" for name in ("ca", "arm", "operator", "viewer", "screen") for ending in ("pem", "key")
    )
    again = cli.run("mesh", "keys", str(tmp_path / "keys"))
    assert again.returncode == 2 and "exists already" in again.stderr
    later = cli.json("mesh", "keys", str(tmp_path / "keys"), "--robot", "arm2")
    assert sorted(Path(file).name for file in later["files"]) == ["arm2.key", "arm2.pem"]


def test_a_mesh_file_that_would_open_the_robot_unasked_is_refused(cli: Command, tmp_path: Path) -> None:
    file = tmp_path / "mesh.toml"
    file.write_text('connect = "tcp/192.0.2.1:7447"\n')
    for verb in ("status", "resume"):
        arguments = ("mesh", verb) if verb == "status" else (verb, "--all")
        done: subprocess.CompletedProcess[Any] = cli.run(*arguments, "--mesh", str(file))
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert "everyone in its network" in done.stderr


def test_saf_007_a_mesh_file_that_cannot_be_used_keeps_no_stop_from_the_robots_of_this_user(
    cli: Command, robot: RobotProcess, tmp_path: Path
) -> None:
    cli.environment["STRANDS_ACTORS_MESH"] = str(tmp_path / "no.toml")
    others = (
        "the robots of other hosts: NOT CONFIRMED: no search was made, because the configuration is wrong: mesh: "
    )
    for verb in (("stop", "so101"), ("stop", "--all"), ("estop",), ("estop", "so101")):
        done = cli.run(*verb)
        assert done.returncode == 1, done
        assert re.match("so101: (limp|lowered), 6 motors confirmed", done.stdout), done
        assert done.stderr.startswith(others) and done.stderr.count("\n") == 1
        assert "no.toml cannot be read" in done.stderr
        assert state(robot) != "armed"
        assert robot.call("resume")["status"] == "success"
    done = cli.run("estop", "--json")
    near, far = json.loads(done.stdout)["robots"]
    assert (done.returncode, near["done"], far["done"]) == (1, True, False)
    assert far["outcome"] == "unreachable" and "no.toml" in far["detail"]


def state(robot: RobotProcess) -> str:
    shown: str = robot.call("get_status")["content"][0]["json"]["state"]
    return shown


def test_trace_shows_sender_receiver_and_type_of_each_message(cli: Command, robot: RobotProcess) -> None:
    with cli.start("trace", "so101", "--json", "--seconds", "30") as tracing:
        assert tracing.stdout is not None
        seen: list[dict[str, Any]] = []
        expected = {("ask", "gate", "Setpoint"), ("answer", "caller", "Accepted")}
        while expected:
            robot.call("send_action", {"shoulder_pan": 1.0})
            seen.append(json.loads(tracing.stdout.readline()))
            event = seen[-1]
            expected -= {
                (event["kind"], "caller" if "caller" in event["receiver"] else event["receiver"], event["type"])
            }
            assert len(seen) < 500, seen
        tracing.send_signal(signal.SIGINT)
    (setpoint, *_) = [event for event in seen if event["type"] == "Setpoint"]
    assert "caller" in setpoint["sender"] and 0 <= setpoint["age_ms"] < 5000
    (accepted, *_) = [event for event in seen if event["type"] == "Accepted"]
    assert accepted["sender"] == "gate"


@pytest.mark.long
def test_trace_of_a_resting_robot_reports_that_it_waits(cli: Command, robot: RobotProcess) -> None:
    assert robot.call("release")["status"] == "success"
    done = cli.run("trace", "so101", "--seconds", "5")
    assert (done.returncode, done.stdout) == (0, "")
    assert done.stderr == "the processes of so101 have exchanged no message yet. Still waiting, Ctrl-C ends this\n"


@pytest.mark.long
def test_trace_of_an_unknown_robot_names_the_running_robots(cli: Command, robot: RobotProcess) -> None:
    done = cli.run("trace", "nobody")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert "so101" in done.stderr
