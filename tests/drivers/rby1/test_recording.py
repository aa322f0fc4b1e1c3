"""A recording of an RB-Y1 replays with the same decisions: setpoints, refusals, the button, a
stop."""

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
    with Twin("rby1", tmp_path) as twin, Robot("rby1", mode="real", port=twin.port) as robot, record(robot, path):
        here = robot.get_observation()["head_0"]
        json_of(robot.send_action({"head_0": here + 0.02}))
        assert "steps" in why(robot.send_action({"head_0": here + 1.0}))
        assert "is past" in why(robot.send_action({"torso_0": 4.0}))
        began_s = time.monotonic()
        sway = lambda seen: {"head_0": here + 0.02 + 0.05 * math.sin(time.monotonic() - began_s)}  # noqa: E731
        json_of(robot.run_policy(sway, duration=1.0))
        task_ended(robot)
        twin.order("emergency-stop pressed")
        until(lambda: state(robot) == "disarmed", "it is disarmed")
        twin.order("emergency-stop released")
        until(lambda: robot.resume()["status"] == "success", "it is armed again")
        json_of(robot.stop())
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
