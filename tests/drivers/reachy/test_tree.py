"""Test Reachy's whole tree on its twin: real processes and real sockets. The twin's log decides."""

from __future__ import annotations

import asyncio
import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import connect

from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.reachy import protocol as p
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why
from tests.trees import armed, connected, first_safe, robot_on, shared_twin

"""Added to the published bounds, for a busy machine."""


@pytest.fixture(scope="module")
def twin_process(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Twin]:
    with Twin("reachy_mini", tmp_path_factory.mktemp("twin")) as process:
        yield process


@pytest.fixture
def twin(twin_process: Twin) -> Iterator[Twin]:
    twin_process.power_cycle()
    with shared_twin(twin_process) as process:
        yield process


@pytest.fixture
def reachy(twin: Twin, run_dir: Path) -> Iterator[RealRobot]:
    with robot_on(f"http://{twin.port}", "reachy_mini") as robot:
        yield robot


def move(reachy: RealRobot, twin: Twin, **action: float) -> int:
    """Send an action and wait until it is on the wire. Return when it was sent."""
    armed(reachy)
    began_ns = time.monotonic_ns()
    json_of(reachy.send_action(action))
    until(lambda: twin.log.host("setpoint", began_ns), "a setpoint")
    return began_ns


def ask(twin: Twin, target: str) -> Any:
    return httpx.get(f"http://{twin.port}{target}", trust_env=False, timeout=5.0).json()


def stands(reachy: RealRobot) -> None:
    time.sleep(0.1)  # it reaches its last target, and a reading is a moment old
    before = reachy.get_observation()
    time.sleep(0.3)
    assert reachy.get_observation() == pytest.approx(before, abs=0.2)


def test_a_move_is_sent_once_and_arrives(reachy: RealRobot, twin: Twin) -> None:
    sent = json_of(reachy.send_action({"head_yaw": 30.0, "antenna_left": 60.0}))
    assert sent == {"sent": {"head_yaw": 30.0, "antenna_left": 60.0, "duration": 0.5}, "robot": "reachy_mini"}
    until(lambda: reachy.get_observation()["antenna_left"] > 59.5, "it is there")
    time.sleep(1.2)  # a second write would be here by now
    assert [one.data.split()[1] for one in twin.log.host("setpoint")] == [p.GOTO.encode()]
    assert reachy.get_observation()["head_yaw"] == pytest.approx(30.0, abs=0.5)


def test_a_command_ends_the_move_before_it(reachy: RealRobot, twin: Twin) -> None:
    move(reachy, twin, antenna_left=120.0, duration=8.0)
    time.sleep(0.5)
    until(lambda: len(ask(twin, p.RUNNING)) == 1, "it is on its way")
    here = reachy.get_observation()["antenna_left"]
    began_ns = move(reachy, twin, antenna_left=here + 2.0)
    until(lambda: abs(reachy.get_observation()["antenna_left"] - here - 2.0) < 1.0, "the newer one counts")
    assert ask(twin, p.RUNNING) == []
    assert twin.log.host("safe", began_ns) == []


def test_saf_005_a_stop_ends_the_move_where_it_is_and_no_other_follows(reachy: RealRobot, twin: Twin) -> None:
    move(reachy, twin, antenna_left=120.0, duration=5.0)
    time.sleep(0.3)
    began_ns = time.monotonic_ns()
    stopped = json_of(reachy.stop())
    assert stopped["safe_state"] == "hold" and stopped["unconfirmed"] == [] and len(stopped["motors"]) == 9
    first_safe(twin.log, began_ns)
    assert ask(twin, p.RUNNING) == []
    stands(reachy)
    assert "Call resume() first" in why(reachy.send_action({"head_yaw": 1.0}))
    assert "Call resume() first" in why(reachy.wake())
    json_of(reachy.resume())
    assert twin.log.setpoints_after_safe(began_ns) == 0, "no setpoint is sent after the stop, not even by a resume"


def test_saf_005_a_stop_also_ends_another_clients_move(reachy: RealRobot, twin: Twin) -> None:
    """The daemon lists no move over ``/ws/sdk``."""
    with connect(f"ws://{twin.port}{p.SDK}", proxy=None, close_timeout=0.2) as other:
        other.send(json.dumps({"type": "goto_target", "antennas": [2.0, 2.0], "duration": 9.0}))
        until(lambda: reachy.get_observation()["antenna_left"] > 5.0, "it moves")
        json_of(reachy.stop())
        stands(reachy)


@pytest.mark.long
def test_targets_that_the_daemon_ignores_are_reported_and_all_moves_end(reachy: RealRobot, twin: Twin) -> None:
    with connect(f"ws://{twin.port}{p.SDK}", proxy=None, close_timeout=0.2) as other:
        other.send(json.dumps({"type": "goto_target", "antennas": [2.0, 2.0], "duration": 9.0}))
        until(lambda: reachy.get_observation()["antenna_left"] > 5.0, "it moves")
        began_ns = move(reachy, twin, head_yaw=1.0)
        first_safe(twin.log, began_ns)
        until(lambda: state(reachy) == "disarmed", "it is let go of")
        assert "a move of another client runs" in why(reachy.send_action({"head_yaw": 1.0}))
        stands(reachy)


def test_moves_and_services_that_the_daemon_would_ignore_are_refused(reachy: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    body = {"antennas": [1.0, 1.0], "duration": 60.0}
    theirs = httpx.post(f"http://{twin.port}{p.GOTO}", json=body, trust_env=False).json()
    assert "wake: the daemon ignores commands while a move of another client runs" in why(reachy.wake())
    until(lambda: status(reachy)["sensors"]["others_move"] == [1.0], "it is seen")
    assert "a move of another client runs" in why(reachy.send_action({"head_yaw": 40.0}))
    assert "a move of another client runs" in why(reachy.express(move="yes1"))
    assert len(twin.log.host("setpoint", began_ns)) == 1, "only the other client's move is running"
    assert ask(twin, p.RUNNING) == [theirs] and not twin.log.host("safe", began_ns), (
        "the other client's move was not ended"
    )
    httpx.post(f"http://{twin.port}{p.STOP}", json=theirs, trust_env=False)
    until(lambda: status(reachy)["sensors"]["others_move"] == [0.0], "it is over")
    json_of(reachy.send_action({"head_yaw": 40.0}))
    until(lambda: reachy.get_observation()["head_yaw"] == pytest.approx(40.0, abs=0.5), "and now it moves")


@pytest.mark.long
def test_a_move_that_is_ignored_for_an_unlisted_one_is_reported(reachy: RealRobot, twin: Twin) -> None:
    with connect(f"ws://{twin.port}{p.SDK}", proxy=None, close_timeout=0.2) as other:
        other.send(json.dumps({"type": "goto_target", "antennas": [2.0, 2.0], "duration": 9.0}))
        until(lambda: reachy.get_observation()["antenna_left"] > 5.0, "it moves")
        assert "a move of another client runs" in why(reachy.wake())
        began_ns = move(reachy, twin, head_yaw=40.0)
        first_safe(twin.log, began_ns)
        until(lambda: state(reachy) == "disarmed", "it is let go of")
        assert "a move of another client runs" in status(reachy)["cause"]
        stands(reachy)


def test_saf_010_a_move_that_waits_in_a_stopped_daemon_is_ended(reachy: RealRobot, twin: Twin) -> None:
    """The daemon is stopped with a move in its socket. The caller stops, then the daemon continues."""
    move(reachy, twin, antenna_left=3.0)
    twin.pause()
    reachy.send_action({"antenna_left": 120.0, "duration": 8.0})
    time.sleep(0.05)
    assert "not confirmed" in why(reachy.stop())
    back_ns = time.monotonic_ns()
    twin.go_on()
    until(lambda: twin.log.host("safe", back_ns), "a safe frame")
    until(lambda: state(reachy) == "disarmed", "it is back, disarmed, and confirmed")
    assert ask(twin, p.RUNNING) == []
    frames = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind in ("setpoint", "safe")]
    assert frames[-1].kind == "safe", "a safe frame is the last one that is carried out"
    assert len([one for one in frames if one.kind == "setpoint"]) <= 1, (
        "at most one command was under way, and none follows"
    )
    stands(reachy)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("frozen_s", [0.6, 2.5])
def test_saf_010_torque_that_waits_in_a_stopped_daemon_is_taken_away_again(
    reachy: RealRobot, twin: Twin, frozen_s: float
) -> None:
    """The daemon is stopped, gets a request to energise, and continues after an e-stop."""
    json_of(reachy.motors(mode="disabled"))
    twin.pause()
    answers: list[Any] = []
    asking = threading.Thread(target=lambda: answers.append(reachy.motors(mode="enabled")))
    asking.start()
    time.sleep(0.1)
    stopping = threading.Thread(target=lambda: answers.extend(estop(by="a button", within_s=5.0)))
    stopping.start()
    time.sleep(frozen_s)
    back_ns = time.monotonic_ns()
    twin.go_on()
    for thread in (asking, stopping):
        thread.join(20.0)
    assert why(next(one for one in answers if isinstance(one, dict)))
    until(lambda: state(reachy) == "disarmed", "it is back, disarmed, and confirmed")
    time.sleep(1.0)
    received = [one for one in twin.log.entries(back_ns) if one.sender == "host" and b"set_m" in one.data]
    enabled = f"{p.SET_MODE}enabled".encode()
    assert any(enabled in one.data for one in received), "the request was under way, and a stop cannot overtake it"
    assert received[-1].safe_state == "limp", "a safe frame is the last one that is carried out"
    assert ask(twin, p.MOTORS) == {"mode": "disabled"}
    assert twin.log.host("setpoint", back_ns) == []


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_the_stop_channel_ends_the_move(reachy: RealRobot, twin: Twin, number: signal.Signals) -> None:
    move(reachy, twin, antenna_left=120.0, duration=8.0)
    time.sleep(0.2)
    began_ns = time.monotonic_ns()
    os.kill(pids(reachy)["wire"], number)
    first_safe(twin.log, began_ns)
    until(lambda: ask(twin, p.RUNNING) == [], "the move has ended")
    until(lambda: state(reachy) == "disarmed", "a new wire, disarmed")
    twin.log.no_setpoint_after_safe(began_ns)
    stands(reachy)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("service", ["wake", "track_face"])
def test_saf_003_a_services_motion_ends_with_its_caller(twin: Twin, run_dir: Path, service: str) -> None:
    script = (
        "import sys, time\nfrom strands_actors import Robot\n"
        f"robot = Robot('reachy_mini', mode='real', port='{twin.port}')\n"
        "assert robot.connect_eagerly() is None\n"
        f"print(robot.{service}(), flush=True)\ntime.sleep(60)\n"
    )
    caller = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE)
    try:
        until(lambda: twin.log.host("setpoint"), "it has begun")
        began_ns = time.monotonic_ns()
        os.kill(caller.pid, signal.SIGKILL)
        first_safe(twin.log, began_ns)
        until(lambda: ask(twin, p.RUNNING) == [], "the move has ended")
        twin.log.no_setpoint_after_safe(began_ns)
    finally:
        caller.kill()
        caller.communicate()


def test_saf_020_a_cable_that_is_back_carries_the_safe_frame_first(reachy: RealRobot, twin: Twin) -> None:
    move(reachy, twin, antenna_left=120.0, duration=9.0)
    twin.unplug()
    until(lambda: state(reachy) in ("lost", "down", None), "it is noticed")
    back_ns = time.monotonic_ns()
    twin.plug()
    safe_ns = first_safe(twin.log, back_ns).t_ns
    received = [one for one in twin.log.entries(back_ns) if one.sender == "host" and one.kind != "read"]
    before = [one for one in received if one.t_ns < safe_ns]
    halves = tuple(f"POST {path} ".encode() for path in (p.STOP, p.TRACKING_OFF))
    assert all(one.data.startswith(halves) for one in before), (
        "earlier frames are the rest of a stop on the stop's connection"
    )
    until(lambda: state(reachy) == "disarmed", "it is back, disarmed")
    twin.log.no_setpoint_after_safe(back_ns)
    stands(reachy)


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("fault", ["garbage", "intermittent", "delayed", "slow"])
def test_saf_006_a_stop_is_sent_at_once_with_any_answer_of_the_daemon(
    reachy: RealRobot, twin: Twin, fault: str
) -> None:
    move(reachy, twin, antenna_left=100.0, duration=8.0)
    twin.fault(fault)
    time.sleep(0.1)
    began_ns = time.monotonic_ns()
    reachy.stop()
    first_safe(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    twin.fault("ok")
    until(lambda: state(reachy) == "disarmed", "confirmed at last")


def test_saf_014_motors_without_torque_are_refused_and_nothing_is_written(twin: Twin, run_dir: Path) -> None:
    httpx.post(f"http://{twin.port}{p.SET_MODE}disabled", trust_env=False)
    began_ns = time.monotonic_ns()
    with Robot("reachy_mini", mode="real", port=twin.port) as robot:
        connected(robot)
        json_of(robot.resume())
        for refusal in (robot.send_action({"head_yaw": 5.0}), robot.wake(), robot.express(move="yes1")):
            assert 'the motors are disabled. Call motors(mode="enabled") first' in why(refusal)
        assert twin.log.host("setpoint", began_ns) == []
        assert ask(twin, p.MOTORS) == {"mode": "disabled"}, "connecting and resume() turn no torque on"
        json_of(robot.motors(mode="enabled"))
        until(lambda: robot.send_action({"head_yaw": 5.0})["status"] == "success", "and now it moves")
        until(lambda: robot.get_observation()["head_yaw"] == pytest.approx(5.0, abs=0.1), "it is there")


def test_saf_003_torque_off_by_another_client_ends_the_live_command(reachy: RealRobot, twin: Twin) -> None:
    began_ns = move(reachy, twin, antenna_left=100.0, duration=8.0)
    httpx.post(f"http://{twin.port}{p.SET_MODE}gravity_compensation", trust_env=False)
    first_safe(twin.log, began_ns)
    until(lambda: state(reachy) == "disarmed", "it is let go of")
    assert "motors are gravity_compensation" in status(reachy)["cause"]


@pytest.mark.long
def test_services(reachy: RealRobot, twin: Twin) -> None:
    assert set(json_of(reachy.list_moves())["moves"]) == {"amazed1", "cheerful1", "yes1"}
    assert len(json_of(reachy.express(move="yes1"))["move"]) == 36
    assert "Use one of amazed1, cheerful1, yes1" in why(reachy.express(move="nothing"))
    json_of(reachy.set_volume(volume=30))
    assert json_of(reachy.volume())["volume"] == 30
    assert json_of(reachy.turn_to_sound_status()) == {"left_deg": pytest.approx(30.0), "speech": True}
    json_of(reachy.turn_to_sound())
    until(lambda: reachy.get_observation()["head_yaw"] == pytest.approx(30.0, abs=0.5), "it has turned there")
    json_of(reachy.turn_to_sound())
    until(lambda: reachy.get_observation()["head_yaw"] == pytest.approx(60.0, abs=0.5), "and again")
    assert "90.0 deg from the body" in why(reachy.turn_to_sound())
    assert json_of(reachy.track_face(enabled=True)) == {"tracking": True}
    assert json_of(reachy.track_face(enabled=False)) == {"tracking": False}
    assert json_of(reachy.tracking_status())["face_target"]["detected"] is False
    assert json_of(reachy.camera())["webrtc"].endswith(":8443")
    json_of(reachy.play_sound(file="wake_up.wav"))
    json_of(reachy.sleep())
    assert reachy.get_observation()["antenna_left"] == pytest.approx(-60.0, abs=1.0)
    json_of(reachy.send_action({"antenna_right": 50.0}))
    time.sleep(0.3)
    assert reachy.get_observation()["antenna_left"] == pytest.approx(-60.0, abs=1.0), (
        "the antenna stays where sleep moved it"
    )


def test_a_stop_cuts_a_service_short(reachy: RealRobot, twin: Twin) -> None:
    answers: list[Any] = []
    sleeper = threading.Thread(target=lambda: answers.append(reachy.sleep()))
    sleeper.start()
    until(lambda: ask(twin, p.RUNNING), "it falls asleep")
    json_of(reachy.stop())
    sleeper.join(10.0)
    assert "stopped meanwhile" in why(answers[0])
    assert ask(twin, p.RUNNING) == []
    stands(reachy)


def test_speech_is_made_at_tts_url(twin: Twin, run_dir: Path) -> None:
    requested: list[Any] = []

    class Speech(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            requested.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            body = b"RIFF....WAVE" if requested[-1]["text"] == "hello" else b"no"
            self.send_response(200)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: Any) -> None:
            pass

    server = HTTPServer(("127.0.0.1", 0), Speech)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        url = f"http://127.0.0.1:{server.server_port}/tts"
        with Robot("reachy_mini", mode="real", port=twin.port, tts_url=url) as robot:
            connected(robot)
            assert json_of(robot.say(text="hello")) == {"said": "hello"}
            assert "no WAV file" in why(robot.say(text="something else"))
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
    assert requested[0] == {"text": "hello"}
    sent = [one.data for one in twin.log.entries() if one.sender == "host" and p.UPLOAD_SOUND.encode() in one.data]
    assert len(sent) == 1 and b"RIFF....WAVE" in sent[0]


def test_an_agent_has_every_verb(reachy: RealRobot, twin: Twin) -> None:
    def tool(**given: Any) -> Any:
        return asyncio.run(reachy.use_tool(given, "test"))

    json_of(tool(action="look", head_yaw=10.0, duration=0.3))
    json_of(tool(action="look_at", look_x=1.0, look_y=0.0, look_z=0.0))
    json_of(tool(action="antennas", antenna_left=20.0))
    json_of(tool(action="body_turn", body_yaw=10.0))
    json_of(tool(action="home"))
    until(lambda: max(map(abs, reachy.get_observation().values())) < 0.5, "it is at home")
    json_of(tool(action="wake"))
    assert json_of(tool(action="turn_to_sound_status"))["speech"] is True
    assert "there is no input" in why(tool(action="express", movement="x"))
    assert "1..128 letters" in why(tool(action="express", move="../x"))
    assert json_of(tool(action="get_state"))["positions"]["head_yaw"] == pytest.approx(0.0, abs=0.5)
    json_of(tool(action="stop"))
    assert "disarmed" in why(tool(action="wake"))


def test_saf_012_sensors_are_in_the_observation(reachy: RealRobot, twin: Twin) -> None:
    until(lambda: "accelerometer_m_s2" in status(reachy)["sensors"], "the IMU of a Wireless")
    sensors = status(reachy)["sensors"]
    assert sensors["accelerometer_m_s2"] == [0.0, 0.0, 9.81] and len(sensors["head_rpy_rad"]) == 3
    assert "battery_pct" not in sensors, "the daemon reports no charge"
    facts = status(reachy)
    assert "Wireless" in json.dumps(facts) and "1.13.0" in json.dumps(facts)


def test_a_charge_that_the_daemon_reports_is_in_the_observation(tmp_path: Path, run_dir: Path) -> None:
    with (
        Twin("reachy_mini", tmp_path, options={"battery": 71}) as twin,
        robot_on(f"http://{twin.port}", "reachy_mini") as robot,
    ):
        until(lambda: status(robot)["sensors"].get("battery_pct") == [71.0], "the charge")


def test_saf_012_silence_is_no_state(reachy: RealRobot, twin: Twin) -> None:
    twin.fault("off")
    until(lambda: state(reachy) in ("lost", "down", None), "it is noticed")
    assert re.search("no state from the daemon for|no longer reports", why(reachy.send_action({"head_yaw": 1.0})))
    twin.fault("ok")
    until(lambda: state(reachy) == "disarmed", "it is back, disarmed")


def test_saf_003_the_root_loads_no_http_client(twin: Twin) -> None:
    script = (
        "from strands_actors.drivers.reachy.driver import Reachy\n"
        "from strands_actors.kernel.clock import MonotonicClock\n"
        "driver = Reachy('reachy_mini', '127.0.0.1', {})\n"
        "driver.preload()\ndriver.stop_channel((), MonotonicClock())\n"
        "import sys\nprint(*sys.modules)"
    )
    loaded = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=True
    ).stdout.split()
    assert "strands_actors.drivers.reachy.stop" in loaded
    assert [
        name
        for name in ("httpx", "httpcore", "rich", "numpy", "strands_actors.drivers.reachy.wire")
        if name in loaded
    ] == []


def test_saf_007_an_estop_drops_the_head(reachy: RealRobot, twin: Twin) -> None:
    move(reachy, twin, antenna_left=100.0, duration=8.0)
    began_ns = time.monotonic_ns()
    (outcome,) = estop(by="a button", within_s=5.0)
    assert (outcome.outcome, outcome.safe_state) == ("safe", "limp")
    assert first_safe(twin.log, began_ns).safe_state == "limp"
    assert ask(twin, p.MOTORS) == {"mode": "disabled"} and ask(twin, p.RUNNING) == []
    assert "e-stopped by a button" in why(reachy.send_action({"head_yaw": 0.1}))
    assert "e-stopped by a button" in why(reachy.motors(mode="enabled"))
    twin.log.no_setpoint_after_safe(began_ns)
