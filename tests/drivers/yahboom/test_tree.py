"""Test a real robot on the twin: stops, lifetimes, the arm, the operator, a hung bridge. The twin's log shows
the safety."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.yahboom import messages as m
from strands_actors.kernel.processes.guard import ALLOW, ALLOW_TOPICS
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import armed, first_safe, is_lost_while_stuck, robot_on

"""For a machine that runs other tests at the same time."""


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("yahboom_m3pro", tmp_path) as process:
        yield process


@pytest.fixture
def m3(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(f"ws://{twin.port}", "yahboom_m3pro") as robot:
        yield robot


def message(entry: Entry) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(entry.data)["msg"]
    return found


def of(entries: list[Entry], topic: str) -> list[dict[str, Any]]:
    return [message(entry) for entry in entries if json.loads(entry.data)["topic"] == topic]


def drive(robot: RealRobot, twin: Twin, **speeds: float) -> int:
    """Send a twist and wait until it is on the wire. Return when it was sent."""
    armed(robot)
    began_ns = time.monotonic_ns()
    json_of(robot.send_action({"linear.x": 0.0, **{key.replace("_", "."): value for key, value in speeds.items()}}))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def test_saf_001_a_twist_is_repeated_for_its_lifetime_and_ends_in_zero(m3: RealRobot, twin: Twin) -> None:
    began_ns = drive(m3, twin, linear_x=0.5, angular_z=-1.0)
    zero = first_safe(twin.log, began_ns)
    assert (zero.t_ns - began_ns) / 1e9 > 0.25
    sent = of(twin.log.host("setpoint", began_ns), m.CMD_VEL)
    assert 2 <= len(sent) <= 4, "the twist is re-sent at 10 Hz for its lifetime"
    assert all(one == m.twist_message(m.Twist(0.5, 0.0, -1.0)) for one in sent)
    time.sleep(0.4)
    twin.log.no_setpoint_after_safe(began_ns)
    assert state(m3) == "holding"
    drive(m3, twin, linear_x=0.1)  # a late writer may go on


def test_saf_001_the_arm_keeps_the_twist_and_does_not_prolong_it(m3: RealRobot, twin: Twin) -> None:
    json_of(m3.home())
    began_ns = drive(m3, twin, linear_x=0.5)
    for arm in (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8):
        time.sleep(0.05)
        json_of(m3.send_action({"arm1": arm}))
    time.sleep(0.5)
    sent = twin.log.host("setpoint", began_ns)
    moving = [one for one in sent if json.loads(one.data)["topic"] == m.CMD_VEL and message(one)["linear"]["x"]]
    assert (moving[-1].t_ns - began_ns) / 1e9 <= 0.3 + 0.1
    arm_goals = [one for one in sent if json.loads(one.data)["topic"] == m.ARM]
    assert any(one.t_ns < moving[-1].t_ns for one in arm_goals), "the arm moved while it drove"


def test_an_arm_goal_goes_out_once_in_whole_degrees_and_the_others_stay(m3: RealRobot, twin: Twin) -> None:
    assert "unknown" in why(m3.send_action({"arm1.pos": 0.5})), "the robot does not report its arm"
    began_ns = time.monotonic_ns()
    json_of(m3.home())
    until(lambda: of(twin.log.host("setpoint", began_ns), m.ARM), "the goal of home")
    began_ns = time.monotonic_ns()
    answer = json_of(m3.send_action({"arm1.pos": 0.5, "time_ms": 400}))
    assert answer == {"arm_deg": [119, 120, 0, 0, 90, 180], "time_ms": 400}
    time.sleep(0.6)
    assert set(m3.get_observation()) == {"linear.x", "linear.y", "angular.z"}
    goals = of(twin.log.host("setpoint", began_ns), m.ARM)
    assert goals == [m.arm_message(m.ArmGoal((119, 120, 0, 0, 90, 180), 400))]
    assert of(twin.log.host("setpoint", began_ns), m.CMD_VEL) == [], "nothing is sent to the base"


def test_saf_005_a_stop_is_repeated_until_odometry_shows_that_it_stands(m3: RealRobot, twin: Twin) -> None:
    drive(m3, twin, linear_x=1.0)
    time.sleep(0.2)
    began_ns = time.monotonic_ns()
    stopped = json_of(m3.stop())
    assert stopped["safe_state"] == "zero" and len(stopped["motors"]) == 9
    first_safe(twin.log, began_ns)
    zeros = twin.log.host("safe", began_ns)
    assert len(zeros) >= 3
    assert all(message(one) == m.twist_message(m.REST, stop=True) for one in zeros)
    twin.log.no_setpoint_after_safe(began_ns)
    assert "Call resume() first" in why(m3.send_action({"linear.x": 0.1}))
    json_of(m3.resume())
    assert twin.log.setpoints_after_safe(began_ns) == 0, "no setpoint is sent after the stop, not even by a resume"


def test_saf_005_a_base_whose_odometry_moves_is_not_reported_as_stopped(m3: RealRobot, twin: Twin) -> None:
    drive(m3, twin, linear_x=0.5)
    twin.fault("wrong")
    until(lambda: m3.get_observation()["linear.x"] > 0.7, "it reports too much")
    began_ns = time.monotonic_ns()
    assert "not confirmed: it reports speed" in why(m3.stop())
    assert len(twin.log.host("safe", began_ns)) > 5, "zero is repeated"
    twin.fault("ok")
    until(lambda: state(m3) == "disarmed", "it is confirmed when it can be")


@pytest.mark.long
def test_saf_010_a_command_in_the_socket_of_a_stopped_bridge_is_followed_by_zero(m3: RealRobot, twin: Twin) -> None:
    """The bridge is stopped with a command in its socket. The caller stops, then the bridge continues."""
    drive(m3, twin, linear_x=0.3)
    twin.pause()
    m3.send_action({"linear.x": 0.9})
    time.sleep(0.05)
    assert "not confirmed" in why(m3.stop())
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: twin.log.host("safe", back_ns), "a zero")
    until(lambda: state(m3) == "disarmed", "it is back, disarmed, and confirmed")
    time.sleep(0.3)
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    until(lambda: m3.get_observation().get("linear.x") == 0.0, "it stands")


def test_saf_002_a_bridge_that_was_away_for_a_second_carries_out_zero_last(m3: RealRobot, twin: Twin) -> None:
    """Its writer continues all the time at 100 Hz. The queue is bounded, and the link counts as lost."""
    drive(m3, twin, linear_x=0.3)
    twin.pause()
    until_s = time.monotonic() + 1.0
    while time.monotonic() < until_s:
        m3.send_action({"linear.x": 0.9})
        time.sleep(0.01)
    back_ns = time.monotonic_ns()
    twin.go_on()
    until_s = time.monotonic() + 0.5
    while time.monotonic() < until_s:
        m3.send_action({"linear.x": 0.9})
        time.sleep(0.01)
    until(lambda: state(m3) == "disarmed", "it is back, disarmed")
    assert len(twin.log.host("setpoint", back_ns)) <= 8, "at most 8 of a hundred setpoints are carried out"
    twin.log.no_setpoint_after_safe(back_ns)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_roots_own_connection_stops_the_base(m3: RealRobot, twin: Twin, number: signal.Signals) -> None:
    drive(m3, twin, linear_x=0.5)
    began_ns = time.monotonic_ns()
    os.kill(pids(m3)["wire"], number)
    first_safe(twin.log, began_ns)
    time.sleep(0.3)
    twin.log.no_setpoint_after_safe(began_ns)
    until(lambda: state(m3) == "disarmed", "a new wire, disarmed")


def test_saf_020_a_cable_that_is_back_carries_zero_before_any_question(m3: RealRobot, twin: Twin) -> None:
    drive(m3, twin, linear_x=0.5)
    twin.unplug()
    until(lambda: state(m3) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    zero = first_safe(twin.log, back_ns)
    before = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.t_ns < zero.t_ns]
    assert not any(b"rosapi" in one.data or one.kind == "setpoint" for one in before)
    until(lambda: state(m3) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)


def test_saf_012_a_base_that_repeats_its_report_is_lost_and_sent_nothing(m3: RealRobot, twin: Twin) -> None:
    """Every socket is open, and every answer arrives."""
    drive(m3, twin, linear_x=0.2)
    is_lost_while_stuck(m3, twin, {"linear.x": 0.2}, "not changed its stamp")


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["garbage", "intermittent", "delayed", "slow"])
def test_saf_006_a_stop_is_sent_at_once_with_any_answer_of_the_bridge(
    m3: RealRobot, twin: Twin, fault: str
) -> None:
    drive(m3, twin, linear_x=0.5)
    twin.fault(fault)
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    m3.stop()
    first_safe(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(m3) == "disarmed", "confirmed at last")


@pytest.mark.parametrize("transport", ["rosbridge", "ros2"])
def test_saf_003_the_root_does_not_load_the_wire(transport: str) -> None:
    script = (
        "from strands_actors.drivers.yahboom.driver import YahboomM3Pro\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        f"driver = YahboomM3Pro('yahboom_m3pro', '', {{'transport': '{transport}'}})\n"
        "driver.preload()\n"
        "driver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "strands_actors.drivers.yahboom.stop" in loaded
    unwanted = (
        "strands_actors.drivers.yahboom.wire",
        "httpx",
        "numpy",
    )
    assert [name for name in unwanted if name in loaded] == []


def test_saf_014_refusals_write_nothing(m3: RealRobot, twin: Twin) -> None:
    json_of(m3.home())
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    for action, text in (
        ({"linear.x": 1.5}, "is past 1.0000"),
        ({"arm2": 110}, "radians are expected"),
        ({"arm1": 0.1, "time_ms": 40_000}, "1 to 30000"),
        ({"linear_x": 0.1}, "is not a joint"),
        ({}, "names no joint"),
    ):
        assert text in why(m3.send_action(action))
    assert twin.log.host("setpoint", began_ns) == []


def test_a_policy_is_refused_with_the_reason(m3: RealRobot) -> None:
    assert "does not report its arm's position" in why(m3.run_policy(lambda seen: {"linear.x": 0.1}, duration=1.0))


def test_sensors(m3: RealRobot) -> None:
    until(lambda: "rpy_rad" in status(m3)["sensors"] and "scan1_nearest_m" in status(m3)["sensors"], "all of them")
    sensors = status(m3)["sensors"]
    assert sensors["scan0_nearest_m"] == [2.0]
    assert sensors["odometry_linear_m_s"] == [0.0, 0.0]
    assert sensors["acceleration_m_s2"] == [0.0, 0.0, 9.81]


# -- the right to drive


def asked(robot: RealRobot, given: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to an agent."""
    return asyncio.run(robot.use_tool(given, "an agent"))


def test_an_agents_twist_needs_approval_and_its_zero_does_not(
    m3: RealRobot, twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in (ALLOW, ALLOW_TOPICS):
        monkeypatch.delenv(variable, raising=False)
    json_of(m3.home())
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    refusal = why(asked(m3, {"action": "move", "linear.x": 0.2}))
    assert "linear.x needs an operator's approval: no operator can be asked" in refusal
    assert twin.log.host("setpoint", began_ns) == []
    json_of(asked(m3, {"action": "move"}))
    json_of(asked(m3, {"action": "move", "linear.x": 0, "angular.z": 0.0}))
    json_of(asked(m3, {"action": "arm", "arm1": 0.1}))
    monkeypatch.setenv(ALLOW_TOPICS, "/cmd_vel")
    assert json_of(asked(m3, {"action": "move", "linear.x": 0.2}))["twist"]["linear.x"] == 0.2
    json_of(asked(m3, {"action": "stop"}))
