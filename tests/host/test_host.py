"""A host keeps two twins for scripts that come and go, on loopback alone."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from strands_actors import Robot
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.surfaces.cameras import StaleFrame
from strands_actors.surfaces.host.keeper import RobotStatus
from strands_actors.surfaces.host.messages import Verb
from strands_actors.surfaces.host.orders import order
from tests.answers import state, until, why
from tests.cli.command import PATIENCE_S, Command, RobotProcess
from tests.web.browser import Visitor

FLEET = """
[host]
metrics = false
[robot.left]
type = "so101"
transport = "twin"
on_exit = "limp"
guarded = ["move_to"]
cameras.eye = {type = "strands_actors.testing.still_camera:open_camera", fps = 5, width = 32, height = 24}
[robot.right]
type = "so101"
transport = "twin"
on_exit = "limp"
"""
BROKEN = """
[robot.broken]
type = "so101"
port = "/dev/not-there"
"""
SCRIPT = """
import json, sys, time
from strands_actors import Robot
arm = Robot("left", attach=True)
with arm:
    arm.send_action({"shoulder_pan": 5.0})
    print(json.dumps(arm.tree()), flush=True)
    time.sleep(60)
"""


class HostProcess:
    """A host as a process of its own, with the file ``fleet.toml`` in its directory."""

    def __init__(self, cli: Command, folder: Path) -> None:
        self.cli = cli
        self.file = folder / "fleet.toml"

    def start(self, text: str) -> dict[str, Any]:
        self.file.write_text(text)
        self.process = self.cli.start("up", str(self.file), "--json", stderr=subprocess.DEVNULL)
        assert self.process.stdout is not None
        return dict(json.loads(self.process.stdout.readline()))

    def robots(self) -> dict[str, RobotStatus]:
        return {robot.name: robot for robot in order(Verb.STATUS).robots}

    def end(self) -> None:
        self.process.kill()
        self.process.communicate(timeout=PATIENCE_S)
        self.cli.wait_until_gone()


@pytest.fixture
def host(run_dir: Path, tmp_path: Path) -> Iterator[HostProcess]:
    process = HostProcess(Command(run_dir), tmp_path)
    yield process
    process.end()


@contextlib.contextmanager
def systemd(path: Path) -> Iterator[set[str]]:
    """Yield the states that the host reports to systemd."""
    states: set[str] = set()
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(path))

        def read() -> None:
            while data := server.recv(4096):
                states.add(data.decode())

        reader = threading.Thread(target=read)
        reader.start()
        yield states
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as last:
            last.sendto(b"", str(path))
        reader.join()


def attached(name: str) -> RealRobot:
    robot = Robot(name, attach=True)
    deadline_s = time.monotonic() + PATIENCE_S
    while (problem := robot.connect_eagerly()) is not None:
        assert time.monotonic() < deadline_s, problem
    return robot


def has_picture(arm: RealRobot) -> bool:
    try:
        return arm.read_camera("eye").image.shape == (24, 32, 3)
    except StaleFrame:
        return False


def test_scripts_come_and_go_and_the_host_stays(host: HostProcess, run_dir: Path) -> None:
    with systemd(run_dir / "notify") as states:
        host.cli.environment |= {"NOTIFY_SOCKET": str(run_dir / "notify"), "WATCHDOG_USEC": "10000000"}
        began = host.start(FLEET + BROKEN)
        expected = {"READY=1\nSTATUS=2 of 3 robots are up", "WATCHDOG=1"}
        until(lambda: expected <= states, "systemd hears that the host is ready, and alive")
    robots = {robot["name"]: robot for robot in began["robots"]}
    assert {name: robot["phase"] for name, robot in robots.items()} == {
        "left": "up",
        "right": "up",
        "broken": "waiting",
    }, "one robot that cannot be opened does not keep the others from coming up"
    assert "there is no device /dev/not-there" in robots["broken"]["reason"]
    assert {robots["left"]["state"], robots["right"]["state"]} == {"disarmed"}

    second_host = host.cli.run("up", str(host.file))
    assert second_host.returncode == 2
    assert "a host of this user runs already" in second_host.stderr
    with pytest.raises(TypeError, match="only the host of left can set port="):
        Robot("left", attach=True, port="/dev/ttyACM0")  # type: ignore[call-overload]

    # A script attaches, commands, and is killed. The robot holds, its processes run on, and its lease is free.
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=subprocess.PIPE, text=True) as script:
        assert script.stdout is not None
        tree = json.loads(script.stdout.readline())
        roots = [process["pid"] for process in tree["processes"] if process["role"] == "root"]
        assert [process["pid"] for process in tree["processes"] if process["role"] == "host"] == [began["pid"]]
        assert f"left in process {script.pid}" in str(Robot("left", attach=True).connect_eagerly())
        script.kill()
    until(lambda: host.robots()["left"].state == "holding", "the robot holds")
    assert host.robots()["left"].holder == ""

    # Another one takes over. It has the usual verbs, and its end leaves the robot stopped, and up.
    arm = attached("left")
    assert state(arm) == "holding"
    # On a busy machine a setpoint may expire, and the robot holds. Then the command is given again.
    until(lambda: arm.move_to({"shoulder_pan": 8.0}, seconds=0.3)["status"] == "success", "the arm moves")
    until(lambda: arm.run("mock", seconds=0.3)["status"] == "success", "a policy moves the arm")
    until(lambda: has_picture(arm), "the host's camera can be read")
    move = {"action": "move_to", "targets": {"shoulder_pan": 5.0}}
    assert "needs an operator's approval" in why(asyncio.run(arm.use_tool(move, "agent"))), "the file guards it"
    assert arm.stop()["status"] == "success"
    assert arm.cleanup()["status"] == "success"
    tree_after = attached("left")
    after = tree_after.tree()
    assert after is not None
    assert [process["pid"] for process in after["processes"] if process["role"] == "root"] == roots
    tree_after.cleanup()
    shown = host.cli.run("status")
    assert shown.returncode == 1
    assert "left    so101     disarmed" in shown.stdout

    # A reload restarts only what changed.
    right_starts = host.robots()["right"].starts
    host.file.write_text(FLEET.replace('type = "so101"', 'type = "so100"', 1))
    assert order(Verb.RELOAD).changed == ["broken", "left"]
    now = host.robots()
    assert {name: robot.type for name, robot in now.items()} == {"left": "so100", "right": "so101"}
    assert now["right"].starts == right_starts
    host.file.write_text(FLEET + "[robot.third]\ntype = 'nothing'\n")
    refused = host.cli.run("reload", "--json")
    assert refused.returncode == 2
    assert json.loads(refused.stdout)["faults"][0]["line"] == 15
    assert host.robots().keys() == {"left", "right"}, "a bad file changes nothing"

    assert host.cli.json("down")["down"] == ["left", "right"]
    assert host.process.wait(PATIENCE_S) == 0
    with pytest.raises(ConnectionError, match="no host of this user keeps a robot left"):
        Robot("left", attach=True)


@pytest.mark.long
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_a_broken_host_leaves_its_robots_safe_and_they_come_back_disarmed(
    host: HostProcess, fault: signal.Signals
) -> None:
    pid = host.start(FLEET)["pid"]
    arm = attached("left")
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"
    os.kill(pid, fault)
    until(lambda: arm.send_action({"shoulder_pan": 6.0})["status"] == "error", "commands are refused")
    until(lambda: "not connected" in why(arm.send_action({"shoulder_pan": 6.0})), "the robot's processes ended")
    if fault == signal.SIGKILL:
        host.process.communicate(timeout=PATIENCE_S)
        host.start(FLEET)
    else:
        os.kill(pid, signal.SIGCONT)
    until(lambda: host.robots()["left"].state == "disarmed", "the robot is back, disarmed")
    assert arm.connect_eagerly() is None, "the same handle attaches again"
    assert state(arm) == "armed"
    arm.cleanup()


@pytest.mark.long
def test_the_console_of_a_host_shows_its_robots_and_ends_with_it(host: HostProcess) -> None:
    began = host.start(FLEET.replace("metrics = false", "metrics = false\nweb = 0"))
    assert "token" not in json.dumps(began), "what may go to a log has no token"
    until(lambda: bool(host.cli.json("status")["services"]["web"]["address"]), "the console runs")
    with Visitor(host.cli.json("status")["services"]["web"]["address"]) as visitor, visitor.page() as page:
        page.until(
            lambda message: (
                message["type"] == "fleet" and {"left", "right"} <= {each["name"] for each in message["robots"]}
            ),
            "both robots",
        )
        assert host.cli.run("down").returncode == 0
        assert page.closed.wait(PATIENCE_S)


def test_a_service_that_cannot_run_is_named(host: HostProcess) -> None:
    host.start(FLEET.replace("metrics = false", 'metrics = "192.0.2.1:1"\nros2 = {router = "tcp/127.0.0.1:1"}'))

    def problems() -> str:
        services = host.cli.json("status")["services"]
        return " ".join(f"{name}: {service['problem']}" for name, service in services.items())

    until(lambda: "waiting for a zenoh router at tcp/127.0.0.1:1" in problems(), "the missing router")
    until(lambda: "metrics: " in problems() and "assign requested address" in problems(), "the wrong address")


def test_the_robot_of_a_script_is_not_shared(run_dir: Path) -> None:
    with RobotProcess(Command(run_dir)), pytest.raises(ConnectionError, match="so101 was started by a script"):
        Robot("so101", attach=True)


def test_faults_of_the_file_are_shown_and_nothing_starts(run_dir: Path, tmp_path: Path) -> None:
    cli, file = Command(run_dir), tmp_path / "fleet.toml"
    file.write_text("[robot.left]\ntype = 'so101'\nprot = 'x'\nlifetime = 99\n")
    done = cli.run("up", str(file))
    assert done.returncode == 2
    assert [f"{file}:{line}:" in done.stderr for line in (3, 4)] == [True, True]
    assert "nothing was started" in done.stderr
    file.write_text(FLEET)
    assert cli.json("up", str(file), "--check") == {"faults": [], "robots": ["left", "right"]}
    assert "no host of this user runs" in cli.run("status").stderr
