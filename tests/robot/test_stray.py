"""If the run directory is deleted while a robot runs, the robot can still be stopped. The tests read the
simulated robot's wire log.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from strands_actors.caller.handle.robot import RealRobot
from strands_actors.caller.processes.strays import strays
from strands_actors.supervisors.root.locks import Locks
from strands_actors.surfaces.mesh import estop
from strands_actors.testing import Twin
from tests.answers import json_of, until

from .conftest import NewArm
from .helpers import limps

MAIN = "from strands_actors.surfaces.cli import main; main()"
BOUND_S = 20.0
"""The command has to start first. The published bounds are for the wire's part."""


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", MAIN, *arguments],
        text=True,
        capture_output=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        timeout=120,
        check=False,
    )


def clear(run_dir: Path) -> None:
    def cleared() -> bool:
        for path in run_dir.iterdir():
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink()
        return not any(run_dir.iterdir())

    until(cleared, "the root writes nothing more there")


@pytest.mark.quick_cases(1)
@pytest.mark.parametrize("verb", [("stop", "--all"), ("stop", "so101"), ("estop",), ("estop", "so101")])
def test_a_robot_without_its_note_is_stopped_by_ending_its_root(
    arm: RealRobot, twin: Twin, run_dir: Path, verb: tuple[str, ...]
) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    clear(run_dir)
    assert [stray.robot for stray in strays()] == ["so101"]
    began_ns = time.monotonic_ns()
    done = command(*verb)
    assert done.returncode == 1, done
    assert done.stderr.startswith("so101: NOT CONFIRMED: its note in ")
    assert "its wire process, which stops the robot before it ends, has ended" in done.stderr
    twin.log.safe_within(began_ns, BOUND_S)
    assert limps(twin.log, began_ns)
    twin.log.no_setpoint_after_safe(began_ns)
    assert not strays()
    locked = Locks(run_dir / "data" / "locks", "so101").find() is not None
    assert locked == (verb[0] == "estop")


def test_saf_005_an_estop_reports_a_robot_without_its_note(arm: RealRobot, run_dir: Path) -> None:
    json_of(arm.send_action({"shoulder_pan": 5.0}))
    clear(run_dir)
    (outcome,) = estop(by="the button")
    assert (outcome.robot, outcome.outcome) == ("so101", "unreachable")
    assert "its note in" in outcome.detail


def test_a_robot_that_runs_or_starts_is_not_a_stray(twin: Twin, new_arm: NewArm) -> None:
    seen: list[object] = []
    arm = new_arm(port=twin.port)
    assert arm.connect_eagerly() is None
    until(lambda: seen.append(strays()) or len(seen) > 3, "a few looks")
    assert seen == [[]] * len(seen)
