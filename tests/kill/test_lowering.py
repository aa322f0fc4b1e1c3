"""SAF-026: an arm whose script is killed is laid down and then limp, and an e-stop makes it limp at once.

Processes are real, and the arm falls in the simulation: its wire log has the frames, and the speed of every touch
of the table.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from strands_actors.testing import Twin
from strands_actors.testing.wirelog import Entry
from tests.answers import until

RAISED = {
    "so101": {"shoulder_lift": -15.0, "elbow_flex": 10.0, "wrist_flex": 15.0},
    "koch": {"shoulder_lift": -15.0, "elbow_flex": -10.0, "wrist_flex": 15.0},
}
LIMIT_M_S = 0.25
"""Far below the speed of a fall from these poses. The bound of 0.15 m/s is asserted in virtual time, as are the
three seconds until the arm is limp."""

SCRIPT = """
import sys, time
from strands_actors import Robot

name, port, pose = sys.argv[1], sys.argv[2], eval(sys.argv[3])
robot = Robot(name, mode="real", port=port, on_exit="lower")
assert robot.connect_eagerly() is None
answer = robot.move_to(pose, seconds=2.0)
print("raised", flush=True)
for line in sys.stdin:
    print(exec(line) or "done", flush=True)
"""
"""Each line that it reads is a line of Python. It answers it with a line of its own."""


class Script:
    """A script that holds an arm raised, and carries out lines of Python."""

    def __init__(self, robot: str, twin: Twin) -> None:
        arguments = [sys.executable, "-c", SCRIPT, robot, twin.port, repr(RAISED[robot])]
        self.process = subprocess.Popen(arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        assert self.process.stdout.readline() == "raised\n"
        until(lambda: bool(twin.log.host("setpoint")), "the arm is moved")
        time.sleep(0.5)  # the arm stands
        self.twin = twin
        twin.log.host("read")

    def do(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def pids(self) -> dict[str, int]:
        """Return the process ids of the robot's tree, by role."""
        assert self.process.stdout is not None
        self.do("import json; print(json.dumps({p['role']: p['pid'] for p in robot.tree()['processes']}))")
        found: dict[str, int] = json.loads(self.process.stdout.readline())
        self.process.stdout.readline()
        return found

    def end(self) -> None:
        self.process.kill()
        self.process.communicate()


@contextmanager
def raised(robot: str, directory: Path) -> Iterator[Script]:
    with Twin(robot, directory) as twin:
        script = Script(robot, twin)
        try:
            yield script
        finally:
            script.end()


def first(twin: Twin, state: str, since_ns: int) -> Entry:
    """Wait for the first frame that brings the whole arm to a safe state, and return it."""

    def frames() -> list[Entry]:
        return [entry for entry in twin.log.host("safe", since_ns) if entry.safe_state == state]

    until(lambda: bool(frames()), f"the arm is {state}")
    return frames()[0]


def touches(twin: Twin, since_ns: int) -> dict[str, float]:
    """Return the greatest speed at which each link touched the table, after the arm came to rest."""
    time.sleep(1.5)
    speeds: dict[str, float] = {}
    for entry in twin.log.entries(since_ns):
        if entry.kind == "touch":
            touch = json.loads(entry.data)
            speeds[touch["body"]] = max(touch["speed_m_s"], speeds.get(touch["body"], 0.0))
    return speeds


@pytest.mark.parametrize("robot", RAISED)
def test_saf_026_a_killed_script_leaves_an_arm_that_is_laid_down_and_limp(tmp_path: Path, robot: str) -> None:
    with raised(robot, tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.process.send_signal(signal.SIGKILL)
        hold = first(twin, "hold", began_ns)
        limp = first(twin, "limp", began_ns)
        assert hold.t_ns < limp.t_ns
        assert twin.log.host("lowering", hold.t_ns)
        assert twin.log.host("setpoint", hold.t_ns + 1) == []
        speeds = touches(twin, began_ns)
        assert speeds and max(speeds.values()) <= LIMIT_M_S, speeds


@pytest.mark.parametrize("robot", RAISED)
@pytest.mark.parametrize("line", ["robot.stop()", "robot.cleanup()"])
def test_saf_026_a_stop_without_hurry_lays_the_arm_down(tmp_path: Path, robot: str, line: str) -> None:
    with raised(robot, tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.do(line)
        first(twin, "limp", began_ns)
        assert twin.log.host("lowering", began_ns)
        speeds = touches(twin, began_ns)
        assert speeds and max(speeds.values()) <= LIMIT_M_S, speeds


def test_saf_026_a_further_stop_while_the_arm_is_lowered_makes_it_limp_at_once(tmp_path: Path) -> None:
    with raised("so101", tmp_path) as script:
        twin, began_ns = script.twin, time.monotonic_ns()
        script.do("import threading; threading.Thread(target=robot.stop).start()")
        hold = first(twin, "hold", began_ns)
        until(lambda: bool(twin.log.host("lowering", began_ns)), "the arm is lowered")
        again_ns = time.monotonic_ns()
        script.do("robot.stop()")
        limp = first(twin, "limp", began_ns)
        assert limp.t_ns - again_ns < 1_000_000_000, "the lowering alone takes longer"
        time.sleep(0.5)
        assert twin.log.host("setpoint", hold.t_ns + 1) == []
        assert [entry for entry in twin.log.host("lowering", limp.t_ns) if b"\x2a\x08" in entry.data] == []


LIMP_AFTER_FAULT_NS = 500_000_000
"""Far below the time of a lowering. The bounds are those of the kill matrix, and this test asserts the order."""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
@pytest.mark.parametrize(
    "victims", [("wire",), ("root",), ("wire", "root"), ("wire", "standby"), ("root", "standby")]
)
def test_saf_026_if_processes_break_while_the_arm_is_lowered_it_is_limp_at_once(
    tmp_path: Path, victims: tuple[str, ...], number: signal.Signals
) -> None:
    with raised("so101", tmp_path) as script:
        twin, pids = script.twin, script.pids()
        began_ns = time.monotonic_ns()
        script.process.send_signal(signal.SIGKILL)
        hold = first(twin, "hold", began_ns)
        until(lambda: bool(twin.log.host("lowering", began_ns)), "the arm is lowered")
        broken_ns = time.monotonic_ns()
        for victim in victims:
            os.kill(pids[victim], number)
        try:
            limp = first(twin, "limp", broken_ns)
            assert limp.t_ns - broken_ns < LIMP_AFTER_FAULT_NS
            time.sleep(0.5)
            assert twin.log.host("setpoint", hold.t_ns + 1) == []
            assert twin.log.host("enable", began_ns) == []
            assert twin.log.host("lowering", limp.t_ns) == []
        finally:
            if number == signal.SIGSTOP:
                for victim in victims:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(pids[victim], signal.SIGKILL)
