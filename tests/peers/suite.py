"""The peers that the ordinary tests do without: ``python -m tests peers``.

Reachy Mini's own daemon, its robot mocked up, driven by our driver; and npm's roslib (Node.js
20 or newer) against our rosbridge. Each gets an environment in ``benchmarks/.peers`` the first
time, by pip and npm. What a test believes is what the daemon says of itself.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from websockets.sync.client import connect

from benchmarks import peers
from strands_actors import Robot, estop
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.drivers.reachy import protocol as p
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why
from tests.drivers.reachy.test_cameras import Media
from tests.drivers.yahboom.rig import judge_client

HERE = Path(__file__).parent
POSE = "/api/state/present_head_pose"
ROSLIB = "roslib@2.1.0"
STRAIGHT_RAD = 0.1
LOOK_S = 0.05
LONG_S = 300.0
"""For a daemon to begin, on a busy machine."""


def vendors_python() -> str:
    try:
        return peers.python("reachy")
    except peers.Missing:
        peers.make("reachy")
        return peers.python("reachy")


class Daemon:
    """Reachy Mini's, as a process."""

    def __init__(self, kind: str, directory: Path) -> None:
        self.has_torque_for_ever = kind == "--sim"  # it says yes to another mode, and has none
        python = vendors_python()
        port = free_port()
        self.address = f"127.0.0.1:{port}"
        # Kept: to make one computes for 40 ms, and who does so all the time has stopped looking after its robot.
        self._http = httpx.Client(base_url=f"http://{self.address}", trust_env=False, timeout=10.0)
        self._log = (directory / "daemon.log").open("wb")
        options = "--headless --no-media --no-wake-up-on-start --no-goto-sleep-on-stop --no-preload-datasets"
        self.process = subprocess.Popen(
            [
                str(Path(python).with_name("reachy-mini-daemon")),
                kind,
                *options.split(),
                *("--dataset-update-interval", "0", "--fastapi-port", str(port)),
            ],
            env={**os.environ, "PYTHONPATH": str(HERE / "stubs"), "HOME": str(directory)},
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )
        until(self._runs, "the daemon runs", LONG_S)

    def get(self, target: str) -> Any:
        return self._http.get(target).json()

    def post(self, target: str) -> None:
        self._http.post(target).raise_for_status()

    def left_antenna(self) -> float:
        """Where it is, rad."""
        right_then_left: list[float] = self.get("/api/state/present_antenna_joint_positions")
        return right_then_left[1]

    def stands(self) -> None:
        """Nothing plays, and the antenna that was on its way stays where it is. With a body (``--sim``) it
        first comes to where it was last told to be."""
        until(lambda: self.get(p.RUNNING) == [], "no move is played")
        time.sleep(0.5)
        before = self.left_antenna()
        time.sleep(0.5)
        assert self.left_antenna() == pytest.approx(before, abs=0.01)

    def close(self) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.kill()
        self.process.wait()
        self._http.close()
        self._log.close()

    def _runs(self) -> bool:
        assert self.process.poll() is None, "the daemon has ended: see daemon.log"
        try:
            return bool(self.get(p.STATUS)["state"] == "running")
        except httpx.HTTPError:
            return False


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@pytest.fixture(scope="module", params=["--mockup-sim", "--sim"])
def daemon(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    one = Daemon(request.param, tmp_path_factory.mktemp("daemon"))
    try:
        yield one
    finally:
        one.close()


@pytest.fixture
def reachy(daemon: Daemon, run_dir: Path) -> Iterator[RealRobot]:
    """Awake, its antennas and its head straight."""
    robot = Robot("reachy_mini", mode="real", port=daemon.address)
    try:
        until(lambda: robot.connect_eagerly() is None, "it connects", LONG_S)
        json_of(robot.resume())
        json_of(robot.motors(mode="enabled"))
        until(lambda: status(robot)["sensors"]["motor_mode"] == [1.0], "the motors have torque")
        json_of(robot.wake())
        until(lambda: daemon.get(p.RUNNING) == [], "it is awake", LONG_S)  # meanwhile it takes no other move
        # Who is awake already, by where its head is, is not moved: the antennas are where they were.
        until(lambda: straighten(robot, daemon), "its antennas are straight", LONG_S)
        yield robot
    finally:
        robot.cleanup()


def straighten(reachy: RealRobot, daemon: Daemon) -> bool:
    if abs(daemon.left_antenna()) > STRAIGHT_RAD:
        reachy.send_action({"antenna_left": 0.0, "antenna_right": 0.0, "duration": 0.5})
        time.sleep(1.0)
    return abs(daemon.left_antenna()) < STRAIGHT_RAD and bool(daemon.get(p.RUNNING) == [])


def move(reachy: RealRobot, daemon: Daemon) -> None:
    """The left antenna is on a way of 9 s. Told again when a busy machine has ended it."""

    def tell() -> bool:
        if reachy.send_action({"antenna_left": 120.0, "duration": 9.0})["status"] == "success":
            return True
        reachy.resume()  # the daemon answered too late
        return False

    moves(daemon, tell)


def moves(daemon: Daemon, tell: Callable[[], bool]) -> None:
    def told() -> bool:
        before, end_s = daemon.left_antenna(), time.monotonic() + 12.0
        if not tell():
            return False
        while time.monotonic() < end_s:
            if abs(daemon.left_antenna() - before) > 0.1:
                return True
            time.sleep(LOOK_S)
        return False

    until(told, "it moves", LONG_S)


def test_it_goes_where_it_is_told_and_is_refused_what_the_daemon_would_take(
    reachy: RealRobot, daemon: Daemon
) -> None:
    told = status(reachy)
    assert (told["hardware"], told["daemon_version"]) == ("Lite", "1.13.0")
    json_of(reachy.send_action({"head_yaw": 30.0, "antenna_left": 60.0}))
    until(lambda: daemon.left_antenna() == pytest.approx(1.047, abs=0.05), "the antenna is there")
    until(
        lambda: daemon.get("/api/state/present_head_pose")["yaw"] == pytest.approx(0.524, abs=0.05), "and the head"
    )
    until(lambda: reachy.get_observation()["head_yaw"] == pytest.approx(30.0, abs=3.0), "we see it")
    time.sleep(0.5)  # it has come to rest
    before = daemon.left_antenna()
    assert "past 180.0" in why(reachy.send_action({"head_yaw": 515.0})), "9 rad, to which the daemon says ok"
    assert "deg apart" in why(reachy.send_action({"head_yaw": 120.0}))
    assert "past 150.0" in why(reachy.send_action({"antenna_left": 200.0}))
    assert daemon.left_antenna() == pytest.approx(before, abs=0.01)


def test_services_say_what_this_daemon_has_and_what_not(reachy: RealRobot) -> None:
    assert json_of(reachy.tracking_status())["face_target"]["detected"] is False
    assert "no camera to track with" in why(reachy.track_face(enabled=True))
    assert "no direction of sound" in why(reachy.turn_to_sound())
    assert "tts_url" in why(reachy.say(text="hello"))
    json_of(reachy.play_sound(file="wake_up.wav"))


def test_saf_005_a_stop_ends_the_move_on_its_way(reachy: RealRobot, daemon: Daemon) -> None:
    move(reachy, daemon)
    stopped = json_of(reachy.stop())
    assert (stopped["safe_state"], stopped["unconfirmed"]) == ("hold", [])
    daemon.stands()
    assert "call resume() first" in why(reachy.send_action({"head_yaw": 1.0}))


def test_saf_005_a_stop_ends_what_another_client_began(reachy: RealRobot, daemon: Daemon) -> None:
    with connect(f"ws://{daemon.address}{p.SDK}", proxy=None, close_timeout=0.2) as other:

        def tell() -> bool:
            """A daemon that is busy takes no other move, and says so to nobody."""
            other.send(json.dumps({"type": "goto_target", "antennas": [1.5, 1.5], "duration": 9.0}))
            return True

        moves(daemon, tell)
        json_of(reachy.stop())
        daemon.stands()


@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_saf_003_a_wire_that_dies_or_freezes_leaves_a_robot_that_stands(
    reachy: RealRobot, daemon: Daemon, fault: signal.Signals
) -> None:
    move(reachy, daemon)
    os.kill(pids(reachy)["wire"], fault)
    daemon.stands()
    assert abs(daemon.left_antenna()) < 2.0, "it was stopped on its way, 2.09 rad"
    until(lambda: state(reachy) == "disarmed", "another wire is there, and nothing goes on", LONG_S)
    daemon.stands()


def test_saf_010_a_move_that_waits_in_a_frozen_daemon_is_ended(reachy: RealRobot, daemon: Daemon) -> None:
    before = daemon.left_antenna()
    daemon.process.send_signal(signal.SIGSTOP)
    sender = threading.Thread(target=reachy.send_action, args=({"antenna_left": 120.0, "duration": 9.0},))
    sender.start()
    time.sleep(0.2)  # it is in the daemon's socket
    stopped = reachy.stop()
    assert "not confirmed" in why(stopped) or stopped["content"][-1]["json"]["unconfirmed"]
    sender.join()
    time.sleep(1.0)
    daemon.process.send_signal(signal.SIGCONT)
    until(lambda: state(reachy) == "disarmed", "confirmed at last", LONG_S)
    daemon.stands()
    assert abs(daemon.left_antenna() - before) < 1.0


def test_saf_014_motors_without_torque_are_refused(reachy: RealRobot, daemon: Daemon) -> None:
    json_of(reachy.stop())
    json_of(reachy.motors(mode="disabled"))
    json_of(reachy.resume())
    if daemon.has_torque_for_ever:
        assert daemon.get(p.MOTORS)["mode"] == "enabled"
        return
    assert daemon.get(p.MOTORS)["mode"] == "disabled"
    until(lambda: status(reachy)["sensors"]["motor_mode"] == [0.0], "it is read, ten times a second")
    assert 'call motors(mode="enabled") first' in why(reachy.send_action({"head_yaw": 5.0}))
    assert daemon.get(p.MOTORS)["mode"] == "disabled", "nothing but motors() gives torque"


def test_saf_007_an_estop_takes_the_torque(reachy: RealRobot, daemon: Daemon) -> None:
    """Or says that it could not."""
    move(reachy, daemon)
    (outcome,) = estop()
    print(outcome)
    assert outcome.robot == "reachy_mini"
    if daemon.has_torque_for_ever:
        assert outcome.outcome == "unconfirmed", outcome
        daemon.stands()
        return
    assert outcome.outcome == "safe", outcome
    until(lambda: daemon.get(p.MOTORS)["mode"] == "disabled", "the torque is off")
    assert daemon.get(p.RUNNING) == []


def test_the_vendors_client_finds_the_stream_of_our_media_server() -> None:
    """The one by which Reachy's camera is tested (``tests/drivers/reachy/test_cameras.py``)."""
    told = "import sys; from reachy_mini.media.webrtc_utils import get_producer_list as told; "
    script = f"{told}print(told('127.0.0.1', int(sys.argv[1])))"
    media = Media()
    try:
        done = subprocess.run(
            [vendors_python(), "-c", script, str(media.port)],
            env={**os.environ, "PYTHONPATH": str(HERE / "stubs")},
            capture_output=True,
            text=True,
            timeout=LONG_S,
        )
    finally:
        media.close()
    assert "{'name': 'reachymini'}" in done.stdout, done.stderr


def test_roslib_of_npm_drives_reads_and_is_told_what_is_wrong(tmp_path: Path) -> None:
    folder = peers.PLACE / ROSLIB
    node, npm = shutil.which("node"), shutil.which("npm")
    assert node and npm, "this needs Node.js 20 or newer, with npm, on PATH"
    if not (folder / "node_modules" / "roslib").exists():
        subprocess.run([npm, "install", "--silent", "--prefix", str(folder), ROSLIB], check=True, timeout=300.0)
    with Twin("yahboom_m3pro", tmp_path) as twin:
        done = subprocess.run(
            [node, str(HERE / "roslib_client.mjs"), str(folder), twin.port],
            capture_output=True,
            text=True,
            timeout=60.0,
        )
        assert done.returncode == 0, done.stderr
        judge_client(json.loads(done.stdout.splitlines()[-1]), twin)
