"""SAF-009: a robot is cleaned up while it is being connected. Nothing is energised after that, and
what was started is ended. Read from the wire."""

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
from strands_actors.caller.processes.run_directory import is_held, notes
from strands_actors.caller.processes.tree_processes import TreeProcesses
from strands_actors.testing import Twin
from tests.answers import json_of, until, why
from tests.forked import execute_what_is_started_here

from .conftest import NewArm

CLEANED_UP = "connect: this robot was cleaned up. make a new one"


@contextlib.contextmanager
def earlier_standby(run_dir: Path) -> Iterator[None]:
    """One of this name that is at work: whoever connects waits for it."""
    life = os.open(run_dir / "so101.standby.life", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(life, fcntl.LOCK_EX)
        yield
    finally:
        os.close(life)


def nothing_is_left(twin: Twin, since_ns: int) -> None:
    until(lambda: not is_held("so101"), "its root has ended")
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
            until(lambda: (run_dir / "so101.lock").exists(), "it has its name, and waits")
            json_of(arm.cleanup())
        assert connecting.result() == CLEANED_UP
    nothing_is_left(twin, began_ns)
    assert "cleaned up" in why(arm.stop())
    json_of(arm.cleanup())


def test_saf_009_a_cleanup_while_the_robot_is_asked_what_it_is_wins(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, go_on = trio.Event(), trio.Event()

    async def completed(plan: Plan) -> Plan:
        asked.set()
        await go_on.wait()
        return plan

    monkeypatch.setattr(real_robot, "completed", completed)
    arm, began_ns = new_arm(port=twin.port), time.monotonic_ns()
    with ThreadPoolExecutor() as thread:
        connecting = thread.submit(arm.connect_eagerly)
        until(asked.is_set, "it is asked")
        assert json_of(arm.cleanup())["reason"] == "nothing was running"
        real_robot.portal().call(_set, go_on)
        assert connecting.result() == CLEANED_UP
    nothing_is_left(twin, began_ns)


@pytest.mark.parametrize("verb", ["connect_eagerly", "resume"])
def test_saf_009_a_cleanup_when_the_root_has_begun_wins(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch, verb: str
) -> None:
    """Whoever starts it is told late that it was started, as ``start`` of a robot elsewhere is."""
    begun, go_on = trio.Event(), trio.Event()
    start, times = TreeProcesses.start, iter([verb == "connect_eagerly", True])

    async def slowly(self: TreeProcesses, beside: Callable[[], Awaitable[None]]) -> None:
        late = next(times)
        if late:
            begun.set()
            with trio.CancelScope(shield=True):
                await go_on.wait()
        self.closed, closed = False, self.closed  # as one that does not look
        await start(self, beside)
        self.closed = closed

    monkeypatch.setattr(TreeProcesses, "start", slowly)
    arm = new_arm(port=twin.port)
    if verb == "resume":
        assert arm.connect_eagerly() is None
        assert arm._tree is not None
        real_robot.portal().call(arm._tree._processes._fence)  # type: ignore[attr-defined]
        until(lambda: twin.log.host("safe"), "its wire has let go")
    began_ns = time.monotonic_ns()
    with ThreadPoolExecutor() as thread:
        doing = thread.submit(getattr(arm, verb))
        until(begun.is_set, "it is being started")
        json_of(arm.cleanup())
        real_robot.portal().call(_set, go_on)
        told = doing.result()
    assert "cleaned up" in (why(told) if verb == "resume" else told)
    nothing_is_left(twin, began_ns)


def test_saf_009_a_cleanup_while_its_twin_begins_is_no_traceback(
    new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    execute_what_is_started_here(monkeypatch)  # which imports for a while before it serves
    arm = new_arm(transport="twin")
    assert arm.twin_process is not None
    with ThreadPoolExecutor() as thread:
        connecting = thread.submit(arm.connect_eagerly)
        until(lambda: arm.twin_process is not None and arm.twin_process.pid, "it begins")
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
def test_saf_009_ctrl_c_while_it_connects_and_a_cleanup_energise_nothing(
    twin: Twin, run_dir: Path, how: str
) -> None:
    """The script goes on, as a notebook does. A ``with`` block that never began cleans up, too."""
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
        time.sleep(2.5)  # a root has begun by then, and what must not happen has no event to wait for
        nothing_is_left(twin, began_ns)
        told, _ = script.communicate("\n", timeout=20)
    assert "cleaned up" in told


async def _set(event: trio.Event) -> None:
    event.set()
