"""The examples run unchanged and print the output that their text announces."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from pathlib import Path

import pytest
import trio

from strands_actors.testing import FakeHardware

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


@pytest.mark.long
def test_a_fleet_is_stopped_and_no_lock_is_left_to_the_next_run() -> None:
    for _ in range(2):
        done = start("estop.py")
        assert done.returncode == 0, done.stderr
        assert done.stdout.splitlines() == [
            "koch: safe, limp, 6 motors",
            "so101: safe, limp, 6 motors",
            "move: e-stopped by the example. resume() lifts the lockout",
            "move: e-stopped by the example. resume() lifts the lockout",
            "so101, after a resume: success",
            "koch, after a resume: success",
        ]


def imported(name: str) -> set[str]:
    """Return the packages that an example imports."""
    nodes = list(ast.walk(ast.parse((EXAMPLES / name).read_text())))
    whole = [each.name for node in nodes if isinstance(node, ast.Import) for each in node.names]
    parts = [node.module or "" for node in nodes if isinstance(node, ast.ImportFrom)]
    return {module.partition(".")[0] for module in (*whole, *parts)}


def test_telemetry_is_read_without_us() -> None:
    assert "zenoh" in imported("telemetry.py") and "strands_actors" not in imported("telemetry.py")

    async def test() -> None:
        async with robot_on_mesh() as (robot, _, _):
            done = await trio.to_thread.run_sync(start, "telemetry.py", "1.5")
            assert done.returncode == 0, done.stderr
            lines = done.stdout.splitlines()
            assert len(lines) > 5
            assert lines[0].startswith(f"strands/{robot}/state #")
            assert lines[0].endswith("armed: a=0.0 b=0.0")

    run(test)


def test_a_robot_is_moved_without_us_and_a_refusal_is_shown() -> None:
    assert "zenoh" in imported("command.py") and "strands_actors" not in imported("command.py")

    async def test() -> None:
        hardware = FakeHardware()
        async with robot_on_mesh(hardware) as (robot, _, _):
            done = await trio.to_thread.run_sync(start, "command.py", robot, "a=5")
            assert done.returncode == 0, done.stderr
            assert '"result": {"commanded": {"a": 5.0}, "unit": "units"}' in done.stdout
            assert hardware.of("setpoint")[0].values == (5.0, 0.0)
            done = await trio.to_thread.run_sync(start, "command.py", robot, "nose=5")
            assert done.returncode == 1 and "nose is not an axis" in done.stderr, done.stdout

    run(test)
