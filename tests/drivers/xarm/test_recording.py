"""A recording of an xArm replays with the same decisions: setpoints, refusals, a controller's
error, a stop."""

from __future__ import annotations

import math
import time
from pathlib import Path

from strands_actors import Robot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import Twin
from tests.answers import json_of, state, task_ended, until, why


def test_a_recording_replays_with_equal_decisions(tmp_path: Path, run_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    with Twin("xarm7", tmp_path) as twin, Robot("xarm7", mode="real", port=twin.port) as arm, record(arm, path):
        here = arm.get_observation()["joint1"]
        json_of(arm.send_action({"joint1": here + 0.02}))
        assert "steps" in why(arm.send_action({"joint1": here + 1.0}))
        assert "is past" in why(arm.send_action({"joint4": 4.0}))
        began_s = time.monotonic()
        sway = lambda seen: {"joint1": here + 0.02 + 0.05 * math.sin(time.monotonic() - began_s)}  # noqa: E731
        json_of(arm.run_policy(sway, duration=1.0))
        task_ended(arm)
        twin.order("error 31")
        until(lambda: state(arm) == "disarmed", "it is disarmed")
        twin.order("error 0")
        until(lambda: arm.resume()["status"] == "success", "it is armed again")
        json_of(arm.stop())
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
