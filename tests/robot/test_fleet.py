"""A short fleet benchmark: several robots of one process stay armed and get every command."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from typing import Any

import pytest

ATTEMPTS = 3
"""A machine that pauses for longer than a robot may be silent stops that robot. Then the test tries again."""


@pytest.mark.long
def test_four_robots_at_20_hz_stay_armed() -> None:
    for _ in range(ATTEMPTS):
        done, result = run_fleet()
        if result.get("left_armed") == 0:
            break
    assert done.returncode == 0, (result, done.stderr)
    assert (result["left_armed"], result["safe_frames"], result["restarts"]) == (0, 0, 0), done.stderr
    assert result["commands_hz"] >= 16  # 20 are sent, but the machine may be busy


def run_fleet() -> tuple[subprocess.CompletedProcess[str], dict[str, Any]]:
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.sides.fleet", "short", "--robots", "4", "--hz", "20", "--seconds", "5"],
        capture_output=True,
        text=True,
        timeout=100,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )
    return done, json.loads(done.stdout or "{}")
