"""Test an RB-Y1's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests import trees
from tests.answers import json_of, resumed, state, status, until, why
from tests.trees import Step, made_safe, robot_on, run_for, set_moving, shared_twin

"""Added to the published bounds, for a busy machine."""


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("rby1", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process, "emergency-stop released", "manager ok") as process:
        yield process


@pytest.fixture
def robot(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "rby1") as connected:
        yield connected


@pytest.fixture
def moving(robot: RealRobot, twin: Twin) -> RealRobot:
    set_moving(robot, twin.log, wave, setpoints=20)
    return robot


def wave() -> Step:
    """Return a policy that moves torso and head."""
    return trees.wave({"torso_5": 0.2, "head_0": -0.2}, 0.04)


def nudge(robot: RealRobot) -> Mapping[str, Any]:
    return trees.nudge(robot, "head_0")


def comes_back(robot: RealRobot, twin: Twin) -> None:
    trees.comes_back(robot, twin.log, lambda: nudge(robot), within=0.02)


# -- the verbs


def test_connect_observe_act_stop_resume(robot: RealRobot, twin: Twin) -> None:
    reported = status(robot)
    assert (reported["state"], reported["model"], reported["limits"]) == ("armed", "A", "the robot's own model")
    assert reported["firmware_watchdog"].startswith("control_hold_time, 300 ms")
    assert reported["sensors"]["battery_pct"] == [pytest.approx(80.0, abs=0.5)]
    seen = robot.get_observation()
    assert len(seen) == 22 and next(iter(seen)) == "torso_0" and list(seen)[-1] == "head_1"
    answer = json_of(robot.send_action({"torso_5": seen["torso_5"] + 0.05}))
    assert answer == {"robot": "rby1", "joints": {"torso_5": pytest.approx(seen["torso_5"] + 0.05)}}
    until(lambda: abs(robot.get_observation()["torso_5"] - seen["torso_5"] - 0.05) < 0.01, "it is there")

    began_ns = time.monotonic_ns()
    stopped = json_of(robot.stop())
    assert stopped["safe_state"] == "stop"
    assert list(stopped["motors"]) == list(seen)
    made_safe(twin.log, began_ns)
    assert not twin.log.first_safe(began_ns).data, "the first safe frame is CancelControl"  # type: ignore[union-attr]
    comes_back(robot, twin)
    assert not twin.log.host("enable", began_ns), "the servos stayed on, so nothing is energised again"


def test_saf_014_refusals_name_the_joint_and_write_nothing(robot: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    assert "torso_0 is nan" in why(robot.send_action({"torso_0": math.nan}))
    assert "torso_0 0.3000 rad is past 0.2617" in why(robot.send_action({"torso_0": 0.3}))
    assert "head_0 steps" in why(robot.send_action({"head_0": 0.5}))
    assert "right_wheel is not a joint of rby1" in why(robot.send_action({"right_wheel": 0.0}))
    time.sleep(0.1)
    assert not twin.log.host("setpoint", began_ns)


@pytest.mark.long
def test_a_policy_runs_at_50_hz_and_ends_in_a_hold(robot: RealRobot, twin: Twin) -> None:
    task = run_for(robot, wave, 2.0)
    assert task["steps"] > 40, task
    assert state(robot) == "holding"
    held_ns = time.monotonic_ns()
    time.sleep(0.4)
    assert not twin.log.host("setpoint", held_ns)
    json_of(nudge(robot))
    assert state(robot) == "armed", "the robot is armed without a resume"


def test_a_single_command_is_repeated_so_that_the_robot_holds_on_to_it(robot: RealRobot, twin: Twin) -> None:
    json_of(nudge(robot))
    began_ns = time.monotonic_ns()
    time.sleep(1.0)
    frames = twin.log.host("setpoint", began_ns)
    assert len(frames) >= 5
    gaps = [(after.t_ns - before.t_ns) / 1e9 for before, after in itertools.pairwise(frames)]
    assert sorted(gaps)[len(gaps) // 2] < 0.3, "the command is repeated before its hold time is over"
    assert not status(robot)["faults"]


# -- refusals of the robot


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize(
    ("order", "says"),
    [
        ("emergency-stop pressed", "the emergency stop button is pressed"),
        ("manager MINOR_FAULT", "MINOR_FAULT (3)"),
        ("manager MAJOR_FAULT", "MAJOR_FAULT (4)"),
    ],
)
def test_saf_003_the_robot_stops_by_itself(moving: RealRobot, twin: Twin, order: str, says: str) -> None:
    """The tree notices it, makes safe and gives the reason. No motion continues by itself, and nothing is
    energised before the cause is gone."""
    ordered_ns = time.monotonic_ns()
    twin.order(order)
    until(lambda: state(moving) == "disarmed", "it is disarmed")
    cause = status(moving)["cause"]
    assert says in cause or "dropped our command" in cause, cause
    until(lambda: twin.log.first_safe(ordered_ns), "a safe frame of ours")
    time.sleep(0.2)
    twin.log.no_setpoint_after_safe(ordered_ns)
    assert says in why(moving.resume())
    assert not twin.log.host("enable", ordered_ns), "the command is refused before anything is energised"
    if order.startswith("manager"):
        until(lambda: moving.reset_fault_control_manager()["status"] == "success", "the fault is reset")
        until(lambda: status(moving)["sensors"]["control_manager"] == [1.0], "the manager is idle")
    else:
        twin.order("emergency-stop released")
    resumed(moving)
    json_of(nudge(moving))


def test_connecting_names_the_pressed_button_and_energises_nothing(twin: Twin, run_dir: Path) -> None:
    twin.order("emergency-stop pressed")
    robot = Robot("rby1", mode="real", port=twin.port)
    try:
        until(lambda: "emergency stop button is pressed" in (robot.connect_eagerly() or ""), "it says so")
        assert status(robot)["connected"], "a refused robot stays connected"
        assert not twin.log.host("enable")
        twin.order("emergency-stop released")
        until(lambda: robot.connect_eagerly() is None, "it connects when it is released")
    finally:
        robot.cleanup()


def test_an_estop_cuts_the_power_if_the_option_is_set(twin: Twin, run_dir: Path) -> None:
    with robot_on(twin.port, "rby1", on_estop="power_off") as robot:
        assert json_of(robot.stop())["safe_state"] == "stop"
        json_of(robot.resume())
        estopped_ns = time.monotonic_ns()
        (outcome,) = estop(by="the test", within_s=5.0)
        assert outcome.safe_state == "off"
        until(lambda: twin.log.host("safe", estopped_ns)[2:], "cancel, disable and power off")
        until(lambda: status(robot)["sensors"]["power"] == [0.0], "the motors have no power")


# -- the robot freezes, or its network goes


@pytest.mark.long
def test_saf_010_late_setpoints_of_a_frozen_robot_are_followed_by_the_stop(moving: RealRobot, twin: Twin) -> None:
    twin.pause()
    until(lambda: not status(moving)["connected"], "it is noticed")
    assert "not confirmed by torso_0" in why(moving.stop())
    thawed_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    assert twin.log.host("safe", thawed_ns)
    late = twin.log.host("setpoint", thawed_ns)
    assert len(late) < 15, "only the setpoints that were under way arrive"
    safe = twin.log.host("safe", thawed_ns)
    assert not late or late[-1].t_ns <= safe[-1].t_ns, "a stop follows the late setpoints"
    comes_back(moving, twin)


def test_saf_005_stop_of_a_frozen_robot_is_an_error_that_names_every_joint(moving: RealRobot, twin: Twin) -> None:
    joints = list(moving.get_observation())
    twin.pause()
    time.sleep(0.1)
    answer = moving.stop()
    assert all(joint in why(answer) for joint in joints), answer
    twin.go_on()
    comes_back(moving, twin)


def test_saf_012_unplugged_while_it_moves(moving: RealRobot, twin: Twin) -> None:
    twin.unplug()
    until(lambda: not status(moving)["connected"], "it is noticed")
    until(lambda: "cannot connect" in (status(moving)["connect_error"] or ""), "it says why")
    assert why(moving.stop())
    plugged_ns = time.monotonic_ns()
    twin.plug()
    comes_back(moving, twin)
    assert twin.log.first_safe(plugged_ns) is not None


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["garbage", "off", "stuck", "intermittent"])
def test_the_tree_recovers_from_missing_answers(moving: RealRobot, twin: Twin, fault: str) -> None:
    twin.fault(fault)
    if fault == "intermittent":  # every third answer is missing, and states still come
        time.sleep(0.5)
        moving.stop()
    else:
        until(lambda: not status(moving)["connected"], "the loss is noticed")
    if fault == "garbage":
        began_ns = time.monotonic_ns()
        assert "not confirmed" in why(moving.stop())
        assert twin.log.first_safe(began_ns) is not None, "a stop is written although the answers cannot be decoded"
    twin.fault("ok")
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    comes_back(moving, twin)


def test_power_cycled(moving: RealRobot, twin: Twin) -> None:
    twin.power_cycle()
    comes_back(moving, twin)


def test_it_comes_back_however_often_it_is_unplugged(robot: RealRobot, twin: Twin) -> None:
    for _ in range(5):
        twin.unplug()
        until(lambda: not status(robot)["connected"], "it is noticed")
        twin.plug()
        until(lambda: state(robot) == "disarmed", "it is back")
        json_of(robot.resume())
    json_of(nudge(robot))


def test_a_port_without_a_listener_is_named(run_dir: Path) -> None:
    robot = Robot("rby1", mode="real", port="127.0.0.1:9")
    try:
        assert "cannot connect" in (robot.connect_eagerly() or "")
    finally:
        robot.cleanup()
