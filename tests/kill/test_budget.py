"""SAF-003, SAF-008: a wire process is killed again and again. At the end the robot is safe and stays so
until a resume.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.testing import WireLog
from tests.answers import pids

DEADLINE_S = 20.0


def test_saf_003_a_spent_restart_budget_leaves_the_robot_safe(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = WireLog(tmp_path / "wire.ndjson")
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log.path))
    with Robot("so101", mode="real", transport="twin") as arm:
        arm.send_action({"shoulder_pan": 5.0})
        began_ns = time.monotonic_ns()
        deadline_s = time.monotonic() + DEADLINE_S
        killed: set[int] = set()
        while (tree := arm.tree()) is None or tree["state"] != "failed":
            assert time.monotonic() < deadline_s, f"not given up after {len(killed)} deaths"
            pid = pids(arm).get("wire")
            if pid is not None and pid not in killed:
                os.kill(pid, signal.SIGKILL)
                killed.add(pid)
            time.sleep(0.02)
        assert len(killed) == 4
        assert log.setpoints_after_safe(began_ns) == 0
        assert arm.send_action({"shoulder_pan": 6.0})["status"] == "error"
        resumed_ns = time.monotonic_ns()
        assert arm.resume()["status"] == "success"
        assert not log.host("setpoint", resumed_ns), "a resume restarts no motion"
        assert arm.send_action({"shoulder_pan": 6.0})["status"] == "success"
