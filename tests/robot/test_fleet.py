"""The fleet benchmark, small: several robots from one process stay armed and get every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

FLEET = Path(__file__).parents[2] / "benchmarks" / "fleet.py"


def test_four_robots_at_20_hz_stay_armed() -> None:
    done = subprocess.run(
        [sys.executable, str(FLEET), "--robots", "4", "--hz", "20", "--seconds", "5"],
        capture_output=True,
        text=True,
        timeout=100,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    told = json.loads(done.stdout or "{}")
    assert done.returncode == 0, (told, done.stderr)
    assert (told["robots"], told["left_armed"], told["safe_frames"], told["events"]) == (4, 0, 0, [])
    assert told["setpoints_per_robot_min"] >= 80  # of 100: the rest is for a busy machine
