"""The examples run, as they are, and show what they say."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import trio

from .world import robot_on_mesh, run

EXAMPLES = Path(__file__).parents[2] / "examples"


def start(name: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(EXAMPLES / name), *arguments],
        capture_output=True,
        text=True,
        timeout=100,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
    )


def test_a_fleet_is_stopped() -> None:
    done = start("estop.py")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "koch: safe, limp, 6 motors",
        "so101: safe, limp, 6 motors",
        "move: e-stopped by the example. resume() lifts the lockout",
        "move: e-stopped by the example. resume() lifts the lockout",
        "after a resume: success",
    ]


def test_telemetry_is_read_without_us() -> None:
    imports = {
        name.name.partition(".")[0]
        for node in ast.walk(ast.parse((EXAMPLES / "telemetry.py").read_text()))
        if isinstance(node, ast.Import)
        for name in node.names
    }
    assert "zenoh" in imports and "strands_actors" not in imports

    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            done = await trio.to_thread.run_sync(start, "telemetry.py", "1.5")
            assert done.returncode == 0, done.stderr
            lines = done.stdout.splitlines()
            assert len(lines) > 5
            assert lines[0].startswith(f"strands/{robot}/state #")
            assert lines[0].endswith("armed: a=0.0 b=0.0")

    run(test)
