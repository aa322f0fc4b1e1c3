"""Test an xArm's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import functools
import math
import os
import signal
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.xarm import protocol as p
from strands_actors.testing import Twin
from tests import trees
from tests.answers import json_of, pids, resumed, state, status, until, why
from tests.trees import Step, made_safe, robot_on, run_for, set_moving, shared_twin

"""Added to the published bounds, for a busy machine."""

JOINTS = [f"joint{number}" for number in range(1, 8)]
STOP = b"\x0c\x04"


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("xarm7", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    with shared_twin(twin_process, "error 0") as process:
        yield process


@pytest.fixture
def arm(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "xarm7") as connected:
        yield connected


@pytest.fixture
def moving(arm: RealRobot, twin: Twin) -> RealRobot:
    set_moving(arm, twin.log, wave)
    return arm


def wave() -> Step:
    return trees.wave({"joint1": 0.3}, 0.02)


def nudge(arm: RealRobot) -> Mapping[str, Any]:
    return trees.nudge(arm, "joint1")


def comes_back(arm: RealRobot, twin: Twin) -> None:
    trees.comes_back(arm, twin.log, lambda: nudge(arm))


def controller_state(twin: Twin) -> int:
    """Read the state as another client of the controller does."""
    host, port = twin.port.split(":")
    with socket.create_connection((host, int(port)), 5.0) as other:
        other.sendall(p.request(1, p.Register.GET_STATE))
        return other.recv(64)[8]


# -- the verbs


def test_connect_observe_act_stop_resume(arm: RealRobot, twin: Twin) -> None:
    reported = status(arm)
    assert (reported["state"], reported["firmware"], reported["arm_type"]) == ("armed", "1.12.10", 7)
    assert reported["speed_limit"] == "the controller's"
    assert reported["firmware_watchdog"].startswith("The firmware has no watchdog")
    assert reported["sensors"]["tcp_xyz_m"] == pytest.approx([0.4, 0.0, 0.4], abs=0.1), "the position is in metres"
    seen = arm.get_observation()
    assert list(seen) == JOINTS
    answer = json_of(arm.send_action({"joint1": seen["joint1"] + 0.02}))
    assert answer == {"robot": "xarm7", "joints": {"joint1": pytest.approx(seen["joint1"] + 0.02)}}
    until(lambda: abs(arm.get_observation()["joint1"] - seen["joint1"] - 0.02) < 0.005, "it is there")

    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert stopped["safe_state"] == "stop"
    assert list(stopped["motors"]) == JOINTS
    made_safe(twin.log, began_ns)
    assert twin.log.first_safe(began_ns).data[6:] == STOP  # type: ignore[union-attr]
    assert controller_state(twin) == p.State.STOPPED
    time.sleep(0.5)
    assert controller_state(twin) == p.State.STOPPED, "the controller stays stopped"
    comes_back(arm, twin)


def test_the_pose_of_the_tool_agrees_with_the_controllers(arm: RealRobot) -> None:
    pose = json_of(arm.get_pose())
    assert pose["reported_xyz"] == pytest.approx(pose["xyz"], abs=1e-3)
    assert pose["apart_m"] < 1e-3


def test_saf_014_refusals_name_the_joint_and_write_nothing(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    assert "joint4 is nan" in why(arm.send_action({"joint4": math.nan}))
    assert "joint4 4.0000 rad is past 3.9269" in why(arm.send_action({"joint4": 4.0}))
    assert "joint4 steps" in why(arm.send_action({"joint4": 0.0}))
    assert "gripper is not a joint of xarm7" in why(arm.send_action({"gripper": 0.0}))
    time.sleep(0.1)
    assert not twin.log.host("setpoint", began_ns)


def test_a_policy_runs_at_100_hz_and_ends_in_a_hold(arm: RealRobot, twin: Twin) -> None:
    task = run_for(arm, wave, 2.0)
    assert task["steps"] > 60, "a third of the rate on a free machine"
    assert state(arm) == "holding"
    held_ns = time.monotonic_ns()
    time.sleep(0.3)
    assert not twin.log.host("setpoint", held_ns)
    assert twin.log.host("safe")[-1].safe_state == "hold"
    assert controller_state(twin) in (p.State.MOVING, p.State.READY)
    json_of(nudge(arm))
    assert state(arm) == "armed"


def test_a_selected_control_frequency(twin: Twin, run_dir: Path) -> None:
    with robot_on(twin.port, "xarm7", control_frequency=50) as arm:
        here = arm.get_observation()["joint1"]
        assert "the limit is 0.0628 at 50 Hz" in why(arm.send_action({"joint1": here + 0.1}))
        json_of(arm.send_action({"joint1": here + 0.06}))


# -- refusals of the controller


@pytest.mark.quick_cases(4)
@pytest.mark.parametrize(
    ("order", "says"),
    [
        ("error 31", "the controller reports error 31 (collision)"),
        ("state 3", "arm is paused (state 3)"),
        ("state 4", "arm is stopped (state 4)"),
        ("mode 0", "arm is"),  # stopped, or in mode 0: either may reach the tree first
    ],
)
@pytest.mark.parametrize("how", ["moves", "stands", "holds"])
def test_saf_003_the_controller_stops_by_itself_or_by_another_client(
    arm: RealRobot, twin: Twin, order: str, says: str, how: str
) -> None:
    """In any activity the tree notices it, makes safe and gives the reason. No motion continues by itself."""
    if how == "moves":
        set_moving(arm, twin.log, wave)
    elif how == "stands":
        json_of(nudge(arm))
    else:
        run_for(arm, wave, 0.2)
        assert state(arm) == "holding"
    ordered_ns = time.monotonic_ns()
    twin.order(order)
    until(lambda: state(arm) == "disarmed", "it is disarmed")
    cause = status(arm)["cause"]
    assert says in cause or "arm is stopped (state 4)" in cause, cause
    until(lambda: twin.log.first_safe(ordered_ns), "a safe frame of ours")
    time.sleep(0.2)
    twin.log.no_setpoint_after_safe(ordered_ns)
    assert "Call resume() first" in why(nudge(arm))
    if order.startswith("error"):
        assert "the controller reports error 31 (collision). Clear it at the arm" in why(arm.resume())
        assert not twin.log.host("enable", ordered_ns), "the command is refused before anything is energised"
        twin.order("error 0")
    resumed(arm)
    json_of(nudge(arm))


def test_connecting_names_an_error_and_energises_nothing(twin: Twin, run_dir: Path) -> None:
    twin.order("error 31")
    arm = Robot("xarm7", mode="real", port=twin.port)
    try:
        until(lambda: "enable: the controller reports error 31" in (arm.connect_eagerly() or ""), "it says so")
        assert status(arm)["connected"], "a refused robot stays connected"
        assert not twin.log.host("enable")
        twin.order("error 0")
        until(lambda: arm.connect_eagerly() is None, "it connects when it is cleared")
    finally:
        arm.cleanup()


def test_a_port_without_a_listener_is_named(run_dir: Path) -> None:
    arm = Robot("xarm7", mode="real", port="127.0.0.1:9")
    try:
        assert "cannot connect" in (arm.connect_eagerly() or "")
    finally:
        arm.cleanup()


# -- processes die and freeze


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_wire_process_dies_or_freezes(moving: RealRobot, twin: Twin, fault: signal.Signals) -> None:
    """The root stops the arm over its own connection, and restarts the wire."""
    victim = pids(moving)["wire"]
    began_ns = time.monotonic_ns()
    os.kill(victim, fault)
    made_safe(twin.log, began_ns)
    assert twin.log.first_safe(began_ns).data[6:] == STOP  # type: ignore[union-attr]
    comes_back(moving, twin)
    assert pids(moving)["wire"] != victim


# -- the controller freezes, or its network goes


@pytest.mark.long
def test_saf_010_late_setpoints_of_a_frozen_controller_are_followed_by_the_stop(
    moving: RealRobot, twin: Twin
) -> None:
    twin.pause()
    until(lambda: not status(moving)["connected"], "it is noticed")
    assert "not confirmed by joint1" in why(moving.stop())
    thawed_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(moving) == "disarmed", "it is back, disarmed")
    assert twin.log.host("safe", thawed_ns)
    late = twin.log.host("setpoint", thawed_ns)
    assert len(late) < 15, "only the setpoints that were under way arrive"
    assert twin.log.setpoints_after_safe(thawed_ns) == 0
    assert controller_state(twin) == p.State.STOPPED
    comes_back(moving, twin)


def test_saf_005_stop_of_a_frozen_controller_is_an_error_that_names_every_joint(
    moving: RealRobot, twin: Twin
) -> None:
    twin.pause()
    time.sleep(0.1)
    answer = moving.stop()
    assert all(joint in why(answer) for joint in JOINTS), answer
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
    assert twin.log.first_safe(plugged_ns).data[6:] == STOP  # type: ignore[union-attr]


@pytest.mark.parametrize("fault", ["garbage", "off"])
def test_the_tree_recovers_from_invalid_answers(moving: RealRobot, twin: Twin, fault: str) -> None:
    twin.fault(fault)
    until(lambda: not status(moving)["connected"], "the loss is noticed")
    if fault == "garbage":
        began_ns = time.monotonic_ns()
        assert "not confirmed" in why(moving.stop())
        assert twin.log.first_safe(began_ns) is not None, "a stop is written although the answers cannot be decoded"
    twin.fault("ok")
    comes_back(moving, twin)


def test_power_cycled(moving: RealRobot, twin: Twin) -> None:
    twin.power_cycle()
    comes_back(moving, twin)


def test_it_comes_back_however_often_it_is_unplugged(arm: RealRobot, twin: Twin) -> None:
    for _ in range(5):
        twin.unplug()
        until(lambda: not status(arm)["connected"], "it is noticed")
        twin.plug()
        until(lambda: state(arm) == "disarmed", "it is back")
        json_of(arm.resume())
    json_of(nudge(arm))


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("how", ["frozen", "unplugged"])
@pytest.mark.parametrize("frames", [1, 2, 3, 4, 5, 6, 7])
def test_saf_012_the_controller_goes_while_connecting(twin: Twin, run_dir: Path, frames: int, how: str) -> None:
    """The tree still answers, a stop is bounded, and connecting works when the controller is back."""
    arm = Robot("xarm7", mode="real", port=twin.port)
    connecting = threading.Thread(target=arm.connect_eagerly)
    try:
        connecting.start()
        has_frames = functools.partial(
            lambda: sum(entry.sender == "host" for entry in twin.log.entries()) >= frames
        )
        until(has_frames, f"{frames} frames")
        twin.pause() if how == "frozen" else twin.unplug()
        arm.stop()
        twin.go_on()
        twin.plug()
        connecting.join(30.0)
        assert not connecting.is_alive()
        until(lambda: arm.connect_eagerly() is None, "it connects", 60.0)
        json_of(nudge(arm))
    finally:
        twin.go_on()
        arm.cleanup()


# -- together with other clients


def test_another_client_may_look_while_it_moves(moving: RealRobot, twin: Twin) -> None:
    for _ in range(5):
        assert controller_state(twin) == p.State.MOVING
        time.sleep(0.05)
    assert json_of(moving.get_task_status())["running"]


def test_an_arm_of_another_type_is_gated_by_its_own_range(tmp_path: Path, run_dir: Path) -> None:
    from tests.drivers.common.twin_process import TwinProcess

    with TwinProcess(tmp_path, "xarm7", "xarm", options={"arm_type": 3, "port": 0}) as process:
        arm = Robot("xarm7", mode="real", port=process.port)
        try:
            assert not process.port.endswith(":502"), "the port differs, as for a user without the right to use 502"
            assert arm.connect_eagerly() is None
            here = arm.get_observation()["joint4"]
            assert here < -0.2, "joint 4 bends to the other side"
            json_of(arm.send_action({"joint4": here - 0.02}))
            assert "is past 0.1919" in why(arm.send_action({"joint4": 0.3}))
        finally:
            arm.cleanup()


def test_no_process_is_left(twin: Twin, run_dir: Path) -> None:
    with robot_on(twin.port, "xarm7") as arm:
        victims = [pids(arm)[role] for role in ("root", "wire")]
        ended_ns = time.monotonic_ns()
    until(lambda: not any(_runs(one) for one in victims), "every process is gone")
    assert twin.log.first_safe(ended_ns) is not None
    assert controller_state(twin) == p.State.STOPPED


def _runs(one: int) -> bool:
    try:
        os.kill(one, 0)
    except ProcessLookupError:
        return False
    return True
