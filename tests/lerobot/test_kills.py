"""SIGKILL of a teleoperation with LeRobot's own leader on a bus as that of LeRobot 0.7. The torque is off within
the robot's bound every time. This runs without the privilege that opens a locked port."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.ordinary_user import as_ordinary_user

from .commands import ROOT

REPEATS = 50
BOUND_MS = 50.0
LONGEST_S = 1800.0


@pytest.mark.long
@pytest.mark.parametrize("robot", ["so101", "koch"])
def test_saf_003_50_kills_of_a_teleoperation_take_the_torque_every_time(robot: str) -> None:
    command = [sys.executable, "-m", "tests.lerobot.kills", str(REPEATS), "--leader", "--robot", robot]
    done = subprocess.run(as_ordinary_user(command), cwd=ROOT, capture_output=True, text=True, timeout=LONGEST_S)
    assert done.returncode == 0, done.stderr
    trials = [line.split() for line in done.stdout.splitlines()[:REPEATS]]
    assert len(trials) == REPEATS, done.stdout
    assert all(safe_ms != "None" and float(safe_ms) <= BOUND_MS for safe_ms, _, _ in trials), done.stdout
    assert all((after, torque) == ("0", "0") for _, after, torque in trials), done.stdout
