"""Test a real robot on the twin: stops, lifetimes, runstop, homing, soft limits, missing boards. The twin's log
shows the safety."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.common.dynamixel import protocol as dxl
from strands_actors.drivers.stretch import frames as f
from strands_actors.drivers.stretch import protocol as p
from strands_actors.drivers.stretch.parameters import parameters_of
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import json_of, pids, resumed, state, status, until, why
from tests.trees import armed, first_safe, robot_on

SLACK_S = 0.4
"""For a machine that runs other tests at the same time."""
JOINTS = ("lift", "arm", "wrist_yaw", "wrist_pitch", "wrist_roll", "head_pan", "head_tilt")
WHEEL = parameters_of("stretch3").left.rad_per_m


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("stretch3", tmp_path) as process:
        yield process


@pytest.fixture
def stretch(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "stretch3") as robot:
        yield robot


def commands(entries: list[Entry]) -> list[p.Command]:
    """Return the commands to steppers among some frames, without those to servos."""
    found = []
    for entry in entries:
        if not entry.data.startswith(dxl.HEADER):
            for frame in f.Decoder().feed(entry.data):
                if frame.data[:1] == bytes((p.COMMAND,)):
                    found.append(p.parse_command(frame.data[1:]))
    return found


def sensor(robot: RealRobot, name: str) -> list[float]:
    """Return the newest report of a sensor, once its board has sent one in time."""
    found: list[float] = until(lambda: status(robot)["sensors"].get(name), f"{name} is told")
    return found


def drive(robot: RealRobot, twin: Twin, vx: float = 0.2, wz: float = 0.0) -> int:
    """Send a twist and wait until it is on the wire. Return when it was sent."""
    armed(robot)
    began_ns = time.monotonic_ns()
    json_of(robot.set_twist(vx=vx, wz=wz))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def test_saf_001_a_twist_is_repeated_for_its_lifetime_then_everything_holds(stretch: RealRobot, twin: Twin) -> None:
    began_ns = drive(stretch, twin, 0.1, 0.4)
    safe = first_safe(twin.log, began_ns, "hold")
    lived_s = (safe.t_ns - began_ns) / 1e9
    assert lived_s > 0.25
    sent = commands(twin.log.host("setpoint", began_ns))
    # A process that waited for a processor sends one more, however late it is.
    assert 4 <= len(sent) <= 2 * (lived_s / 0.1 + 2), "both wheels get the twist every 100 ms for its lifetime"
    assert {one.mode for one in sent} == {p.Mode.VELOCITY_PROFILE}
    turn = 0.4 * 0.3153 / 2
    assert {round(one.velocity / WHEEL, 4) for one in sent} == {round(0.1 - turn, 4), round(0.1 + turn, 4)}
    twin.log.no_setpoint_after_safe(began_ns)
    until(lambda: stretch.get_observation()["vx"] == 0.0, "it stands")
    assert state(stretch) == "holding"
    drive(stretch, twin)  # a late writer may go on


def test_it_drives_on_the_floor_and_reports_odometry(stretch: RealRobot, twin: Twin) -> None:
    for _ in range(15):
        json_of(stretch.set_twist(vx=0.2))
        time.sleep(0.1)
    json_of(stretch.stop())
    x_m, y_m = sensor(stretch, "odometry_xy_m")
    assert 0.03 < x_m < 0.35 and y_m == pytest.approx(0.0, abs=1e-3)
    json_of(stretch.resume())
    for _ in range(15):
        json_of(stretch.set_twist(wz=0.5))
        time.sleep(0.1)
    assert sensor(stretch, "odometry_yaw_rad")[0] > 0.1
    assert sensor(stretch, "rpy_rad")[2] == pytest.approx(sensor(stretch, "odometry_yaw_rad")[0], abs=0.1)


def test_only_the_named_joints_move_to_their_targets(stretch: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    told = json_of(stretch.send_action({"lift.pos": 0.53, "wrist_yaw": 1.2}))
    assert told == {"robot": "stretch3", "joints": {"lift": 0.53, "wrist_yaw": 1.2}}
    until(lambda: stretch.get_observation()["lift"] == pytest.approx(0.53, abs=1e-3), "the lift is there")
    until(lambda: stretch.get_observation()["wrist_yaw"] == pytest.approx(1.2, abs=0.01), "the wrist is there")
    sent = commands(twin.log.host("setpoint", began_ns))
    goals = {round(one.position, 2) for one in sent}
    assert goals == {round(0.53 * parameters_of("stretch3").lift.rad_per_m, 2)}, "arm and wheels get no goal"
    assert {one.mode for one in sent} == {p.Mode.POSITION_PROFILE}
    assert stretch.get_observation()["arm"] == pytest.approx(0.1, abs=1e-4)


def test_saf_005_a_stop_holds_every_motor_and_reads_each_back(stretch: RealRobot, twin: Twin) -> None:
    json_of(stretch.send_action({"lift": 0.7}))
    drive(stretch, twin, 0.25)
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    report = json_of(stretch.stop())
    stopped_ns = time.monotonic_ns()
    assert report["safe_state"] == "hold" and report["unconfirmed"] == []
    assert set(report["motors"]) == {*JOINTS, "left_wheel", "right_wheel"}
    first_safe(twin.log, began_ns, "hold")
    twin.log.no_setpoint_after_safe(began_ns)
    assert {one.mode for one in commands(twin.log.host("safe", began_ns))} == {p.Mode.VELOCITY, p.Mode.HOLD}
    until(lambda: stretch.get_observation()["vx"] == 0.0, "it stands")
    where = stretch.get_observation()
    assert where["lift"] < 0.6
    time.sleep(0.4)
    assert stretch.get_observation()["lift"] == pytest.approx(where["lift"], abs=1e-3), (
        "the lift is held in the middle of its motion"
    )
    assert "Call resume() first" in why(stretch.send_action({"lift": 0.6}))
    json_of(stretch.resume())
    assert twin.log.host("setpoint", stopped_ns) == [], "no setpoint is sent after the stop, not even by a resume"


def test_saf_010_a_command_in_the_port_of_a_stopped_robot_is_followed_by_a_hold(
    stretch: RealRobot, twin: Twin
) -> None:
    """The robot pauses with a command under way. The caller stops, then the robot continues."""
    drive(stretch, twin, 0.1)
    twin.pause()
    stretch.set_twist(vx=0.29)
    time.sleep(0.03)
    refusal = stretch.stop()
    assert refusal["status"] == "error", "the stop is not reported as confirmed"
    assert "left_wheel" in why(refusal)
    back_ns = time.monotonic_ns()
    twin.go_on()
    first_safe(twin.log, back_ns, "hold")
    until(lambda: state(stretch) == "disarmed", "it is back, disarmed, and confirmed")
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    twin.log.no_setpoint_after_safe(back_ns)
    until(lambda: stretch.get_observation().get("vx") == 0.0, "it stands")


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_root_holds_every_board_by_duplicates_of_its_ports(
    stretch: RealRobot, twin: Twin, number: signal.Signals
) -> None:
    json_of(stretch.send_action({"lift": 0.9}))
    drive(stretch, twin, 0.2)
    began_ns = time.monotonic_ns()
    os.kill(pids(stretch)["wire"], number)
    first_safe(twin.log, began_ns, "hold")
    time.sleep(0.3)
    twin.log.no_setpoint_after_safe(began_ns)
    until(lambda: state(stretch) == "disarmed", "a new wire, disarmed")
    lift = stretch.get_observation()["lift"]
    time.sleep(0.3)
    assert stretch.get_observation()["lift"] == pytest.approx(lift, abs=1e-3) and lift < 0.8


def test_saf_020_cables_that_are_back_carry_a_hold_before_any_question(stretch: RealRobot, twin: Twin) -> None:
    drive(stretch, twin, 0.2)
    twin.unplug()
    until(lambda: state(stretch) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    first_safe(twin.log, back_ns, "hold")
    until(lambda: state(stretch) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)


def test_saf_005_one_board_that_is_unplugged_keeps_no_other_from_being_stopped(
    stretch: RealRobot, twin: Twin
) -> None:
    json_of(stretch.send_action({"arm": 0.4}))
    drive(stretch, twin, 0.2)
    began_ns = time.monotonic_ns()
    twin.order("unplug-board hello-motor-lift")
    until(lambda: state(stretch) in ("lost", "down", None), "it is noticed")

    def told() -> bool:
        modes = [one.mode for one in commands(twin.log.host("safe", began_ns))]
        return modes.count(p.Mode.VELOCITY) >= 2 and p.Mode.HOLD in modes

    until(told, "the wheels stand, the arm holds")
    twin.log.no_setpoint_after_safe(began_ns)
    twin.order("plug-board hello-motor-lift")
    until(lambda: state(stretch) == "disarmed", "it is back, disarmed")
    resumed(stretch)


def test_a_pressed_runstop_ends_the_live_command_and_is_released_on_the_robot(
    stretch: RealRobot, twin: Twin
) -> None:
    json_of(stretch.send_action({"lift": 0.8}))
    twin.order("runstop on")
    until(lambda: "runstop" in str(status(stretch)["cause"]), "it is seen")
    until(lambda: state(stretch) == "disarmed", "and ends the motion")
    assert sensor(stretch, "runstop") == [1.0]
    assert "the runstop is pressed. Release the runstop on the robot" in why(stretch.resume())
    twin.order("runstop off")
    resumed(stretch)
    json_of(stretch.send_action({"lift": 0.5}))


def test_an_empty_battery_is_not_reported_as_a_pressed_button(stretch: RealRobot, twin: Twin) -> None:
    json_of(stretch.send_action({"lift": 0.8}))
    twin.order("low-battery on")
    until(lambda: "sets its runstop: the battery is low" in str(status(stretch)["cause"]), "it is told")
    twin.order("runstop off")
    assert "the battery is low. Charge it, then release the runstop on the robot" in why(stretch.resume())
    assert (sensor(stretch, "runstop"), sensor(stretch, "low_battery")) == ([1.0], [1.0])
    twin.order("low-battery off")
    twin.order("runstop off")
    resumed(stretch)


def test_after_a_contact_the_goal_is_not_sent_again_and_all_motors_hold(stretch: RealRobot, twin: Twin) -> None:
    armed(stretch)
    twin.order("contact arm on")
    began_ns = time.monotonic_ns()
    json_of(stretch.send_action({"arm": 0.4}))
    until(lambda: "arm has met an obstacle" in str(status(stretch)["cause"]), "it is told")
    until(lambda: state(stretch) == "disarmed", "and ends the motion")
    first_safe(twin.log, began_ns, "hold")
    assert len(commands(twin.log.host("setpoint", began_ns))) == 1, "the arm pushes once"
    twin.log.no_setpoint_after_safe(began_ns)
    twin.order("contact arm off")
    json_of(stretch.resume())
    json_of(stretch.send_action({"arm": 0.15}))
    until(lambda: stretch.get_observation()["arm"] == pytest.approx(0.15, abs=1e-3), "it is there")


def test_a_lifts_goal_is_sent_once_and_the_wheels_velocity_is_re_sent(stretch: RealRobot, twin: Twin) -> None:
    armed(stretch)
    began_ns = time.monotonic_ns()
    json_of(stretch.send_action({"lift": 0.6}))
    until(lambda: twin.log.host("setpoint", began_ns), "it is told")
    time.sleep(0.35)
    for _ in range(8):
        json_of(stretch.set_twist(vx=0.05))
        time.sleep(0.1)
    modes = [one.mode for one in commands(twin.log.host("setpoint", began_ns))]
    assert modes.count(p.Mode.POSITION_PROFILE) == 1 and modes.count(p.Mode.VELOCITY_PROFILE) > 8


@pytest.mark.parametrize("joint", ["lift", "arm", "wrist_yaw"])
def test_saf_014_a_joint_that_is_not_homed_is_refused_with_the_command_to_run(
    twin: Twin, run_dir: Path, joint: str
) -> None:
    twin.order(f"homed {joint} off")
    with Robot("stretch3", mode="real", port=twin.port) as robot:
        began_ns = time.monotonic_ns()
        text = why(robot.send_action({joint: 0.2}))
        assert f"{joint} is not homed" in text and "Run the homing routine" in text
        assert twin.log.host("setpoint", began_ns) == []
        json_of(robot.set_twist(vx=0.05))


def test_saf_014_soft_limits_that_are_set_hold_at_once(stretch: RealRobot, twin: Twin) -> None:
    json_of(stretch.send_action({"lift": 0.55}))
    until(lambda: stretch.get_observation()["lift"] == pytest.approx(0.55, abs=1e-3), "it is there")
    json_of(stretch.stop())
    json_of(stretch.set_soft_limits(joint="lift", low=0.3, high=0.6))
    json_of(stretch.set_soft_limits(joint="wrist_yaw", low=-0.5, high=0.5))
    json_of(stretch.resume())
    began_ns = time.monotonic_ns()
    until(lambda: sensor(stretch, "limit_high")[0] == 0.6, "they are reported")
    assert "outside its present soft limits. Stay within 0.3000..0.6000" in why(stretch.send_action({"lift": 0.65}))
    assert "outside its present soft limits" in why(stretch.send_action({"wrist_yaw": 0.6}))
    assert twin.log.host("setpoint", began_ns) == []
    json_of(stretch.send_action({"lift": 0.59}))
    assert "lift 0.2..1.3" in why(stretch.set_soft_limits(joint="lift", low=0.2, high=1.3))


def test_saf_003_soft_limits_that_are_set_again_and_again_end_no_process(twin: Twin, run_dir: Path) -> None:
    """They are sent at any moment between readings."""
    with robot_on(twin.port, "stretch3", control_frequency=50.0) as robot:
        armed(robot)
        wire, began_ns = pids(robot)["wire"], time.monotonic_ns()
        for at in range(60):
            json_of(robot.set_soft_limits(joint="lift", low=0.1 + 0.001 * at, high=0.9))
            time.sleep(0.01)
        assert pids(robot)["wire"] == wire
        assert twin.log.host("safe", began_ns) == [], "the robot was not stopped"


def test_saf_013_the_wheels_watchdog_is_armed_and_read_back_and_stops_them_when_all_are_gone(
    stretch: RealRobot, twin: Twin
) -> None:
    watchdog = status(stretch)["velocity_watchdog"]
    armed = {"acknowledged": True, "in_flash": True}
    assert watchdog == {"left_wheel": armed, "right_wheel": armed}
    for _ in range(8):
        drive(stretch, twin, 0.2)
        time.sleep(0.1)
    victims = [pids(stretch)[role] for role in ("root", "wire", "standby")]
    for victim in victims:
        os.kill(victim, signal.SIGSTOP)
    for victim in victims:
        os.kill(victim, signal.SIGKILL)
    time.sleep(1.0 + 0.5 + SLACK_S)  # its watchdog acts, and the wheels roll out
    with Robot("stretch3", mode="real", port=twin.port, tool_name="after") as other:
        until(lambda: "vx" in other.get_observation(), "another program reads it")
        assert other.get_observation()["vx"] == 0.0


def test_saf_013_a_robot_with_the_watchdog_off_in_its_yaml_does_not_drive(
    twin: Twin, run_dir: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The setting comes from the robot's own YAML, as on a real robot."""
    fleet = Path(twin.port).parent / "fleet"
    user = next(fleet.glob("*/stretch_user_params.yaml"))
    off = {f"hello-motor-{side}-wheel": {"gains": {"enable_vel_watchdog": 0}} for side in ("left", "right")}
    monkeypatch.setenv("HELLO_FLEET_PATH", str(fleet))
    monkeypatch.setenv("HELLO_FLEET_ID", user.parent.name)
    with Robot("stretch3", mode="real") as robot:
        json_of(robot.set_twist(vx=0.1))
    user.write_text(yaml.safe_dump({**yaml.safe_load(user.read_text()), **off}))
    with Robot("stretch3", mode="real") as robot:
        began_ns = time.monotonic_ns()
        assert "the wheels' velocity watchdog is off" in why(robot.set_twist(vx=0.1))
        assert twin.log.host("setpoint", began_ns) == []
        json_of(robot.send_action({"lift": 0.51}))


def test_an_agent_reads_and_stops_the_robot_and_moves_it_only_with_approval(stretch: RealRobot, twin: Twin) -> None:
    def asked(given: dict[str, Any]) -> dict[str, Any]:
        return asyncio.run(stretch.use_tool(given, "an agent"))

    began_ns = drive(stretch, twin, 0.2)
    schema = stretch.tool_spec["inputSchema"]["json"]["properties"]["action"]["enum"]
    assert schema == ["sensors", "status", "state", "move_to", "move", "stop", "set_twist", "set_soft_limits"]
    assert json_of(asked({"action": "sensors"}))["sensors"]["battery_v"] == [pytest.approx(12.79, abs=0.01)]
    assert set(json_of(asked({"action": "state"}))["velocities"]) >= {"lift", "arm"}
    assert "set_twist" in why(asked({"action": "set_twist", "vx": 0.1}))
    assert "needs an operator's approval" in why(asked({"action": "move", "vx": 0.1}))
    json_of(asked({"action": "stop"}))
    first_safe(twin.log, began_ns, "hold")
    assert state(stretch) == "disarmed"


def test_saf_007_an_estop_presses_the_runstop(stretch: RealRobot, twin: Twin) -> None:
    json_of(stretch.send_action({"lift": 0.8}))
    drive(stretch, twin, 0.2)
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="the red button", within_s=3.0)
    assert (outcome.outcome, outcome.safe_state) == ("safe", "stop")
    first_safe(twin.log, began_ns)
    pressed = [one for one in twin.log.host("safe", began_ns) if one.safe_state == "stop"]
    assert pressed, "the runstop is on, and everything holds"
    twin.log.no_setpoint_after_safe(began_ns)
    assert "e-stopped by the red button" in why(stretch.set_twist(vx=0.1))
    assert "the runstop is pressed" in why(stretch.resume()), "the runstop must be released on the robot"
    twin.order("runstop off")
    resumed(stretch)
