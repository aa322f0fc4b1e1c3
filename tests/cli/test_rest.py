"""Test ``strands-actors rest``: teach the pose of an arm on its twin, see it, and find it again in a robot."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from strands_actors.contract.loading import load
from strands_actors.testing import Twin
from tests.cli.command import MAIN

COMMAND = (sys.executable, "-c", MAIN, "rest")


def rest(folder: Path, *arguments: str, pressed: str = "") -> subprocess.CompletedProcess[str]:
    environ = {**os.environ, "HF_LEROBOT_CALIBRATION": str(folder)}
    return subprocess.run(
        [*COMMAND, *arguments], input=pressed, capture_output=True, text=True, timeout=60, env=environ, check=False
    )


def test_a_taught_pose_is_shown_and_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with Twin("so101", tmp_path) as twin:
        taught = rest(tmp_path, "so101", "--port", twin.port, "--id", "mine", "--teach", "--json", pressed="\n")
    assert taught.returncode == 0, taught.stderr
    pose = json.loads(taught.stdout)["rest"]
    assert set(pose) == {"shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"}
    assert not twin.log.host("enable"), "teaching energises nothing"

    shown = rest(tmp_path, "so101", "--id", "mine", "--json")
    assert json.loads(shown.stdout)["rest"] == pose

    monkeypatch.setenv("HF_LEROBOT_CALIBRATION", str(tmp_path))
    driver = load("strands_actors.drivers.feetech.driver:Feetech")
    assert driver.resolve("so101", {"tool_name": "mine", "on_exit": "lower"})["rest"] == pose
    assert driver.resolve("so101", {"tool_name": "mine"})["rest"] is None
    assert driver.resolve("so101", {"tool_name": "other", "on_exit": "lower"})["rest"] is None


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("so101",), "cannot be read"),
        (("so101", "--teach"), "--port is missing"),
        (("so101", "--id", "a/b"), "cannot be called so"),
        (("open_duck_mini",), "is not lowered"),
        (("xarm7",), "is no robot of Feetech or Dynamixel servos"),
        (("so101", "--port", "/dev/nowhere", "--teach"), "/dev/nowhere"),
    ],
)
def test_a_wrong_use_is_refused_with_what_to_do(tmp_path: Path, arguments: tuple[str, ...], text: str) -> None:
    refused = rest(tmp_path, *arguments)
    assert refused.returncode == 2
    assert text in refused.stderr
    assert not list(tmp_path.rglob("*.json")), "nothing is written"
