"""SAF-009: a robot on a network belongs to one tree, as one on a serial port does. Read from the
wire."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import trio

from strands_actors import Robot
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.caller.processes import last_standby
from strands_actors.caller.processes.port_claim import claim_port, place
from strands_actors.caller.processes.robot_processes import NotConnected
from strands_actors.caller.processes.run_directory import Name, notes
from strands_actors.caller.resolve.planning import plan
from strands_actors.testing import Twin
from tests.answers import json_of, pids, until

SCRIPT = """
import json, sys, time
from strands_actors import Robot
kind, port, action = sys.argv[1], sys.argv[2], json.loads(sys.argv[3])
robot = Robot(kind, mode="real", port=port, tool_name="b")
print(json.dumps(robot.connect_eagerly()), flush=True)
while sys.stdin.readline() == "move\\n":
    print(json.dumps(robot.send_action(action)["status"]), flush=True)
robot.cleanup()
"""

KINDS = {"earthrover": {"linear": 0.2}, "robotiq_2f85": {"gripper": 0.3}, "yahboom_m3pro": {"linear.x": 0.1}}


class Program:
    """Another script, that wants the robot."""

    def __init__(self, kind: str, port: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, kind, port, json.dumps(KINDS[kind])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )

    def __enter__(self) -> Program:
        self.problem = self._said() or ""
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate("\n", timeout=20)

    def move(self) -> str:
        assert self.process.stdin is not None
        self.process.stdin.write("move\n")
        self.process.stdin.flush()
        return str(self._said())

    def _said(self) -> str | None:
        assert self.process.stdout is not None
        said: str | None = json.loads(self.process.stdout.readline())
        return said


@pytest.fixture
def made() -> Iterator[list[RealRobot]]:
    robots: list[RealRobot] = []
    yield robots
    for robot in robots:
        robot.cleanup()


def connected(kind: str, twin: Twin, made: list[RealRobot], name: str) -> RealRobot:
    robot = Robot(kind, mode="real", port=twin.port, tool_name=name)
    made.append(robot)
    until(lambda: robot.connect_eagerly() is None, "it connects")
    return robot


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("kind", KINDS)
def test_saf_009_a_second_script_does_not_get_a_robot_on_a_network(
    kind: str, tmp_path: Path, made: list[RealRobot]
) -> None:
    with Twin(kind, tmp_path) as twin:
        first = connected(kind, twin, made, "a")
        json_of(first.send_action(KINDS[kind]))
        with Program(kind, twin.port) as second:
            assert f"{twin.port}: in use by robot a (process {os.getpid()}: " in second.problem
            assert "cleanup()" in second.problem
            began_ns = time.monotonic_ns()
            json_of(first.stop())
            assert [second.move() for _ in range(5)] == ["error"] * 5
            assert not twin.log.host("setpoint", began_ns)
        assert [note.robot for note in notes()] == ["a"]
        json_of(first.cleanup())
        with Program(kind, twin.port) as second:
            assert second.problem == "", "it is free again"
            assert second.move() == "success"


@pytest.mark.long
def test_saf_009_a_script_that_is_killed_and_started_again_gets_its_robot(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """Its root may still be there for a moment: it is waited for."""
    with Twin("earthrover", tmp_path) as twin:
        first = Program("earthrover", twin.port)
        with first.process:
            assert first._said() is None
            assert first.move() == "success"
            first.process.send_signal(signal.SIGKILL)
            first.process.wait()
            killed_ns = time.monotonic_ns()
            again = Robot("earthrover", mode="real", port=twin.port, tool_name="again")
            made.append(again)
            assert again.connect_eagerly() is None
            json_of(again.send_action({"linear": 0.1}))
        kinds = [entry.kind for entry in twin.log.entries(killed_ns) if entry.kind in ("safe", "setpoint")]
        assert "safe" in kinds[: kinds.index("setpoint")], "the old root first, then ours"


@pytest.mark.long
def test_saf_009_a_robot_whose_root_is_gone_is_anybodys_though_its_script_goes_on(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """And the script's own resume() finds it taken."""
    with Twin("earthrover", tmp_path) as twin:
        first = connected("earthrover", twin, made, "a")
        os.kill(pids(first)["root"], signal.SIGKILL)
        second = connected("earthrover", twin, made, "b")
        json_of(second.send_action({"linear": 0.1}))
        answer = first.resume()
        assert answer["status"] == "error"
        assert "in use by robot b" in answer["content"][0]["text"]
        second.cleanup()
        json_of(first.resume())


def test_saf_009_the_standby_of_an_earlier_tree_is_waited_for_though_its_script_goes_on(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whose script still has its name: that says nothing about who may write to the robot."""
    monkeypatch.setattr(last_standby, "WAIT_S", 0.1)
    name = Name("a")
    life = os.open(run_dir / "a.standby.life", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        os.write(life, json.dumps({"pid": 0, "place": "192.0.2.10"}).encode())
        fcntl.flock(life, fcntl.LOCK_EX)
        with pytest.raises(NotConnected, match="standby of an earlier tree"):
            trio.run(last_standby.until_over, "b", "192.0.2.10")
        assert trio.run(last_standby.until_over, "b", "192.0.2.11") is None
    finally:
        os.close(life)
        name.release()


def test_two_that_are_told_apart_at_one_address_keep_no_standby_from_each_other(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """Two units behind one gateway, or an arm and its gripper."""
    with Twin("robotiq_2f85", tmp_path) as twin:
        connected("robotiq_2f85", twin, made, "a")
        other = Robot("robotiq_2f85", mode="real", port=twin.port, tool_name="b", unit_id=8)
        made.append(other)
        problem = other.connect_eagerly()
        assert problem is not None and "standby" not in problem, "the twin is unit 9 alone"
        assert pids(made[0])["standby"], "and the first one goes on"


def test_what_one_tree_at_a_time_may_have(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to("/dev/null")
    rover = plan("earthrover", "real", port="192.0.2.10")
    assert place(rover) == place(plan("earthrover", "real", port="192.0.2.10", tool_name="other"))
    assert place(plan("ur5e", "real", port="Arm.local")) == place(plan("ur10e", "real", port="arm.local"))
    assert place(rover) != place(plan("earthrover", "real", port="192.0.2.11"))
    gripper, arm = plan("robotiq_2f85", "real", port="192.0.2.10"), plan("ur5e", "real", port="192.0.2.10")
    assert place(gripper) != place(arm), "an arm and its gripper"
    serial = plan("so101", "real", port="/dev/null")
    assert place(serial) == place(replace(serial, port=str(tmp_path / "by-id"))) == "/dev/null"
    assert place(serial) == place(plan("koch", "real", port="/dev/null")), "whoever drives it"
    assert place(plan("reachy_mini", "real")) == place(plan("reachy_mini", "real", tool_name="other"))
    assert place(plan("reachy_mini", "real")) != place(plan("reachy_mini", "real", port="192.0.2.10"))


def test_of_two_that_want_a_port_at_once_one_gets_it(run_dir: Path) -> None:
    wanted = plan("earthrover", "real", port="192.0.2.10")

    async def main() -> None:
        held = await claim_port(wanted, "a")
        with pytest.raises(NotConnected, match="in use by robot a"):
            await claim_port(wanted, "b")
        held.close()
        (await claim_port(wanted, "b")).close()

    trio.run(main)
