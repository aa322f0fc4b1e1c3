"""Two programs that use one robot, and two robots with the same name."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes.run_directory import notes
from strands_actors.testing import Twin
from tests.answers import json_of, status
from tests.forked import execute_what_is_started_here

from .conftest import NewArm
from .helpers import at

SCRIPT = """
import json, sys
from strands_actors import Robot
arm = Robot("so101", mode="real", port=sys.argv[1])
problem = arm.connect_eagerly()
print(json.dumps({"name": arm.name, "problem": problem}), flush=True)
sys.stdin.readline()
arm.cleanup()
"""


SNATCH = """
import os, sys, threading
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
def take():
    while True:
        os.read(port, 64)
threading.Thread(target=take, daemon=True).start()
print("open", flush=True)
sys.stdin.readline()
os._exit(0)
"""


class Program:
    """Another process that opens an arm and keeps it until the end of the block."""

    def __init__(self, port: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, port],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )

    def __enter__(self) -> Program:
        assert self.process.stdout is not None
        self.report = json.loads(self.process.stdout.readline())
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate("\n", timeout=20)


@pytest.fixture(autouse=True)
def executed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Execute new processes, because the error message names the program whose child uses the port."""
    execute_what_is_started_here(monkeypatch)


def _this_program() -> str:
    """Return how error messages in other programs name this one, up to where its command line is cut."""
    line = Path("/proc/self/cmdline").read_bytes().replace(b"\0", b" ").decode()
    return f"robot so101 (process {os.getpid()}: {line[:40]}"


@pytest.mark.long
def test_a_program_that_uses_the_port_without_a_lock_is_named(twin: Twin, new_arm: NewArm) -> None:
    """That program reads the servos' answers to the handshake."""
    with subprocess.Popen(
        [sys.executable, "-c", SNATCH, twin.port], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as snatcher:
        assert snatcher.stdout is not None and snatcher.stdout.readline() == b"open\n"
        reason = new_arm(port=twin.port).connect_eagerly() or ""
        snatcher.communicate(b"\n", timeout=10)
    assert f"in use by {sys.executable}" in reason and f"(process {snatcher.pid})" in reason
    assert "two servos" not in reason


def test_a_second_robot_on_the_port_is_refused_and_the_first_goes_on(
    arm: RealRobot, twin: Twin, new_arm: NewArm
) -> None:
    arm.send_action({"shoulder_pan": 10.0})
    began_ns = time.monotonic_ns()
    second = new_arm(port=twin.port)
    reason = second.connect_eagerly() or ""
    assert twin.port in reason, status(arm)
    assert f"in use by {_this_program()}" in reason
    assert second.name == "so101-2"
    second.cleanup()

    assert not twin.log.host("safe", began_ns)  # the refused program has released nothing
    reported = status(arm)
    assert (reported["state"], reported["connected"], reported["faults"]) == ("armed", True, {})
    at(arm, "shoulder_pan", 10.0)
    assert arm.send_action({"shoulder_pan": 0.0})["status"] == "success"


def test_another_program_is_refused_and_can_connect_after_the_first(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    with Program(twin.port) as program:
        assert f"{twin.port}: in use by {_this_program()}" in program.report["problem"]
    assert not twin.log.host("safe", began_ns)
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"
    json_of(arm.cleanup())
    with Program(twin.port) as program:
        assert program.report == {"name": "so101", "problem": None}


def test_a_refused_robot_can_connect_when_the_port_is_free(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    second = new_arm(port=twin.port)
    assert second.connect_eagerly() is not None
    arm.cleanup()
    assert second.connect_eagerly() is None
    assert second.send_action({"shoulder_pan": 5.0})["status"] == "success"


@pytest.mark.long
def test_a_refused_robot_does_not_take_the_port_by_itself(arm: RealRobot, twin: Twin, new_arm: NewArm) -> None:
    second = new_arm(port=twin.port)
    assert second.connect_eagerly() is not None
    arm.cleanup()
    time.sleep(2.5)  # longer than the longest pause between two attempts
    third = new_arm(port=twin.port, tool_name="third")
    assert third.connect_eagerly() is None


@pytest.mark.usefixtures("arm")
def test_robots_of_the_same_name_get_numbers(tmp_path_factory: pytest.TempPathFactory) -> None:
    with (
        Twin("so101", tmp_path_factory.mktemp("second")) as twin,
        Program(twin.port) as program,
    ):
        assert program.report == {"name": "so101-2", "problem": None}
        assert [note.robot for note in notes()] == ["so101", "so101-2"]
    assert [note.robot for note in notes()] == ["so101"]
