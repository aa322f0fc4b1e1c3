"""Test the pytest plugin: it costs nothing until a test uses a fixture. The fixture then runs a real tree."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

import strands_actors
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.testing import Twin, WireLog

from .blinky import Blinky

ROOT = Path(strands_actors.__file__).parents[1]

NOTHING = """
import sys

def test_nothing_was_imported():
    heavy = {"trio", "zenoh", "mujoco", "serial", "strands_actors.testing", "strands_actors.robot"}
    assert heavy & set(sys.modules) == set()
"""


def test_it_is_an_entry_point_under_its_own_name() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["pytest11"] == {"strands_actors.pytest_plugin": "strands_actors.pytest_plugin"}


def test_it_imports_nothing_by_itself(tmp_path: Path) -> None:
    (tmp_path / "test_it.py").write_text(NOTHING)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "strands_actors.pytest_plugin", str(tmp_path)]
    alone = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}  # without the import time of other plugins
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=alone, check=False)
    assert done.returncode == 0, done.stdout


def test_the_fixture_runs_a_third_party_robot(strands_robot: Callable[..., tuple[RealRobot, Twin]]) -> None:
    robot, twin = strands_robot("blinky", Blinky)
    assert robot.send_action({"joint": 5.0})["status"] == "success"
    assert robot.stop()["status"] == "success"
    assert [entry.safe_state for entry in twin.log.host("safe")] == ["limp"]


# -- queries of the log

SETPOINT, SAFE, READ = (
    '{"t_ns": %d, "from": "host", "kind": "' + kind + '", "hex": "01"}\n' for kind in ("setpoint", "safe", "read")
)


def log(path: Path, *lines: str) -> WireLog:
    path.write_text("".join(lines))
    return WireLog(path)


def test_saf_002_a_setpoint_after_the_safe_frame_is_found(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"
    log(path, SETPOINT % 1, SAFE % 2, READ % 3).no_setpoint_after_safe(0)
    with pytest.raises(AssertionError, match="1 setpoints after"):
        log(path, SAFE % 2, SETPOINT % 2).no_setpoint_after_safe(0)
    with pytest.raises(AssertionError, match="no safe frame"):
        log(path, SETPOINT % 1).no_setpoint_after_safe(0)
    log(path, SAFE % 2, SETPOINT % 9).no_setpoint_after_safe(0, until_ns=9)


def test_silence_is_of_everything_or_of_some_kinds(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"
    log(path, SETPOINT % 1, SAFE % 2).silent_after(3)
    log(path, SAFE % 2, READ % 4).silent_after(3, "setpoint", "safe")
    with pytest.raises(AssertionError, match="a read frame"):
        log(path, READ % 4).silent_after(3)
    with pytest.raises(AssertionError, match="a setpoint frame"):
        log(path, SETPOINT % 3).silent_after(3, "setpoint")


def test_a_missed_bound_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "wire.ndjson"
    assert log(path, SAFE % 50_000_000).safe_within(0, 0.05) == 0.05
    with pytest.raises(AssertionError, match="bound 40 ms"):
        log(path, SAFE % 50_000_000).safe_within(0, 0.04)
