"""SAF-009: a robot on a network belongs to one tree at a time, like one on a serial port. The tests read
the simulated robot's wire log.
"""

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
from strands_actors.caller.processes.port_claim import claim_port, port_identity
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
    """Another script that connects to the same robot."""

    def __init__(self, kind: str, port: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", SCRIPT, kind, port, json.dumps(KINDS[kind])],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        )

    def __enter__(self) -> Program:
        self.problem = self._read() or ""
        return self

    def __exit__(self, *_: object) -> None:
        self.process.communicate("\n", timeout=20)

    def move(self) -> str:
        assert self.process.stdin is not None
        self.process.stdin.write("move\n")
        self.process.stdin.flush()
        return str(self._read())

    def _read(self) -> str | None:
        assert self.process.stdout is not None
        line: str | None = json.loads(self.process.stdout.readline())
        return line


@pytest.fixture
def made() -> Iterator[list[RealRobot]]:
    robots: list[RealRobot] = []
    yield robots
    for robot in robots:
        robot.cleanup()


def connected(kind: str, twin: Twin, made: list[RealRobot], name: str) -> RealRobot:
    robot = Robot(kind, mode="real", port=twin.port, tool_name=name)
    made.append(robot)
    until(lambda: robot.connect_eagerly() is None, "the robot connects")
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
            assert second.problem == "", "the port is free again"
            assert second.move() == "success"


@pytest.mark.long
def test_saf_009_a_killed_script_that_is_started_again_gets_its_robot(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """The root of the killed script may still run for a moment, and connect waits for its end."""
    with Twin("earthrover", tmp_path) as twin:
        first = Program("earthrover", twin.port)
        with first.process:
            assert first._read() is None
            assert first.move() == "success"
            first.process.send_signal(signal.SIGKILL)
            first.process.wait()
            killed_ns = time.monotonic_ns()
            again = Robot("earthrover", mode="real", port=twin.port, tool_name="again")
            made.append(again)
            assert again.connect_eagerly() is None
            json_of(again.send_action({"linear": 0.1}))
        kinds = [entry.kind for entry in twin.log.entries(killed_ns) if entry.kind in ("safe", "setpoint")]
        assert "safe" in kinds[: kinds.index("setpoint")], "the old root makes safe before the new tree writes"


@pytest.mark.long
def test_saf_009_another_script_gets_a_robot_without_a_root_although_the_first_still_runs(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """Then resume() of the first script is refused, because the robot is in use."""
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


def test_saf_009_connect_waits_for_the_standby_of_an_earlier_tree_although_its_script_runs(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The earlier script still has the robot's name. The name does not decide which process may write to
    the robot.
    """
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


def test_two_units_at_one_address_do_not_wait_for_each_others_standby(
    tmp_path: Path, made: list[RealRobot]
) -> None:
    """Two units behind one gateway, or an arm and its gripper."""
    with Twin("robotiq_2f85", tmp_path) as twin:
        connected("robotiq_2f85", twin, made, "a")
        other = Robot("robotiq_2f85", mode="real", port=twin.port, tool_name="b", unit_id=8)
        made.append(other)
        problem = other.connect_eagerly()
        assert problem is not None and "standby" not in problem, "the twin answers only as unit 9"
        assert pids(made[0])["standby"], "the first robot is not disturbed"


def test_the_place_of_a_robot_is_its_port_or_its_address_and_unit(tmp_path: Path) -> None:
    (tmp_path / "by-id").symlink_to("/dev/null")
    rover = plan("earthrover", "real", port="192.0.2.10")
    assert port_identity(rover) == port_identity(plan("earthrover", "real", port="192.0.2.10", tool_name="other"))
    assert port_identity(plan("ur5e", "real", port="Arm.local")) == port_identity(
        plan("ur10e", "real", port="arm.local")
    )
    assert port_identity(rover) != port_identity(plan("earthrover", "real", port="192.0.2.11"))
    gripper, arm = plan("robotiq_2f85", "real", port="192.0.2.10"), plan("ur5e", "real", port="192.0.2.10")
    assert port_identity(gripper) != port_identity(arm), "an arm and its gripper"
    serial = plan("so101", "real", port="/dev/null")
    assert port_identity(serial) == port_identity(replace(serial, port=str(tmp_path / "by-id"))) == "/dev/null"
    assert port_identity(serial) == port_identity(plan("koch", "real", port="/dev/null")), (
        "the driver does not matter"
    )
    assert port_identity(plan("reachy_mini", "real")) == port_identity(
        plan("reachy_mini", "real", tool_name="other")
    )
    assert port_identity(plan("reachy_mini", "real")) != port_identity(
        plan("reachy_mini", "real", port="192.0.2.10")
    )


def test_when_two_trees_claim_a_port_at_once_one_gets_it(run_dir: Path) -> None:
    requested = plan("earthrover", "real", port="192.0.2.10")

    async def main() -> None:
        held = await claim_port(requested, "a")
        with pytest.raises(NotConnected, match="in use by robot a"):
            await claim_port(requested, "b")
        held.close()
        (await claim_port(requested, "b")).close()

    trio.run(main)
