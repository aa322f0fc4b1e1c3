"""Drive real programs of other vendors: ``python -m tests peers``. The ordinary tests do not load this suite.

Our driver drives Reachy Mini's own daemon with a mocked robot. npm's roslib (Node.js 20 or newer) drives our
rosbridge, and npm's rosmsg2-serialization reads our messages of ROS 2. The first run installs each with pip or npm
in ``benchmarks/.peers``. The tests take the state that the daemon reports as the truth.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
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
from strands_actors.kernel.channels.ros2 import cdr
from strands_actors.kernel.channels.ros2.cdr import FORMATS
from strands_actors.kernel.channels.ros2.definitions import ARRAY, MESSAGES, SINGLE, fields_of, parse_type
from strands_actors.testing import Twin
from tests.answers import json_of, pids, state, status, until, why
from tests.drivers.reachy.test_cameras import Media
from tests.drivers.yahboom.rig import judge_client
from tests.ports import free_port
from tests.ros2.peer import STORE

HERE = Path(__file__).parent
POSE = "/api/state/present_head_pose"
ROSLIB = "roslib@2.1.0"
ROSMSG2 = ("@foxglove/rosmsg2-serialization@3.1.0", "@foxglove/rosmsg@5.0.5")
STRAIGHT_RAD = 0.1
LOOK_S = 0.05
LONG_S = 300.0
"""Timeout for the start of a daemon, on a busy machine."""


def vendors_python() -> str:
    try:
        return peers.python("reachy")
    except peers.Missing:
        peers.make("reachy")
        return peers.python("reachy")


class Daemon:
    """The daemon of Reachy Mini, as a process."""

    def __init__(self, kind: str, directory: Path) -> None:
        self.has_torque_for_ever = kind == "--sim"  # the simulated daemon accepts another mode and ignores it
        python = vendors_python()
        port = free_port()
        self.address = f"127.0.0.1:{port}"
        # Keep one client: making one takes 40 ms of computation. Meanwhile the test would not serve its robot.
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
        """Return the position of the left antenna, rad."""
        right_then_left: list[float] = self.get("/api/state/present_antenna_joint_positions")
        return right_then_left[1]

    def stands(self) -> None:
        """Wait until no move is active and the moving antenna stands still. With a simulated body (``--sim``) the
        antenna first reaches its last target."""
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
        assert self.process.poll() is None, "the daemon has exited: see daemon.log"
        try:
            return bool(self.get(p.STATUS)["state"] == "running")
        except httpx.HTTPError:
            return False


@pytest.fixture(scope="module", params=["--mockup-sim", "--sim"])
def daemon(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Daemon]:
    one = Daemon(request.param, tmp_path_factory.mktemp("daemon"))
    try:
        yield one
    finally:
        one.close()


@pytest.fixture
def reachy(daemon: Daemon, run_dir: Path) -> Iterator[RealRobot]:
    """A robot that is awake, with straight antennas and head."""
    robot = Robot("reachy_mini", mode="real", port=daemon.address)
    try:
        until(lambda: robot.connect_eagerly() is None, "it connects", LONG_S)
        json_of(robot.resume())
        json_of(robot.motors(mode="enabled"))
        until(lambda: status(robot)["sensors"]["motor_mode"] == [1.0], "the motors have torque")
        json_of(robot.wake())
        until(lambda: daemon.get(p.RUNNING) == [], "it is awake", LONG_S)  # until then it accepts no other move
        # A robot whose head shows that it is awake is not moved, so its antennas are where they were.
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
    """Start a move of 9 s with the left antenna. Start it again if a busy machine has ended it."""

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


def test_reachy_reaches_its_target_and_the_gate_refuses_targets_that_the_daemon_would_accept(
    reachy: RealRobot, daemon: Daemon
) -> None:
    shown = status(reachy)
    assert (shown["hardware"], shown["daemon_version"]) == ("Lite", "1.13.0")
    json_of(reachy.send_action({"head_yaw": 30.0, "antenna_left": 60.0}))
    until(lambda: daemon.left_antenna() == pytest.approx(1.047, abs=0.05), "the antenna is there")
    until(
        lambda: daemon.get("/api/state/present_head_pose")["yaw"] == pytest.approx(0.524, abs=0.05), "and the head"
    )
    until(lambda: reachy.get_observation()["head_yaw"] == pytest.approx(30.0, abs=3.0), "we see it")
    time.sleep(0.5)  # until the antenna is at rest
    before = daemon.left_antenna()
    assert "past 180.0" in why(reachy.send_action({"head_yaw": 515.0})), "9 rad, which the daemon would accept"
    assert "deg apart" in why(reachy.send_action({"head_yaw": 120.0}))
    assert "past 150.0" in why(reachy.send_action({"antenna_left": 200.0}))
    assert daemon.left_antenna() == pytest.approx(before, abs=0.01)


def test_services_report_the_parts_that_this_daemon_has_or_lacks(reachy: RealRobot) -> None:
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
    assert "Call resume() first" in why(reachy.send_action({"head_yaw": 1.0}))


def test_saf_005_a_stop_ends_a_move_of_another_client(reachy: RealRobot, daemon: Daemon) -> None:
    with connect(f"ws://{daemon.address}{p.SDK}", proxy=None, close_timeout=0.2) as other:

        def tell() -> bool:
            """Start the move again and again: a busy daemon ignores it without an error."""
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
    assert abs(daemon.left_antenna()) < 2.0, "the antenna stopped before its target, 2.09 rad"
    until(lambda: state(reachy) == "disarmed", "another wire is there, and nothing goes on", LONG_S)
    daemon.stands()


def test_saf_010_a_move_that_waits_in_a_frozen_daemon_is_ended(reachy: RealRobot, daemon: Daemon) -> None:
    before = daemon.left_antenna()
    daemon.process.send_signal(signal.SIGSTOP)
    sender = threading.Thread(target=reachy.send_action, args=({"antenna_left": 120.0, "duration": 9.0},))
    sender.start()
    time.sleep(0.2)  # until the request waits in the daemon's socket
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
    assert daemon.get(p.MOTORS)["mode"] == "disabled", "only motors() switches the torque on"


def test_saf_007_an_estop_takes_the_torque(reachy: RealRobot, daemon: Daemon) -> None:
    """If the torque stays on, the e-stop must report it."""
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
    """The tests of Reachy's camera use the same server (``tests/drivers/reachy/test_cameras.py``)."""
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


def from_npm(*packages: str) -> tuple[str, Path]:
    """Install packages of npm at the first call. Return the path of Node.js, and the folder with node_modules."""
    folder = peers.PLACE / packages[0].replace("/", "-")
    node, npm = shutil.which("node"), shutil.which("npm")
    assert node and npm, "this needs Node.js 20 or newer, with npm, on PATH"
    if not (folder / "node_modules").exists():
        subprocess.run([npm, "install", "--silent", "--prefix", str(folder), *packages], check=True, timeout=300.0)
    return node, folder


def filled(name: str, number: int = 1) -> dict[str, Any]:
    """Return a message in which each field has another value, and each sequence two elements."""
    message: dict[str, Any] = {}
    for field, text in fields_of(name).items():
        number += 1
        base, kind, size = parse_type(text)
        if base == "string":
            one: Any = f"text {number}"
        elif base in FORMATS:
            one = number % 2 == 0 if base == "bool" else number
        else:
            one = filled(base, number)
        message[field] = one if kind == SINGLE else [one] * (size if kind == ARRAY else 2)
    return message


def as_numbers(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: as_numbers(each) for key, each in value.items()}
    return [as_numbers(each) for each in value] if isinstance(value, bytes | list) else value


def test_foxgloves_library_reads_our_messages_of_ros_2() -> None:
    node, folder = from_npm(*ROSMSG2)
    names = sorted(MESSAGES.keys() & STORE.fielddefs.keys() - {"service_msgs/msg/ServiceEventInfo"})
    payloads = {name: cdr.encode(name, filled(name)) for name in names}
    messages = [
        {"definition": STORE.generate_msgdef(name, ros_version=2)[0], "bytes": payload.hex()}
        for name, payload in payloads.items()
    ]
    done = subprocess.run(
        [node, str(HERE / "rosmsg2.mjs"), str(folder)],
        input=json.dumps(messages),
        capture_output=True,
        text=True,
        timeout=60.0,
    )
    assert done.returncode == 0, done.stderr
    expected = [as_numbers(cdr.decode(name, payload)) for name, payload in payloads.items()]
    for name, ours, theirs in zip(names, expected, json.loads(done.stdout), strict=True):
        assert theirs == ours, name


def test_roslib_of_npm_drives_reads_and_gets_errors(tmp_path: Path) -> None:
    node, folder = from_npm(ROSLIB)
    with Twin("yahboom_m3pro", tmp_path) as twin:
        done = subprocess.run(
            [node, str(HERE / "roslib_client.mjs"), str(folder), twin.port],
            capture_output=True,
            text=True,
            timeout=60.0,
        )
        assert done.returncode == 0, done.stderr
        judge_client(json.loads(done.stdout.splitlines()[-1]), twin)
