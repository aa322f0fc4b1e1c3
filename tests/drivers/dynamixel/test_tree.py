"""Test a koch end to end: caller, root, wire and twin as real processes. The twin's log decides."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.drivers.common.dynamixel import protocol as p
from strands_actors.drivers.common.dynamixel import table as t
from strands_actors.testing.twin import Twin
from tests.answers import PATIENCE_S, json_of, pids, status, until

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("koch", tmp_path) as process:
        yield process


@pytest.fixture
def arm(twin: Twin) -> Iterator[Any]:
    robot = Robot("koch", mode="real", port=twin.port)
    problem = robot.connect_eagerly()
    try:
        assert problem is None, problem
        yield robot
    finally:
        robot.cleanup()


def settled(arm: Any, state: str) -> None:
    until(lambda: status(arm).get("state") == state, f"the robot is {state}")


def moving(arm: Any) -> None:
    """Send a setpoint, which stays live and is re-sent."""
    json_of(arm.send_action({"shoulder_pan": 30.0}))


def safe_and_quiet(twin: Twin, since_ns: int, safe_state: str = "limp") -> None:
    """Assert that all motors were brought to the safe state, and no setpoint followed."""
    until(
        lambda: [entry for entry in twin.log.host("safe", since_ns) if entry.safe_state == safe_state],
        f"a frame that brings all to {safe_state}",
    )
    time.sleep(0.3)
    assert twin.log.setpoints_after_safe(since_ns) == 0


def test_connect_observe_act_refuse_stop_resume(arm: Any, twin: Twin) -> None:
    reported = status(arm)
    assert reported["state"] == "armed"
    assert reported["firmware_watchdog"].startswith("bus watchdog (register 98) armed at 0.3 s and read back")
    assert reported["operating_mode"]["gripper"] == "current-based position"
    assert set(arm.get_observation()) == set(JOINTS)

    assert json_of(arm.send_action({"shoulder_pan": 20.0, "gripper.pos": 60.0}))["commanded"] == {
        "shoulder_pan": 20.0,
        "gripper": 60.0,
    }
    until(lambda: abs(arm.get_observation().get("gripper", 0.0) - 60.0) < 5.0, "the gripper is open")
    refused = arm.send_action({"gripper": 101.0})
    assert refused["status"] == "error"
    assert refused["content"][0]["text"] == "move: gripper 101.0 % is past 100.0. Stay within 0.0..100.0"

    began_ns = time.monotonic_ns()
    stopped = json_of(arm.stop())
    assert stopped["stopped"] and stopped["unconfirmed"] == []
    assert all(motor["safe"] for motor in stopped["motors"].values())
    safe_and_quiet(twin, began_ns)
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "error"

    resumed = json_of(arm.resume())
    assert resumed["position"]["shoulder_pan"] == pytest.approx(20.0, abs=10.0)
    assert status(arm)["faults"] == {}


def test_a_policy_runs_and_stop_task_holds(arm: Any, twin: Twin) -> None:
    json_of(arm.start_task("wave", policy_provider="mock", duration=20.0))
    until(lambda: json_of(arm.get_task_status())["steps"] > 10, "it steps")
    began_ns = time.monotonic_ns()
    assert json_of(arm.stop_task())["running"] is False
    safe_and_quiet(twin, began_ns, "hold")
    settled(arm, "holding")
    moving(arm)


def test_the_bus_watchdog_is_armed_on_every_servo_before_the_first_setpoint(arm: Any, twin: Twin) -> None:
    moving(arm)
    until(lambda: twin.log.host("setpoint"), "a setpoint")
    armed = p.sync_write(t.BUS_WATCHDOG, dict.fromkeys(range(1, 7), 15))
    order = [entry.kind if entry.data != armed else "watchdog" for entry in twin.log.entries()]
    assert "watchdog" in order
    assert order.index("watchdog") < order.index("setpoint")
    assert order.index("enable") < order.index("watchdog")


def test_the_firmware_stops_the_arm_after_all_our_processes_are_killed(arm: Any, twin: Twin) -> None:
    """None of our processes is left, so the firmware stops the arm."""
    moving(arm)
    victims = [pids(arm)[role] for role in ("root", "wire", "standby")]
    for pid in victims:
        os.kill(pid, signal.SIGSTOP)  # so that no process acts on the end of the others
    for pid in victims:
        os.kill(pid, signal.SIGKILL)
    time.sleep(1.0)
    began_ns = time.monotonic_ns()
    json_of(arm.resume())
    first = next(entry for entry in twin.log.entries(began_ns) if entry.kind in ("safe", "enable", "setpoint"))
    assert first.kind == "safe", "energised motors are released before they are armed again"
    tripped = [
        entry
        for entry in twin.log.entries()
        if entry.sender == "robot"
        for packet in p.Decoder().feed(entry.data)
        if len(packet.params) == 83
        and t.BUS_WATCHDOG.decode(packet.params, t.TORQUE_ENABLE.address) == t.WATCHDOG_TRIPPED
    ]
    assert tripped, "register 98 (bus watchdog) read -1"
    moving(arm)


def test_the_cable_is_pulled_and_put_back(arm: Any, twin: Twin) -> None:
    moving(arm)
    twin.unplug()
    until(lambda: not status(arm)["connected"], "the loss is noticed")
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "error"
    twin.plug()
    began_ns = time.monotonic_ns()
    settled(arm, "disarmed")
    safe_and_quiet(twin, began_ns)
    json_of(arm.resume())
    moving(arm)


def test_one_servo_loses_its_power_and_is_named(arm: Any, twin: Twin) -> None:
    twin.fault("off:3")
    until(lambda: status(arm)["faults"].get("elbow_flex") == "silent", "the fault is told")
    stopped = arm.stop()
    assert stopped["status"] == "error"
    assert "elbow_flex" in stopped["content"][0]["text"]


def test_the_robot_freezes_and_comes_back(arm: Any, twin: Twin) -> None:
    moving(arm)
    twin.pause()
    try:
        until(lambda: not status(arm)["connected"], "the loss is noticed")
        began_s = time.monotonic()
        status(arm)
        assert time.monotonic() - began_s < 1.0
    finally:
        twin.go_on()
    settled(arm, "disarmed")
    json_of(arm.resume())
    moving(arm)


@pytest.mark.quick_cases(2)
@pytest.mark.parametrize("how", ["frozen", "unplugged"])
@pytest.mark.parametrize("frames", [0, 3, 10, 30, 80])
def test_saf_012_the_robot_goes_while_connecting(twin: Twin, frames: int, how: str) -> None:
    """The tree still answers, a stop is bounded, and connecting works when the robot is back."""
    go, come = (twin.pause, twin.go_on) if how == "frozen" else (twin.unplug, twin.plug)
    robot = Robot("koch", mode="real", port=twin.port)
    problems: list[str | None] = []
    connecting = threading.Thread(target=lambda: problems.append(robot.connect_eagerly()), daemon=True)
    try:
        if frames == 0:
            go()
        connecting.start()
        until(
            lambda: problems or sum(entry.sender == "host" for entry in twin.log.entries()) >= frames, "connecting"
        )
        if frames:
            go()
        for _ in range(10):
            began_s = time.monotonic()
            status(robot)
            assert time.monotonic() - began_s < 1.0
            time.sleep(0.02)
        began_s = time.monotonic()
        robot.stop()
        assert time.monotonic() - began_s < 4.0
        connecting.join(PATIENCE_S)
        assert problems, "connecting ends with an error"
        come()
        until(lambda: robot.connect_eagerly() is None, "it is connected")
        moving(robot)
    finally:
        come()
        robot.cleanup()
