"""Test a real robot on the twin: stops, lifetimes, the lease, the e-stop, a hung robot. The twin's log shows
the safety."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.spot import config
from strands_actors.drivers.spot import protocol as p
from strands_actors.drivers.spot.messages import decode
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import armed, first_safe, is_lost_while_stuck, robot_on

"""For a machine that runs other tests at the same time."""
SKEW_NS = 123_456_000_000
HASTE = 5.0


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("spot", tmp_path, options={"haste": HASTE}) as process:
        yield process


@pytest.fixture
def spot(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "spot") as robot:
        yield robot


def service(robot: RealRobot, name: str, **arguments: float) -> dict[str, Any]:
    answer: dict[str, Any] = getattr(robot, name)(**arguments)
    return answer


def stand(robot: RealRobot) -> None:
    armed(robot)
    json_of(service(robot, "stand"))


def walk(robot: RealRobot, twin: Twin, **speeds: float) -> int:
    """Send a twist and wait until it is on the wire. Return when it was sent."""
    stand(robot)
    began_ns = time.monotonic_ns()
    json_of(robot.send_action({"vx": 0.0, **speeds}))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def read(name: str, entry: Entry) -> dict[str, Any]:
    return decode(p.METHODS[name].request, entry.data)


def check_ins(twin: Twin, since_ns: int) -> list[Entry]:
    """Return the check-ins that allow power."""
    others = twin.log.host("other", since_ns)
    return [entry for entry in others if read("EstopCheckIn", entry).get("stop_level") == p.StopLevel.NONE]


def returned(twin: Twin, since_ns: int) -> bool:
    """Return True if a lease was returned: a request with a lease and nothing else."""
    for entry in twin.log.host("config", since_ns):
        with contextlib.suppress(MalformedFrame):
            told = read("ReturnLease", entry)
            if told.get("lease", {}).get("resource") == p.LEASE_RESOURCE:
                return True
    return False


def motors(robot: RealRobot) -> float:
    (now,) = status(robot)["sensors"]["motors"]
    return float(now)


def test_the_robot_stands_up_before_it_walks_and_reports_it(spot: RealRobot, twin: Twin) -> None:
    assert status(spot)["clock_skew_s"] == pytest.approx(123.456, abs=0.05)
    json_of(spot.resume())
    began_ns = time.monotonic_ns()
    assert "its motors are off. Call stand() first" in why(spot.send_action({"vx": 0.1}))
    assert twin.log.host("setpoint", began_ns) == [] and twin.log.host("enable", began_ns) == []
    json_of(service(spot, "stand"))
    assert len(twin.log.host("enable", began_ns)) == 2, "two requests: motors on, then stand"
    assert json_of(spot.send_action({"vx": 0.2, "arm_sh0": 0.3})) == {
        "robot": "spot",
        "joints": {"arm_sh0": 0.3},
        "twist": {"vx": 0.2, "vy": 0.0, "wz": 0.0},
    }
    until(lambda: spot.get_observation()["arm_sh0"] == pytest.approx(0.3), "the arm is there")
    legs = {key for key in spot.get_observation() if key.endswith(("_hx", "_hy", "_kn"))}
    assert len(legs) == 12 and legs <= json_of(spot.state())["joints"].keys(), (
        "the legs are read, but not commanded"
    )


def test_saf_004_check_ins_go_on_while_a_robot_stands_up_at_its_own_pace(tmp_path: Path, run_dir: Path) -> None:
    """The robot needs longer to power on and to stand up than its e-stop waits for a check-in."""
    with Twin("spot", tmp_path) as twin, robot_on(twin.port, "spot", estop_timeout_s=1.0) as spot:
        armed(spot)
        began_s = time.monotonic()
        assert json_of(service(spot, "stand")) == {"standing": True}
        assert 3.9 < time.monotonic() - began_s < 6.0, "2 s to power on, and 2 s to stand up"
        assert motors(spot) == p.Motors.ON
        began_s = time.monotonic()
        json_of(spot.cleanup())
        assert time.monotonic() - began_s > 2.4, "2.5 s to sit down"


def test_saf_001_a_twist_ends_on_the_robots_clock_and_nothing_repeats_it(spot: RealRobot, twin: Twin) -> None:
    began_ns = walk(spot, twin, vx=0.5)
    hold = first_safe(twin.log, began_ns)
    assert (hold.t_ns - began_ns) / 1e9 > 0.55 and hold.safe_state == "hold"
    (sent,) = twin.log.host("setpoint", began_ns)
    told = read("RobotCommand", sent)
    asked = told["command"]["synchronized_command"]["mobility_command"]["se2_velocity_request"]
    sent_ns = p.stamp_ns(told["header"]["request_timestamp"]) + SKEW_NS
    assert abs(p.stamp_ns(asked["end_time"]) - sent_ns - 600_000_000) < 50_000_000
    assert state(spot) == "holding"
    json_of(spot.send_action({"vx": 0.1}))  # a late writer may go on


@pytest.mark.long
def test_a_twist_by_its_service_is_a_twist(spot: RealRobot, twin: Twin) -> None:
    stand(spot)
    began_ns = time.monotonic_ns()
    answer = json_of(service(spot, "set_twist", vx=0.4, wz=-0.1))
    assert answer["twist"] == {"vx": 0.4, "vy": 0.0, "wz": -0.1}
    assert len(twin.log.host("setpoint", began_ns)) == 1
    until(lambda: spot.get_observation()["vx"] > 0.3, "it walks")
    until(lambda: spot.get_observation()["vx"] == 0.0, "and stands")
    assert "is past" in why(service(spot, "set_twist", vx=9.0))
    json_of(service(spot, "set_twist", vx=0.1))
    json_of(spot.stop())
    assert "Call resume() first" in why(service(spot, "set_twist", vx=0.1))


def test_saf_004_check_ins_stop_with_the_process_that_earns_them(spot: RealRobot, twin: Twin) -> None:
    stand(spot)
    began_ns = time.monotonic_ns()
    time.sleep(2.5)
    assert 2 <= len(check_ins(twin, began_ns)) <= 4, "check-ins are 1 s apart, a third of the timeout"
    os.kill(pids(spot)["wire"], signal.SIGSTOP)
    safe = first_safe(twin.log, began_ns)
    assert safe.safe_state == "settle"
    time.sleep(1.5)
    assert check_ins(twin, safe.t_ns) == []
    until(lambda: state(spot) == "disarmed", "a new wire, disarmed")


@pytest.mark.long
def test_saf_013_when_all_of_us_are_killed_at_once_the_robot_settles_by_itself(
    spot: RealRobot, twin: Twin, tmp_path: Path
) -> None:
    walk(spot, twin, vx=0.5)
    ends_ns = time.monotonic_ns()
    ours = pids(spot)
    for role in ("standby", "wire", "root"):
        os.kill(ours[role], signal.SIGKILL)
    time.sleep(0.5)
    twin.log.silent_after(ends_ns + 300_000_000, "setpoint", "enable")
    other = Robot("spot", mode="real", port=twin.port)
    try:
        until(lambda: other.connect_eagerly() is None, "another tree")
        until(lambda: motors(other) == p.Motors.OFF, "it has settled", within_s=10.0)
        assert (time.monotonic_ns() - ends_ns) / 1e9 < 3.0 + 1.0 + 3.0
    finally:
        other.cleanup()


def test_saf_005_after_a_stop_the_robot_stands_still_and_nothing_follows(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=1.0)
    time.sleep(0.2)
    began_ns = time.monotonic_ns()
    stopped = json_of(spot.stop())
    assert stopped["safe_state"] == "hold" and len(stopped["motors"]) == 10
    first_safe(twin.log, began_ns)
    assert "Call resume() first" in why(spot.send_action({"vx": 0.1}))
    assert "stand: the robot is disarmed" in why(service(spot, "stand"))
    assert twin.log.host("enable", began_ns) == []
    time.sleep(3.5)
    assert motors(spot) == p.Motors.ON, "the robot stands, because check-ins go on while all processes live"
    json_of(spot.resume())
    twin.log.no_setpoint_after_safe(began_ns)


@pytest.mark.long
def test_saf_005_a_robot_that_reports_motion_is_not_reported_as_stopped(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=0.5)
    twin.fault("wrong")
    until(lambda: spot.get_observation()["vx"] > 0.7, "it reports too much")
    assert "not confirmed: the robot reports speed" in why(spot.stop())
    twin.fault("ok")
    until(lambda: state(spot) == "disarmed", "it is confirmed when it can be")


@pytest.mark.long
def test_saf_010_a_command_in_the_socket_of_a_stopped_robot_is_followed_by_a_safe_frame(
    spot: RealRobot, twin: Twin
) -> None:
    """The robot is stopped with a command in its socket. The caller stops, then the robot continues."""
    walk(spot, twin, vx=0.3)
    twin.pause()
    spot.send_action({"arm_sh0": 1.0})
    time.sleep(0.05)
    assert "not confirmed" in why(spot.stop())
    back_ns = time.monotonic_ns()
    twin.go_on()
    first_safe(twin.log, back_ns)
    until(lambda: state(spot) == "disarmed", "it is back, disarmed, and confirmed")
    time.sleep(0.3)
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    until(lambda: spot.get_observation().get("vx") == 0.0, "it stands")


def test_saf_010_an_unanswered_service_is_followed_by_a_safe_frame(spot: RealRobot, twin: Twin) -> None:
    armed(spot)
    twin.order("mute PowerCommand")
    began_ns = time.monotonic_ns()
    assert "has not answered" in why(service(spot, "stand"))
    assert first_safe(twin.log, began_ns).safe_state == "settle"
    twin.order("mute")
    until(lambda: state(spot) == "disarmed", "it is back, disarmed")
    until(lambda: motors(spot) == p.Motors.OFF, "and without power")


@pytest.mark.long
def test_saf_002_a_robot_that_was_away_for_a_second_ends_safe(spot: RealRobot, twin: Twin) -> None:
    """Its writer continues all the time. The queue is bounded, and the link counts as lost."""
    walk(spot, twin, vx=0.3)
    twin.pause()
    until_s = time.monotonic() + 1.5
    while time.monotonic() < until_s:
        spot.send_action({"vx": 0.9})
        time.sleep(0.01)
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(spot) == "disarmed", "it is back, disarmed")
    assert len(twin.log.host("setpoint", back_ns)) <= 3, "of a hundred and fifty that were sent"
    assert first_safe(twin.log, back_ns).safe_state == "settle"


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_a_root_without_its_wire_settles_it_by_the_e_stop(
    spot: RealRobot, twin: Twin, number: signal.Signals
) -> None:
    walk(spot, twin, vx=0.5)
    began_ns = time.monotonic_ns()
    os.kill(pids(spot)["wire"], number)
    safe = first_safe(twin.log, began_ns)
    assert safe.safe_state == "settle" and read("EstopCheckIn", safe)["stop_level"] == p.StopLevel.SETTLE_THEN_CUT
    until(lambda: state(spot) == "disarmed", "a new wire, disarmed")
    twin.log.no_setpoint_after_safe(began_ns)
    stand(spot)  # a resume sets the e-stop up again


@pytest.mark.long
def test_saf_020_a_cable_that_is_back_carries_no_command_before_the_safe_frame(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=0.5)
    twin.unplug()
    until(lambda: state(spot) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    safe = first_safe(twin.log, back_ns)
    before = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.t_ns < safe.t_ns]
    assert {one.kind for one in before} <= {"read", "config", "other"}
    until(lambda: state(spot) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)


@pytest.mark.long
@pytest.mark.parametrize("fault", ["garbage", "intermittent", "delayed", "slow"])
def test_saf_006_a_stop_is_sent_at_once_with_any_answer_of_the_robot(
    spot: RealRobot, twin: Twin, fault: str
) -> None:
    walk(spot, twin, vx=0.5)
    twin.fault(fault)
    began_ns = time.monotonic_ns()
    spot.stop()
    first_safe(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(spot) == "disarmed", "confirmed at last")


@pytest.mark.long
def test_saf_002_a_robot_with_damaged_answers_still_gets_the_stop(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=0.5)
    twin.fault("garbage")
    until(lambda: state(spot) in ("lost", "down", None), "no connection can be heard")
    began_ns = time.monotonic_ns()
    assert "not confirmed" in why(spot.stop())
    until(
        lambda: any(one.safe_state == "hold" for one in twin.log.host("safe", began_ns)),
        "it is told to stand still",
    )
    safe = next(one for one in twin.log.host("safe", began_ns) if one.safe_state == "hold")
    assert "stop_request" in read("RobotCommand", safe)["command"]["full_body_command"]
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(spot) == "disarmed", "confirmed at last")


def test_a_lease_that_was_taken_over_is_named_and_not_returned(spot: RealRobot, twin: Twin) -> None:
    stand(spot)
    twin.order("steal tablet-7")
    until(lambda: "tablet-7" in why_if(spot.send_action({"vx": 0.1})), "it names its owner")
    began_ns = time.monotonic_ns()
    json_of(spot.stop())
    assert "held by tablet-7" in why(spot.resume())
    stopped = json_of(spot.cleanup())
    assert "taken over by tablet-7, so it is not returned" in stopped["motors"]["vx"]["detail"]
    assert first_safe(twin.log, began_ns).safe_state in ("", "settle")


def why_if(answer: dict[str, Any]) -> str:
    return why(answer) if answer["status"] == "error" else ""


@pytest.mark.long
def test_a_button_on_the_robot_settles_the_tree_and_is_named(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=0.2)
    twin.order("press")
    until(lambda: state(spot) == "disarmed", "it is disarmed")
    until(lambda: "E-stopped (hardware_estop" in why_if(spot.resume()), "it says why")
    twin.order("release")
    stand(spot)


def test_a_cleanup_sits_powers_off_and_returns_the_lease(twin: Twin, run_dir: Path) -> None:
    robot = Robot("spot", mode="real", port=twin.port)
    until(lambda: robot.connect_eagerly() is None, "it is connected")
    stand(robot)
    began_ns = time.monotonic_ns()
    json_of(robot.cleanup())
    safe = first_safe(twin.log, began_ns)
    assert "safe_power_off_request" in read("RobotCommand", safe)["command"]["full_body_command"]
    assert returned(twin, safe.t_ns)
    with Robot("spot", mode="real", port=twin.port) as other:
        until(lambda: other.connect_eagerly() is None, "another tree")
        assert motors(other) == p.Motors.OFF


def test_saf_003_the_root_loads_no_wire() -> None:
    script = (
        "from strands_actors.drivers.spot.driver import Spot\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        "driver = Spot('spot', '', {})\n"
        "driver.preload()\n"
        "driver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = done.stdout.split()
    assert "strands_actors.drivers.spot.stop_channel" in loaded
    unwanted = ("strands_actors.drivers.spot.wire", "bosdyn", "numpy")
    assert [name for name in unwanted if name in loaded] == []


def test_missing_settings_of_a_real_robot_are_named_at_connect(
    monkeypatch: pytest.MonkeyPatch, run_dir: Path, twin: Twin
) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(config.importlib.util, "find_spec", lambda name: None)
        with pytest.raises(config.WireDown, match=r"pip install 'strands-actors\[spot\]'"):
            config.vendor_certificate()
    monkeypatch.setenv(config.USERNAME, "user")
    monkeypatch.setenv(config.PASSWORD, "password")
    robot = Robot("spot", mode="real", port=twin.port.partition("?")[0])
    try:
        refusal = robot.connect_eagerly() or ""
        assert "certificate is not accepted" in refusal, "a server with another certificate is refused"
        assert twin.log.host("config") == [], "no password is sent to it"
    finally:
        robot.cleanup()


def test_a_login_comes_from_the_environment(monkeypatch: pytest.MonkeyPatch, run_dir: Path, twin: Twin) -> None:
    monkeypatch.setenv(config.USERNAME, "user")
    monkeypatch.setenv(config.PASSWORD, "wrong")
    robot = Robot("spot", mode="real", port=twin.port)
    try:
        assert "login: user or password is wrong" in (robot.connect_eagerly() or "")
    finally:
        robot.cleanup()


def test_sensors(spot: RealRobot) -> None:
    until(lambda: "xyz_m" in status(spot)["sensors"], "a reading")
    sensors = status(spot)["sensors"]
    assert sensors["battery_pct"] == [77.0] and sensors["estopped"] == [0.0]
    assert len([name for name in sensors if name.endswith(("_hx_rad", "_hy_rad", "_kn_rad"))]) == 12


def asked(robot: RealRobot, given: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to an agent."""
    return asyncio.run(robot.use_tool(given, "an agent"))


def test_an_agent_stands_it_up_reads_it_and_stops_it(spot: RealRobot, twin: Twin) -> None:
    json_of(spot.resume())
    assert json_of(asked(spot, {"action": "stand"})) == {"standing": True}
    assert json_of(asked(spot, {"action": "sensors"}))["sensors"]["motors"] == [2.0]
    json_of(asked(spot, {"action": "state"}))
    json_of(asked(spot, {"action": "status"}))
    began_ns = time.monotonic_ns()
    json_of(asked(spot, {"action": "stop"}))
    assert first_safe(twin.log, began_ns).safe_state == "hold"


def test_saf_007_an_estop_settles_it(spot: RealRobot, twin: Twin) -> None:
    walk(spot, twin, vx=0.3)
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="a button", within_s=5.0)
    assert (outcome.outcome, outcome.safe_state) == ("safe", "settle")
    assert "e-stopped by a button" in why(spot.send_action({"vx": 0.1}))
    twin.log.no_setpoint_after_safe(first_safe(twin.log, began_ns).t_ns)


@pytest.mark.long
def test_saf_012_a_robot_that_repeats_its_report_is_lost_and_gets_no_command(spot: RealRobot, twin: Twin) -> None:
    """Every connection is open, and every call is answered."""
    walk(spot, twin, vx=0.2)
    is_lost_while_stuck(spot, twin, {"vx": 0.2}, "has reported nothing new")
