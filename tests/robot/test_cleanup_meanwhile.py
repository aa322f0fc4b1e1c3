"""SAF-009: a robot is cleaned up while it is being connected. Afterwards nothing is energised, and all
started processes end. The tests read the simulated robot's wire log.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
import trio

from strands_actors.caller.handle import real_robot
from strands_actors.caller.processes.plan import Plan
from strands_actors.caller.processes.run_directory import is_running, notes
from strands_actors.caller.processes.tree_processes import TreeProcesses
from strands_actors.testing import Twin
from tests.answers import json_of, until, why
from tests.forked import execute_what_is_started_here

from .conftest import NewArm

CLEANED_UP = "connect: this robot was cleaned up. Make a new one"


@contextlib.contextmanager
def earlier_standby(run_dir: Path) -> Iterator[None]:
    """Act as an earlier standby of this robot's name that still runs: connect waits for its end."""
    life = os.open(run_dir / "so101.standby.life", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(life, fcntl.LOCK_EX)
        yield
    finally:
        os.close(life)


def nothing_is_left(twin: Twin, since_ns: int) -> None:
    until(lambda: not is_running("so101"), "the root has ended")
    assert not list(notes())
    for kind in ("enable", "setpoint"):
        assert not twin.log.host(kind, since_ns)


def test_saf_009_a_cleanup_while_it_waits_for_an_earlier_standby_wins(
    twin: Twin, new_arm: NewArm, run_dir: Path
) -> None:
    arm, began_ns = new_arm(port=twin.port), time.monotonic_ns()
    with ThreadPoolExecutor() as thread:
        with earlier_standby(run_dir):
            connecting = thread.submit(arm.connect_eagerly)
            until(lambda: (run_dir / "so101.lock").exists(), "the robot has its name, and connect waits")
            json_of(arm.cleanup())
        assert connecting.result() == CLEANED_UP
    nothing_is_left(twin, began_ns)
    assert "cleaned up" in why(arm.stop())
    json_of(arm.cleanup())


def test_saf_009_a_cleanup_while_connect_asks_the_robot_for_its_type_wins(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    started, go_on = trio.Event(), trio.Event()

    async def completed(plan: Plan) -> Plan:
        started.set()
        await go_on.wait()
        return plan

    monkeypatch.setattr(real_robot, "completed", completed)
    arm, began_ns = new_arm(port=twin.port), time.monotonic_ns()
    with ThreadPoolExecutor() as thread:
        connecting = thread.submit(arm.connect_eagerly)
        until(started.is_set, "connect asks the robot")
        assert json_of(arm.cleanup())["reason"] == "nothing was running"
        real_robot.portal().call(_set, go_on)
        assert connecting.result() == CLEANED_UP
    nothing_is_left(twin, began_ns)


@pytest.mark.parametrize("verb", ["connect_eagerly", "resume"])
def test_saf_009_a_cleanup_after_the_root_has_started_wins(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    """The start reports late that the processes have started, as one on another computer does."""
    begun, go_on = trio.Event(), trio.Event()
    start, times = TreeProcesses.start, iter([verb == "connect_eagerly", True])

    async def slowly(self: TreeProcesses, background: Callable[[], Awaitable[None]]) -> None:
        late = next(times)
        if late:
            begun.set()
            with trio.CancelScope(shield=True):
                await go_on.wait()
        self.closed, closed = False, self.closed  # so that start does not see it
        await start(self, background)
        self.closed = closed

    monkeypatch.setattr(TreeProcesses, "start", slowly)
    arm = new_arm(port=twin.port)
    if verb == "resume":
        assert arm.connect_eagerly() is None
        assert arm._tree is not None
        real_robot.portal().call(arm._tree._processes._fence)  # type: ignore[attr-defined]
        until(lambda: twin.log.host("safe"), "the wire has made the robot safe")
    began_ns = time.monotonic_ns()
    with ThreadPoolExecutor() as thread:
        doing = thread.submit(getattr(arm, verb))
        until(begun.is_set, "the processes are being started")
        json_of(arm.cleanup())
        real_robot.portal().call(_set, go_on)
        result = doing.result()
    assert "cleaned up" in (why(result) if verb == "resume" else result)
    nothing_is_left(twin, began_ns)


def test_saf_009_a_cleanup_while_the_twin_starts_causes_no_traceback(
    new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    execute_what_is_started_here(monkeypatch)  # the new process imports for a while before it serves
    arm = new_arm(transport="twin")
    assert arm.twin_process is not None
    with ThreadPoolExecutor() as thread:
        connecting = thread.submit(arm.connect_eagerly)
        until(lambda: arm.twin_process is not None and arm.twin_process.pid, "the twin has started")
        json_of(arm.cleanup())
        assert connecting.result() == CLEANED_UP
    assert arm.twin_process.pid == 0
    assert not list(notes())


INTERRUPTED = """
import os, signal, sys, threading, time
from pathlib import Path
from strands_actors import Robot
name = Path(os.environ["STRANDS_ACTORS_RUN"], "so101.lock")

def interrupt():
    while not name.exists():
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=interrupt, daemon=True).start()
arm = Robot("so101", mode="real", port=sys.argv[1])
try:
    if sys.argv[2] == "block":
        with arm:
            print("armed", flush=True)
    else:
        arm.connect_eagerly()
except KeyboardInterrupt:
    if sys.argv[2] == "cleanup":
        arm.cleanup()
    print("interrupted", flush=True)
sys.stdin.readline()
print(arm.get_status()["content"][0]["json"]["connect_error"], flush=True)
"""


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("how", ["cleanup", "block"])
def test_saf_009_ctrl_c_and_a_cleanup_while_it_connects_energise_nothing(
    twin: Twin, run_dir: Path, how: str
) -> None:
    """The script continues, as a notebook does. A ``with`` block that was interrupted at its beginning
    also cleans up.
    """
    began_ns = time.monotonic_ns()
    with subprocess.Popen(
        [sys.executable, "-c", INTERRUPTED, twin.port, how],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    ) as script:
        with earlier_standby(run_dir):
            assert script.stdout is not None
            assert script.stdout.readline() == "interrupted\n"
        # A root would have started by then. The test waits for a fixed time, because nothing must happen.
        time.sleep(2.5)
        nothing_is_left(twin, began_ns)
        output, _ = script.communicate("\n", timeout=20)
    assert "cleaned up" in output


async def _set(event: trio.Event) -> None:
    event.set()
