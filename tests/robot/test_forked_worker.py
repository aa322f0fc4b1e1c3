"""SAF-018: a worker that a script forks keeps neither the script's name nor its robot alive: who
comes next is the robot that an e-stop means. Read from the wire."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from strands_actors.caller.processes.run_directory import Held, is_held, notes
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from tests.answers import json_of, status, until

from .conftest import NewArm
from .helpers import limps

SCRIPT = """
import multiprocessing, os, sys, time, warnings
from strands_actors import Robot
warnings.simplefilter("ignore")  # Python's own, of a fork beside threads: that is what this is about
arms = [Robot("so101", mode="real", port=port) for port in sys.argv[2:]]
for arm in arms:
    while arm.connect_eagerly() is not None:
        pass
    arm.send_action({"shoulder_pan": 5.0})
worker = multiprocessing.get_context("fork").Process(target=time.sleep, args=(600,), daemon=True)
worker.start()
if sys.argv[1] == "cleanup":
    for arm in arms:
        arm.cleanup()
print(worker.pid, flush=True)
time.sleep(600)
"""


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("how", ["cleanup", "killed"])
def test_saf_018_a_forked_worker_that_lives_on_keeps_no_robots_name(
    how: str, twin: Twin, new_arm: NewArm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Of two robots: each of its names is free."""
    with (
        Twin("so101", tmp_path_factory.mktemp("second")) as second,
        subprocess.Popen(
            [sys.executable, "-c", SCRIPT, how, twin.port, second.port],
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        ) as script,
    ):
        assert script.stdout is not None
        worker = int(script.stdout.readline())
        killed_ns = time.monotonic_ns()
        try:
            if how == "killed":
                script.kill()
            until(lambda: not is_held("so101") and not is_held("so101-2"), "its names are free")
            assert limps(twin.log)
            assert limps(second.log)
            assert not twin.log.host("setpoint", killed_ns + 10**9)
            assert list(notes()) == []
            arm = new_arm(port=twin.port)
            assert arm.connect_eagerly() is None
            assert arm.name == "so101"
            began_ns = time.monotonic_ns()
            (outcome,) = estop(by="the button", within_s=5.0)
            assert (outcome.robot, outcome.outcome, outcome.locked) == ("so101", "safe", True)
            assert limps(twin.log, began_ns)
            arm.cleanup()
            again = new_arm(port=twin.port)
            assert "the button" in (again.connect_eagerly() or "")
            assert status(again)["locked_by"] == "the button"
            json_of(again.resume())
        finally:
            script.kill()
            os.kill(worker, signal.SIGKILL)


def test_what_was_let_go_of_is_let_go_of_once(tmp_path: Path) -> None:
    """Its number may be another file's by then."""
    held = Held(tmp_path / "x.lock")
    number = held.fd
    held.close()
    other = os.open(tmp_path / "y", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        assert other == number
        held.close()
        assert os.fstat(other)
    finally:
        os.close(other)
