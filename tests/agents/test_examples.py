"""The examples run unchanged and leave the robot safe."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.testing import WireLog
from tests.cli.command import ROOT
from tests.robot.helpers import torque_now

SAID = {
    "policy": (
        "in this process: ",
        "in its own: ",
        "too fast: ",
        "Step at most",
        "stopped:         lowered, 6 motors confirmed",
    ),
    "agent": (
        "error: move_to: shoulder_pan 400.0 deg is past 110.1. Stay within -110.0..110.1",
        "success: {'commanded': {'shoulder_pan': 20.0}}",
        "operator: agent asks so101: set_torque enabled=True? no",
        "error: set_torque: set_torque needs an operator's approval: it was not given",
        "success: {'stopped': True, 'safe_state': 'lowered', 'unconfirmed': []}",
    ),
}


@pytest.mark.parametrize("name", SAID)
def test_an_example_runs_and_ends_safe(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "wire.ndjson"
    monkeypatch.setenv("STRANDS_ACTORS_TWIN_LOG", str(log))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    command = [sys.executable, str(ROOT / "examples" / f"{name}.py")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=100)
    print(done.stdout)
    assert done.returncode == 0, done.stderr
    assert [text for text in SAID[name] if text not in done.stdout] == [], done.stdout
    assert WireLog(log).host("setpoint")
    assert set(torque_now(WireLog(log)).values()) == {0}
