"""SAF-018: a worker process that a script has forked does not keep the script's name or robot. So an
e-stop reaches the robot of the next script. The tests read the simulated robot's wire log.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from strands_actors.caller.processes.run_directory import LockFile, is_running, notes
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from tests.answers import json_of, status, until

from .conftest import NewArm
from .helpers import limps

SCRIPT = """
import multiprocessing, os, sys, time, warnings
from strands_actors import Robot
warnings.simplefilter("ignore")  # this script forks with threads on purpose
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
def test_saf_018_a_forked_worker_that_still_runs_keeps_no_robots_name(
    how: str, twin: Twin, new_arm: NewArm, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """With two robots, both of their names become free."""
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
            until(lambda: not is_running("so101") and not is_running("so101-2"), "the names are free")
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


def test_a_second_close_of_a_lock_closes_no_other_file(tmp_path: Path) -> None:
    """The number of the descriptor may belong to another file by then."""
    held = LockFile(tmp_path / "x.lock")
    number = held.fd
    held.close()
    other = os.open(tmp_path / "y", os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        assert other == number
        held.close()
        assert os.fstat(other)
    finally:
        os.close(other)
