"""Test a user's class in a tree. The robot's own log has its commands."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers import register_native_driver
from strands_actors.surfaces.recording import read, replay
from tests.answers import alive, json_of, pids, state, status, task_ended, until, why
from tests.mesh.subscriber import Subscriber

from .conftest import NewRobot
from .rig import SmallArm
from .small_arm import DeclaredArmDriver, SensingArmDriver, SilentArmDriver, SmallArmDriver


def test_a_script_of_the_page_runs_and_its_object_is_in_the_wire_process(
    new_robot: NewRobot, small_arm: SmallArm
) -> None:
    robot = new_robot(SmallArmDriver)
    assert robot.get_observation() == {"pan": 1.5, "lift": -2.5}
    reported = status(robot)
    assert reported["driver_class"] == "tests.drivers.plain.small_arm.SmallArmDriver"
    assert reported["axes_from"] == "the first observation"
    assert reported["stop_channel"] == "none: a fresh process calls stop()"
    assert json_of(robot.send_action({"pan.pos": 10.0}))["commanded"] == {"pan": 10.0}
    until(lambda: robot.get_observation()["pan"] == 10.0, "it moves")
    assert [line.text for line in small_arm.said("goal")] == ["goal pan.pos=10.0"]  # only the named axis
    assert json_of(robot.stop())["safe_state"] == "stop"
    assert json_of(robot.cleanup())["safe_state"] == "off"
    assert [line.text for line in small_arm.log][-2:] == ["stop", "bye"]


def test_sensors_that_are_members_of_the_class_reach_the_mesh(new_robot: NewRobot) -> None:
    robot = new_robot(SensingArmDriver)
    sensors = status(robot)["sensors"]
    assert sensors == {
        "imu.rpy": [0.1, 0.2, 0.3],
        "imu.accel": [0.0, 0.0, 9.8],
        "odom.x": [1.0],
        "odom.y": [2.0],
        "odom.theta": [0.5],
        "battery.pct": [73.0],
    }
    subscriber = Subscriber()
    try:
        assert {"imu", "odom", "battery"} <= set(subscriber.record("presence")["topics"])
        assert subscriber.record("imu")["rpy"] == [0.1, 0.2, 0.3]
        assert subscriber.record("odom")["theta"] == 0.5
        assert subscriber.known("health", "battery_pct") == 73.0
        assert "pose" not in subscriber.record("presence")["topics"] and subscriber.silent("pose")
        assert robot.get_observation() == {"pan": 1.5, "lift": -2.5}  # independent of the pose
    finally:
        subscriber.close()


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize(
    ("action", "text"),
    [
        ({"elbow": 1.0}, "elbow is not a joint of small_arm. Use pan, lift"),
        ({"pan": float("nan")}, "pan is nan"),
        ({"pan": "fast"}, "pan is fast"),
        ({"pan": 1.0, "pan.pos": 2.0}, "both given"),
        ({}, "names no joint"),
        ({"pan": 91.0}, "pan 91.0000 degrees is past 90.0000"),
    ],
)
def test_saf_014_a_refused_command_never_reaches_the_class(
    new_robot: NewRobot, small_arm: SmallArm, action: dict[str, object], text: str
) -> None:
    robot = new_robot(DeclaredArmDriver)
    assert text in why(robot.send_action(action))
    assert small_arm.said("goal") == []


def test_saf_014_a_stream_faster_than_the_declared_speed_is_refused(
    new_robot: NewRobot, small_arm: SmallArm
) -> None:
    robot = new_robot(DeclaredArmDriver)
    json_of(robot.run_policy(lambda observation: {"pan": observation["pan"] + 50.0}, duration=2.0))
    assert task_ended(robot)["refusal"] == "too_fast"
    assert small_arm.said("goal") == []


def test_a_refusal_by_the_class_stops_the_robot_and_is_reported(new_robot: NewRobot, small_arm: SmallArm) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"lift": 81.0}))
    reported = until(lambda: None if (now := status(robot))["state"] == "armed" else now, "it is stopped")
    assert "lift does not go that far" in reported["cause"]
    assert small_arm.said("goal") == []
    until(lambda: state(robot) == "disarmed", "that is over")
    assert "disarmed" in why(robot.send_action({"lift": 10.0}))
    json_of(robot.resume())
    json_of(robot.send_action({"lift": 10.0}))


# -- processes that end


def test_saf_003_the_wire_process_is_killed_and_a_fresh_one_calls_stop(
    new_robot: NewRobot, small_arm: SmallArm
) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"pan": 10.0}))
    until(lambda: small_arm.said("goal"), "it moves")
    killed_ns = time.monotonic_ns()
    os.kill(pids(robot)["wire"], signal.SIGKILL)
    until(lambda: small_arm.said("stop", killed_ns), "it is stopped")
    until(lambda: status(robot)["connected"], "there is another wire")
    assert state(robot) == "disarmed"
    assert small_arm.said("goal", killed_ns) == []
    json_of(robot.resume())
    json_of(robot.send_action({"pan": 12.0}))


def test_saf_003_a_frozen_wire_process_is_fenced_before_another_one_calls_stop(
    new_robot: NewRobot, small_arm: SmallArm
) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"pan": 10.0}))
    until(lambda: small_arm.said("goal"), "it moves")
    frozen = pids(robot)["wire"]
    os.kill(frozen, signal.SIGSTOP)
    frozen_ns = time.monotonic_ns()
    until(lambda: small_arm.said("stop", frozen_ns), "it is stopped")
    assert not alive(frozen)
    assert small_arm.said("goal", frozen_ns) == []


def test_saf_003_a_class_with_a_stop_channel_is_stopped_by_that(new_robot: NewRobot, small_arm: SmallArm) -> None:
    robot = new_robot(DeclaredArmDriver)
    assert status(robot)["stop_channel"] == "stop_channel(port) of the class"
    killed_ns = time.monotonic_ns()
    os.kill(pids(robot)["wire"], signal.SIGKILL)
    until(lambda: small_arm.said("halt", killed_ns), "it is halted")
    until(lambda: status(robot)["connected"], "there is another wire")
    assert small_arm.said("stop", killed_ns) == []


def test_saf_003_the_root_is_killed_and_the_wire_stops_its_object(new_robot: NewRobot, small_arm: SmallArm) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"pan": 10.0}))
    killed_ns = time.monotonic_ns()
    left = (pids(robot)["wire"], spare_of(robot))
    os.kill(pids(robot)["root"], signal.SIGKILL)
    until(lambda: small_arm.said("bye", killed_ns), "it is given up")
    assert small_arm.said("stop", killed_ns)
    until(lambda: not any(map(alive, left)), "nothing is left")


@pytest.mark.long
def test_saf_010_an_action_that_hangs_costs_the_process_and_is_never_done(
    new_robot: NewRobot, small_arm: SmallArm, wrong: Path
) -> None:
    robot = new_robot(SmallArmDriver)
    first = pids(robot)["wire"]
    wrong.write_text("send hangs")
    sent_ns = time.monotonic_ns()
    json_of(robot.send_action({"pan": 10.0}))
    until(lambda: small_arm.said("stop", sent_ns), "it is stopped by another process")
    wrong.unlink()
    until(lambda: status(robot)["connected"] and state(robot) == "disarmed", "there is another wire")
    assert pids(robot)["wire"] != first
    assert small_arm.said("goal") == []


def test_saf_005_a_stop_that_hangs_is_done_by_another_process(
    new_robot: NewRobot, small_arm: SmallArm, wrong: Path
) -> None:
    robot = new_robot(SmallArmDriver)
    wrong.write_text("stop hangs")
    assert "not confirmed by pan (id 0)" in why(robot.stop())  # by the wire, or by the process that ended it
    wrong.unlink()
    asked_ns = time.monotonic_ns()
    until(lambda: small_arm.said("stop", asked_ns), "it is stopped by another process")
    until(lambda: state(robot) == "disarmed", "that is known")


def test_saf_005_a_robot_that_no_process_can_stop_is_named_as_not_confirmed(
    new_robot: NewRobot, small_arm: SmallArm, wrong: Path
) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"pan": 10.0}))
    wrong.write_text("stop raises")
    os.kill(pids(robot)["wire"], signal.SIGKILL)
    until(lambda: state(robot) not in ("armed", "disarmed", "unreachable"), "it is not confirmed")
    assert "not confirmed by pan (id 0)" in why(robot.stop())
    # Either the next wire or the process that the stop channel starts reports it.
    until(lambda: "RuntimeError: the bus is upset" in why(robot.stop()), "the class's own reason is told")


def test_saf_005_a_stop_that_the_class_does_not_confirm_is_no_success(
    new_robot: NewRobot, small_arm: SmallArm, wrong: Path
) -> None:
    robot = new_robot(SmallArmDriver)
    wrong.write_text("stop is not done")
    assert "not confirmed by pan (id 0): stop: a thread hangs" in why(robot.stop())


def test_saf_012_failed_readings_are_reported_and_the_robot_is_stopped(
    new_robot: NewRobot, small_arm: SmallArm, wrong: Path
) -> None:
    robot = new_robot(SmallArmDriver)
    json_of(robot.send_action({"pan": 10.0}))
    wrong.write_text("read raises")
    failed_ns = time.monotonic_ns()
    until(lambda: small_arm.said("stop", failed_ns), "it is stopped")
    assert "no reading" in why(robot.send_action({"pan": 11.0})) or not status(robot)["connected"]
    wrong.unlink()
    until(lambda: status(robot)["connected"], "it is back")
    assert state(robot) == "disarmed"
    assert len(small_arm.said("goal")) == 1


def spare_of(robot: RealRobot) -> int:
    """Return the root's child that is ready to stop the robot."""
    root = pids(robot)["root"]
    children = Path(f"/proc/{root}/task/{root}/children").read_text().split()
    (spare,) = [int(pid) for pid in children if b" stop" in Path(f"/proc/{pid}/cmdline").read_bytes()]
    return spare


def test_saf_016_the_process_that_would_stop_the_robot_is_replaced(
    new_robot: NewRobot, small_arm: SmallArm
) -> None:
    robot = new_robot(SmallArmDriver)
    killed_ns = time.monotonic_ns()
    os.kill(spare_of(robot), signal.SIGKILL)
    until(lambda: small_arm.said("stop", killed_ns), "the robot is stopped")
    until(lambda: status(robot)["connected"], "there is another wire")
    killed_ns = time.monotonic_ns()
    os.kill(pids(robot)["wire"], signal.SIGKILL)
    until(lambda: small_arm.said("stop", killed_ns), "and another process to stop it")


# -- classes that cannot be run


def test_a_missing_robot_is_reported(small_arm_known: None) -> None:
    register_native_driver("small_arm", SmallArmDriver)
    robot = Robot("small_arm", mode="real", port="/dev/nowhere")
    problem = robot.connect_eagerly() or ""
    assert problem.startswith("connect: /dev/nowhere cannot be opened")
    robot.cleanup()


def test_a_class_without_declared_axes_is_refused(small_arm_known: None, small_arm: SmallArm) -> None:
    register_native_driver("small_arm", SilentArmDriver)
    robot = Robot("small_arm", mode="real", port=small_arm.port)
    assert "SilentArmDriver declares no axes. Give it action_features" in (robot.connect_eagerly() or "")
    assert [line.text for line in small_arm.log] == ["stop", "bye"]  # it was called, and closed in order
    robot.cleanup()


@pytest.mark.long
def test_a_connection_that_hangs_is_given_up(small_arm_known: None, small_arm: SmallArm, wrong: Path) -> None:
    register_native_driver("small_arm", DeclaredArmDriver)
    wrong.write_text("connect hangs")
    robot = Robot("small_arm", mode="real", port=small_arm.port, wrong=str(wrong))
    assert "connect did not return within" in (robot.connect_eagerly() or "")
    assert small_arm.log == []
    robot.cleanup()


# -- parts of a tree other than verbs


def test_without_the_required_drill_nothing_moves(new_robot: NewRobot, small_arm: SmallArm) -> None:
    robot = new_robot(SmallArmDriver, require_drill="30d")
    assert "no drill was passed" in why(robot.send_action({"pan": 10.0}))
    assert small_arm.said("goal") == []


def test_an_agent_needs_approval_to_move_guarded_axes(new_robot: NewRobot, small_arm: SmallArm) -> None:
    requested: list[str] = []

    def approve(request: Any) -> bool:
        requested.append(str(request))
        return len(requested) > 1

    robot = new_robot(SmallArmDriver, guarded=("move_to",), approve=approve, tool_name="left")
    verbs = robot.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert verbs == ["move_to", "sensors", "status", "stop"]
    move = {"action": "move_to", "targets": {"pan": 10.0}}
    assert "needs an operator's approval" in why(asyncio.run(robot.use_tool(move, "agent")))
    assert small_arm.said("goal") == []
    json_of(asyncio.run(robot.use_tool(move, "agent")))
    until(lambda: small_arm.said("goal"), "it moves")
    assert requested[0].startswith("agent asks left: move_to")


def test_saf_007_an_estop_stops_and_locks_it(new_robot: NewRobot, small_arm: SmallArm) -> None:
    robot = new_robot(SmallArmDriver)
    pressed_ns = time.monotonic_ns()
    (outcome,) = estop(by="a test")
    assert (outcome.robot, outcome.outcome) == ("small_arm", "safe")
    assert small_arm.said("stop", pressed_ns)
    assert "e-stopped by a test" in why(robot.send_action({"pan": 10.0}))
    json_of(robot.resume())
    json_of(robot.send_action({"pan": 10.0}))


RECORDER = "from strands_actors.surfaces.cli import main; main()"


def test_a_recording_replays_without_the_class_and_has_no_password(
    new_robot: NewRobot, small_arm: SmallArm, tmp_path: Path
) -> None:
    robot = new_robot(SmallArmDriver, password="hunter2")
    path = tmp_path / "run.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(entry for entry in sys.path if entry)}
    command = [sys.executable, "-c", RECORDER, "record", "small_arm", "-o", str(path)]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True, env=environment
    ) as recorder:
        try:
            assert recorder.stderr is not None
            assert recorder.stderr.readline().startswith("recording small_arm")
            for step in range(10):
                json_of(robot.send_action({"pan": float(step)}))
            assert "is not a joint" in why(robot.send_action({"elbow": 1.0}))
            json_of(robot.stop())
            assert "resume() first" in why(robot.send_action({"pan": 1.0}))
            recorder.send_signal(signal.SIGINT)
            _, errors = recorder.communicate(timeout=60.0)
        finally:
            recorder.kill()
    assert recorder.returncode == 0, errors
    assert b"hunter2" not in path.read_bytes()
    outcome = replay(read(path))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 10
