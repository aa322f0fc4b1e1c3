"""Test the duck's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.microduck import protocol as p
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import connected, first_safe, is_lost_while_stuck, robot_on, shared_twin

from .rig import act, method, moves, params


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("microduck", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    twin_process.power_cycle()
    with shared_twin(twin_process) as process:
        yield process


@pytest.fixture
def duck(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(twin.port, "microduck") as robot:
        yield robot


def test_saf_001_a_twist_is_re_sent_for_its_duration_and_ends_in_zero(duck: RealRobot, twin: Twin) -> None:
    began_ns = act(duck, twin, vx=0.2, vyaw=-0.5, duration=0.6)
    zero = first_safe(twin.log, began_ns)
    assert zero.safe_state == "zero"
    assert (zero.t_ns - began_ns) / 1e9 > 0.55
    sent = moves(twin, began_ns)
    assert 8 <= len(sent) <= 14, "the twist is re-sent at 20 Hz for its duration"
    assert all(params(one) == {"vx": 0.2, "vy": 0.0, "vyaw": -0.5} for one in sent)
    time.sleep(0.4)
    twin.log.no_setpoint_after_safe(began_ns)
    assert state(duck) == "holding"
    assert json_of(duck.odometry())["position_m"][0] > 0.05
    act(duck, twin, vx=0.1)  # a late writer may go on


def test_saf_001_a_head_that_turns_neither_ends_nor_prolongs_the_twist(duck: RealRobot, twin: Twin) -> None:
    began_ns = act(duck, twin, vx=0.2, duration=0.5)
    for _ in range(9):
        time.sleep(0.05)
        json_of(duck.send_action({"head_yaw": 0.3}))
    time.sleep(0.4)
    sent = moves(twin, began_ns)
    assert all(params(one)["vx"] == 0.2 for one in sent)
    assert 0.35 < (sent[-1].t_ns - began_ns) / 1e9 <= 0.5 + 0.1
    assert status(duck)["sensors"]["twist_requested"] == [0.0, 0.0, 0.0]


def test_a_head_command_is_sent_once_and_keeps_the_other_joints(duck: RealRobot, twin: Twin) -> None:
    began_ns = act(duck, twin, head_yaw=0.4, head_pitch=-0.2)
    until(lambda: duck.get_observation()["head_yaw"] == pytest.approx(0.4), "it is there")
    json_of(duck.send_action({"head_roll": 0.1}))
    until(lambda: duck.get_observation()["head_roll"] == pytest.approx(0.1), "it is there")
    assert duck.get_observation()["head_yaw"] == pytest.approx(0.4)
    json_of(duck.send_action({"z": -0.02, "open": 0.5}))
    time.sleep(0.5)
    said = [(method(one), params(one)) for one in twin.log.host("setpoint", began_ns)]
    assert said == [
        (p.HEAD, {"neck_pitch": 0.0, "head_pitch": -0.2, "head_yaw": 0.4, "head_roll": 0.0}),
        (p.HEAD, {"neck_pitch": 0.0, "head_pitch": -0.2, "head_yaw": 0.4, "head_roll": 0.1}),
        (p.POSE, {"z": -0.02, "roll": 0.0, "pitch": 0.0, "active": True}),
        (p.MOUTH, {"open": 0.5}),
    ]
    assert twin.log.host("safe", began_ns) == [], "a head command has no duration, so no stop follows it"
    json_of(duck.send_action({"active": False}))
    until(lambda: params(twin.log.host("setpoint", began_ns)[-1]).get("active") is False, "the pose ends")


def test_saf_005_a_stop_is_repeated_until_its_state_shows_no_twist(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, vx=0.3, duration=10)
    time.sleep(0.3)
    began_ns = time.monotonic_ns()
    stopped = json_of(duck.stop())
    assert stopped["safe_state"] == "stop" and len(stopped["motors"]) == 12 and stopped["unconfirmed"] == []
    assert first_safe(twin.log, began_ns).safe_state == "stop"
    first_safe(twin.log, began_ns)
    assert len(twin.log.host("safe", began_ns)) >= 3
    twin.log.no_setpoint_after_safe(began_ns)
    assert status(duck)["sensors"]["odometry_linear_m_s"] == pytest.approx([0.0, 0.0], abs=p.AT_REST)
    assert "Call resume() first" in why(duck.send_action({"vx": 0.1}))
    assert "Call resume() first" in why(duck.enable())
    assert "Call resume() first" in why(duck.do(skill="kick_left"))
    json_of(duck.resume())
    assert twin.log.setpoints_after_safe(began_ns) == 0, "no setpoint is sent after the stop, not even by a resume"


@pytest.mark.long
def test_saf_005_a_duck_that_reports_a_twist_is_not_reported_as_stopped(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, vx=0.2, duration=10)
    twin.fault("wrong")
    until(lambda: status(duck)["sensors"]["odometry_linear_m_s"][0] > 0.5, "it reports too much")
    began_ns = time.monotonic_ns()
    assert "not confirmed: it reports speed" in why(duck.stop())
    assert len(twin.log.host("safe", began_ns)) > 5, "the stop is repeated"
    twin.fault("ok")
    until(lambda: state(duck) == "disarmed", "it is confirmed when it can be")


@pytest.mark.long
def test_saf_010_a_twist_in_the_socket_of_a_stopped_robotd_is_followed_by_a_stop(
    duck: RealRobot, twin: Twin
) -> None:
    """robotd is stopped with a twist in its socket. The caller stops, then robotd continues."""
    act(duck, twin, vx=0.1, duration=10)
    twin.pause()
    duck.send_action({"vx": 0.3, "duration": 10})
    time.sleep(0.05)
    assert "not confirmed" in why(duck.stop())
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: twin.log.host("safe", back_ns), "a stop")
    until(lambda: state(duck) == "disarmed", "it is back, disarmed, and confirmed")
    time.sleep(0.3)
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    late = [one for one in frames if one.kind == "setpoint"]
    assert len(late) <= 6, "only twists from before robotd counted as silent arrive"
    until(lambda: status(duck)["sensors"].get("twist_requested") == [0.0] * 3, "it stands")


@pytest.mark.long
def test_saf_010_no_stop_is_confirmed_while_a_skill_may_still_begin(duck: RealRobot, twin: Twin) -> None:
    """A skill is requested on another connection than stops."""
    act(duck, twin, head_yaw=0.1)
    twin.pause()
    answers: list[Any] = []
    asking = threading.Thread(target=lambda: answers.append(duck.do(skill="kick_left")))
    asking.start()
    time.sleep(0.2)
    assert "not confirmed" in why(duck.stop())
    back_ns = time.monotonic_ns()
    twin.go_on()
    asking.join(20.0)
    until(lambda: state(duck) == "disarmed", "confirmed once it has been answered")
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert [method(one) for one in frames if one.kind == "setpoint"] == [p.DO]
    assert frames[-1].kind == "safe"


def test_saf_004_no_twist_is_sent_to_a_silent_robot(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, vx=0.2, duration=10)
    twin.fault("off")
    time.sleep(0.35)
    silent_ns = time.monotonic_ns()
    until(lambda: state(duck) in ("lost", "down", None), "it is noticed")
    assert moves(twin, silent_ns) == [], "no twist is sent that would be carried out late"
    twin.fault("ok")
    until(lambda: state(duck) == "disarmed", "it is back, disarmed")


def test_saf_020_a_walk_does_not_go_on_in_a_robotd_that_was_frozen(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, vx=0.2, duration=10)
    twin.pause()
    time.sleep(1.0)
    back_ns = time.monotonic_ns()
    twin.go_on()
    first_safe(twin.log, back_ns)
    until(lambda: state(duck) == "disarmed", "it is back, disarmed")
    time.sleep(0.2)
    twin.log.no_setpoint_after_safe(back_ns)
    assert len(moves(twin, back_ns)) <= 6, "only the waiting twists arrive, and no new one"


def test_saf_010_a_twist_that_outlives_the_wire_is_followed_by_the_roots_stop(duck: RealRobot, twin: Twin) -> None:
    """Bytes in a socket are delivered even if their sender is dead."""
    act(duck, twin, vx=0.1, duration=10)
    twin.pause()
    time.sleep(0.1)  # so that a few twists wait
    os.kill(pids(duck)["wire"], signal.SIGKILL)
    time.sleep(0.3)
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: state(duck) == "disarmed", "a new wire, disarmed, and confirmed")
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe"
    for late in (one for one in frames if one.kind == "setpoint"):
        assert params(late)["vx"] == 0.1
    until(lambda: status(duck)["sensors"].get("twist_requested") == [0.0] * 3, "it stands")


def test_a_stop_puts_the_theremin_down(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, head_yaw=0.1)
    json_of(duck.theremin(active=True))
    with_it = say_until(twin, lambda told: "theremin" in told)
    assert with_it["theremin"]["zones"] == 0
    json_of(duck.stop())
    say_until(twin, lambda told: "theremin" not in told)
    assert "Call resume() first" in why(duck.theremin(active=True)), (
        "the theremin moves the mouth, so it is refused after a stop"
    )
    json_of(duck.theremin(active=False))


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_roots_own_connection_stops_the_duck(
    duck: RealRobot, twin: Twin, number: signal.Signals
) -> None:
    act(duck, twin, vx=0.3, duration=10)
    began_ns = time.monotonic_ns()
    os.kill(pids(duck)["wire"], number)
    safe = first_safe(twin.log, began_ns)
    assert safe.safe_state == "stop"
    time.sleep(0.3)
    twin.log.no_setpoint_after_safe(began_ns)
    until(lambda: state(duck) == "disarmed", "a new wire, disarmed")


def test_saf_020_a_socket_that_is_back_carries_the_stop_first(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, vx=0.2, duration=10)
    twin.unplug()
    until(lambda: state(duck) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    first_safe(twin.log, back_ns)
    first = next(one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind != "read")
    assert first.kind == "safe"
    until(lambda: state(duck) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["garbage", "intermittent", "delayed", "slow", "stuck"])
def test_saf_006_a_stop_is_sent_at_once_with_any_answer_of_robotd(duck: RealRobot, twin: Twin, fault: str) -> None:
    act(duck, twin, vx=0.2, duration=10)
    twin.fault(fault)
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    duck.stop()
    first_safe(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(duck) == "disarmed", "confirmed at last")


def test_saf_012_silence_is_no_state(duck: RealRobot, twin: Twin) -> None:
    twin.fault("off")
    until(lambda: state(duck) in ("lost", "down", None), "it is noticed")
    assert "no state from robotd for 0.6 s" in why(duck.send_action({"vx": 0.1}))
    twin.fault("ok")
    until(lambda: state(duck) == "disarmed", "it is back, disarmed")


@pytest.mark.long
def test_saf_012_a_duck_that_repeats_its_state_is_lost_and_sent_nothing(duck: RealRobot, twin: Twin) -> None:
    """Every socket is open, every request is answered, and its state comes 50 times a second."""
    act(duck, twin, vx=0.2, duration=10)
    is_lost_while_stuck(duck, twin, {"vx": 0.1}, "has not changed")


def test_saf_003_the_removal_of_the_robots_policy_ends_the_live_command(duck: RealRobot, twin: Twin) -> None:
    began_ns = act(duck, twin, vx=0.2, duration=10)
    say(twin, p.ENABLE, on=False)
    first_safe(twin.log, began_ns)
    until(lambda: state(duck) == "disarmed", "it is let go of")
    assert "no policy drives it" in status(duck)["cause"]
    twin.log.no_setpoint_after_safe(began_ns)


def say(twin: Twin, name: str, **given: Any) -> Any:
    """Send a request as another client."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(twin.port)
        client.sendall(json.dumps({"jsonrpc": "2.0", "id": 7, "method": name, "params": given}).encode() + b"\n")
        return json.loads(client.makefile().readline())["result"]


def say_until(twin: Twin, is_so: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """Return the first state that fulfils the condition, read by another client."""
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(5.0)
        client.connect(twin.port)
        client.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "robot.subscribe"}\n')
        for line in client.makefile():
            told: dict[str, Any] = json.loads(line).get("params", {})
            if told and is_so(told):
                return told
    raise AssertionError("the twin has closed the connection")


def test_saf_014_a_service_that_collapses_the_duck_needs_a_confirmation(duck: RealRobot, twin: Twin) -> None:
    act(duck, twin, head_yaw=0.1)
    began_ns = time.monotonic_ns()
    for refused in (duck.relax(), duck.init(), duck.reboot_motors(ids="20"), duck.relax(confirm="yes")):
        assert "(confirm=True)" in why(refused)
    time.sleep(0.1)
    asked = [json.loads(one.data)["method"] for one in twin.log.entries(began_ns) if one.sender == "host"]
    assert set(asked) <= {p.HEALTH, p.POLICIES}, "only questions were written"
    json_of(duck.relax(confirm=True))
    until(lambda: state(duck) == "disarmed", "a duck that is limp is let go of")
    assert "no policy drives it" in status(duck)["cause"]
    json_of(duck.resume())
    json_of(duck.init(confirm=True))
    json_of(duck.reboot_motors(ids="20, 21", confirm=True))
    sent = [
        params(one) for one in twin.log.entries(began_ns) if b"rebootMotors" in one.data and one.sender == "host"
    ]
    assert sent == [{"ids": [20, 21]}]


@pytest.mark.long
def test_services(duck: RealRobot, twin: Twin) -> None:
    json_of(duck.enable())
    assert json_of(duck.skills())["skills"] == ["ground_pick", "kick_left", "kick_right", "sit_toggle", "roulade"]
    json_of(duck.do(skill="kick_left"))
    assert "kick_left is playing" in why(duck.do(skill="kick_right"))
    assert "It has ground_pick" in why(duck.do(skill="fly"))
    until(lambda: json_of(duck.monitor())["policy"] == "kick_left", "it kicks")
    until(lambda: json_of(duck.monitor())["policy"] == "stand", "the kick is over")
    assert json_of(duck.stand()) == {"sitting": False, "already": True}
    json_of(duck.sit())
    until(lambda: status(duck)["sensors"]["sitting"] == [1.0], "it sits")
    assert "the duck sits. Call stand() first" in why(duck.send_action({"vx": 0.1}))
    until(lambda: json_of(duck.monitor())["policy"] == "sit", "it has sat down")
    json_of(duck.stand())
    until(lambda: status(duck)["sensors"]["sitting"] == [0.0], "it stands")
    looked = json_of(duck.look_at(x=1.0, y=1.0, z=0.0))
    assert looked["head"]["head_yaw"] == pytest.approx(0.785, abs=0.01) and looked["clamped"] is False
    until(lambda: duck.get_observation()["head_yaw"] == pytest.approx(0.785, abs=0.01), "it looks there")
    json_of(duck.send_action({"head_roll": 0.2}))
    time.sleep(0.2)
    assert duck.get_observation()["head_yaw"] == pytest.approx(0.785, abs=0.02), (
        "the head keeps looking at the target"
    )
    assert json_of(duck.mode()) == {"mode": "walk"}
    json_of(duck.set_mode(mode="roller"))
    until(lambda: status(duck)["sensors"]["mode"] == [1.0], "it rolls")
    assert "vyaw=0.5 rad/s is over 0.3 for roller" in why(duck.send_action({"vyaw": 0.5}))
    json_of(duck.load_policy(slot="walk", path="/var/lib/robot/policies/bouncy.onnx"))
    (walk,) = (one for one in json_of(duck.policies())["slots"] if one["slot"] == "walk")
    assert walk["overridden"] and walk["path"].endswith("bouncy.onnx")
    json_of(duck.load_policy(slot="walk"))
    json_of(duck.reload_policies())
    assert json_of(duck.sounds())["sounds"][0] == "alarm"
    json_of(duck.play_sound(tag="coo"))
    assert "wheee has to be held" in why(duck.play_sound(tag="wheee"))
    json_of(duck.theremin(active=True))
    json_of(duck.theremin(active=False))
    assert json_of(duck.version()) == {"api_version": 31, "asked_api_version": 31, "daemon_version": "0.9.0"}
    assert len(json_of(duck.model())["joint_names"]) == 15
    assert json_of(duck.health())["healthy"] is True
    assert set(json_of(duck.monitor())) == {"t", "policy", "move", "head", "safety", "loop"}
    json_of(duck.disable())


def test_saf_012_sensors_are_in_the_observation(duck: RealRobot, twin: Twin) -> None:
    sensors = status(duck)["sensors"]
    assert sensors["battery_pct"] == [63.0] and sensors["battery_v"] == [7.6]
    assert len(sensors["gyro_rad_s"]) == 3 and len(sensors["orientation_wxyz"]) == 4
    assert sensors["odometry_xy_m"] == [0.0, 0.0] and sensors["mode"] == [0.0]


def test_a_policy_is_refused_with_the_accepted_commands(duck: RealRobot) -> None:
    for answer in (duck.run_policy(lambda _: {"vx": 0.1}), duck.start_task("walk")):
        said = why(answer)
        assert all(word in said for word in ("move", "head", "pose", "do(skill"))


def test_an_agent_has_every_verb(duck: RealRobot, twin: Twin) -> None:
    def tool(**given: Any) -> Any:
        return asyncio.run(duck.use_tool(given, "test"))

    json_of(tool(action="enable"))
    json_of(tool(action="move", vx=0.1, duration=0.3))
    until(lambda: state(duck) == "holding", "it has walked")
    json_of(tool(action="head", head_yaw=0.2))
    json_of(tool(action="pose", z=-0.01))
    json_of(tool(action="mouth", open=1.0))
    json_of(tool(action="look_at", x=1.0, y=0.0, z=0.0))
    json_of(tool(action="do", skill="kick_right"))
    assert "(confirm=True)" in why(tool(action="relax", confirm=False))
    assert "the name of a skill" in why(tool(action="do", skill="../x"))
    for verb in ("skills", "sounds", "mode", "policies", "health", "version", "model", "odometry", "monitor"):
        json_of(tool(action=verb))
    json_of(tool(action="stop"))
    assert "resume" in why(tool(action="move", vx=0.1))


def test_saf_003_the_root_loads_neither_the_wire_nor_the_twin() -> None:
    script = (
        "from strands_actors.drivers.microduck.driver import Microduck\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        "driver = Microduck('microduck', '/nowhere', {})\n"
        "driver.preload()\ndriver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "strands_actors.drivers.microduck.stop" in loaded
    unwanted = ("strands_actors.drivers.microduck.wire", "strands_actors.drivers.microduck.twin", "httpx", "numpy")
    assert [name for name in unwanted if name in loaded] == []


def test_an_older_robotd_gives_a_warning_and_its_missing_skills_are_refused(tmp_path: Path, run_dir: Path) -> None:
    serve = (
        "from strands_actors.drivers.microduck.twin import main\n"
        f"main('microduck', options={{'api_version': 16}}, port_file={str(tmp_path / 'port')!r})"
    )
    served = subprocess.Popen([sys.executable, "-c", serve])
    try:
        until(lambda: (tmp_path / "port").exists(), "it is served")
        with Robot("microduck", mode="real", port=(tmp_path / "port").read_text()) as duck:
            connected(duck)
            assert "robotd speaks API 16, not 31 as configured" in status(duck)["warning"]
            json_of(duck.enable())
            assert "kick_left" in json_of(duck.skills())["skills"], "the skill is listed as in the robot's state"
            json_of(duck.do(skill="kick_left"))
            assert "vx=0.5 m/s is over 0.3 for walk" in why(duck.send_action({"vx": 0.5}))
            assert "robotd (API 16) does not have this function" in why(duck.policies())
            assert "robotd (API 16) does not have this function" in why(duck.sit())
            json_of(duck.stop())
    finally:
        served.terminate()
        served.wait(10.0)
