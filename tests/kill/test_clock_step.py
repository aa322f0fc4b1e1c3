"""The wall clock is set by an hour while a robot moves, in the caller and all processes of its tree.

``time.time`` and ``time.time_ns`` are replaced in each process, because a test must not set the machine's
clock. (``test_no_part_of_the_tree_reads_the_wall_clock`` finds other readers of it.) The kernel's
timestamps of datagrams from robots with legs keep the old time here. This is harder than a real change of
the clock.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin
from tests.answers import pids, until
from tests.forked import execute_what_is_started_here

PATIENCE_S = 20.0
SETTLE_S = 0.4
SET = """
import time
_time, _time_ns = time.time, time.time_ns
def _by_s():
    with open({at!r}) as file:
        return int(file.read())
time.time = lambda: _time() + _by_s()
time.time_ns = lambda: _time_ns() + _by_s() * 1_000_000_000
"""
SAY_SO = """
import os
with open({at!r} + ".pids", "a") as file:
    file.write(f"{{os.getpid()}} ")
"""

Start = Callable[..., tuple[RealRobot, Twin]]


@pytest.fixture
def set_clock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[int], list[int]]:
    """Return a function that sets the wall clock of this process and its children by some seconds.

    It returns the pids that were started by exec with this clock. Their forks have it, too.
    """
    execute_what_is_started_here(monkeypatch)
    offset_file = tmp_path / "by_s"
    offset_file.write_text("0")
    (tmp_path / "site").mkdir()
    code = SET.format(at=str(offset_file))
    (tmp_path / "site" / "sitecustomize.py").write_text(code + SAY_SO.format(at=str(offset_file)))
    monkeypatch.syspath_prepend(str(tmp_path / "site"))
    monkeypatch.setattr(time, "time", time.time)
    monkeypatch.setattr(time, "time_ns", time.time_ns)
    exec(code, {})

    def set_by(step_s: int) -> list[int]:
        new = tmp_path / "new"
        new.write_text(str(step_s))
        new.rename(offset_file)
        return list(map(int, Path(f"{offset_file}.pids").read_text().split()))

    return set_by


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_saf_001_a_clock_that_is_set_by_an_hour_stops_nothing(
    strands_robot: Start, set_clock: Callable[[int], list[int]], step_s: int
) -> None:
    """A single command of an arm stays in force as long as its caller's lease. The wire process repeats
    it."""
    arm, twin = strands_robot("so101")
    began_ns = time.monotonic_ns()
    assert arm.send_action({"shoulder_pan": 5.0})["status"] == "success"
    before_s = time.time()
    assert started_by_exec(arm) <= {*set_clock(step_s)}
    assert abs(time.time() - before_s - step_s) < 60
    after_ns = time.monotonic_ns()
    setpoints_go_on(twin, after_ns + 500_000_000)
    assert arm.send_action({"shoulder_pan": 10.0})["status"] == "success"
    assert twin.log.first_safe(began_ns) is None
    stopped = arm.stop()
    assert stopped["status"] == "success", stopped
    twin.log.safe_within(after_ns, PATIENCE_S)
    twin.log.no_setpoint_after_safe(after_ns)


@pytest.mark.parametrize("step_s", [3600, -3600])
def test_saf_012_a_clock_that_is_set_by_an_hour_makes_no_state_of_a_g1_stale(
    strands_robot: Start, set_clock: Callable[[int], list[int]], step_s: int
) -> None:
    robot, twin = strands_robot("g1")
    began_ns = time.monotonic_ns()
    assert started_by_exec(robot) <= {*set_clock(step_s)}
    for _ in range(3):
        assert robot.resume()["status"] == "success"  # each command expires after 100 ms
        answer = robot.send_action({"left_knee": robot.get_observation()["left_knee"]})
        assert answer["status"] == "success", answer
        until(lambda: robot.get_status()["content"][0]["json"]["state"] == "disarmed", "the command has expired")
    assert robot.get_status()["content"][0]["json"]["observation_age_s"] < PATIENCE_S
    robot.stop()
    assert len([entry for entry in twin.log.host("setpoint") if entry.t_ns > began_ns]) >= 3


@pytest.mark.long
@pytest.mark.parametrize("robot", ["xarm7", "spot"])
@pytest.mark.parametrize("step_s", [-3600, 3600])
@pytest.mark.parametrize("killed", [("root", "wire"), ("wire",), ("root",)], ids="+".join)
def test_saf_024_each_process_can_stop_the_robot_after_the_clock_was_set(
    strands_robot: Start,
    set_clock: Callable[[int], list[int]],
    killed: tuple[str, ...],
    step_s: int,
    robot: str,
) -> None:
    """The clock is set once, in one direction. ``test_exhaustion.py`` sets it in both, for each wire."""
    arm, twin = strands_robot(robot)
    name, here = next(iter(arm.get_observation().items()))
    if arm.driver.BEFORE_MOTION:
        assert arm.service(arm.driver.BEFORE_MOTION)["status"] == "success"
    moved = arm.send_action({name: here})
    assert moved["status"] == "success", moved
    set_clock(step_s)
    killed_ns = time.monotonic_ns()
    processes = pids(arm)
    for role in killed:
        os.kill(processes[role], signal.SIGKILL)
    until(lambda: twin.log.first_safe(killed_ns), "a process makes the robot safe")
    time.sleep(SETTLE_S)
    twin.log.no_setpoint_after_safe(killed_ns)


def started_by_exec(robot: RealRobot) -> set[int]:
    tree = robot.tree()
    assert tree is not None
    return {process["pid"] for process in tree["processes"] if process["role"] in ("root", "twin")}


def setpoints_go_on(twin: Twin, since_ns: int) -> int:
    """Wait for twenty setpoints after ``since_ns``, and return the time."""
    until_s = time.monotonic() + PATIENCE_S
    while sum(entry.t_ns > since_ns for entry in twin.log.host("setpoint")) < 20:
        assert time.monotonic() < until_s, "the robot does not move"
        time.sleep(0.02)
    return time.monotonic_ns()
