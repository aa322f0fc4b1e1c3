"""A recording of the rover is decided anew by the same gate and watchdog, with equal answers."""

from __future__ import annotations

import time
from pathlib import Path

from strands_actors import Robot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import Twin
from tests.answers import json_of, state, task_ended, until, why


def test_a_recording_replays_with_equal_decisions(tmp_path: Path, run_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    with (
        Twin("earthrover", tmp_path) as twin,
        Robot("earthrover", mode="real", port=twin.port) as rover,
        record(rover, path),
    ):
        json_of(rover.send_action({"linear": 0.2}))
        json_of(rover.send_action({"lamp": 1.0}))
        assert "is past" in why(rover.send_action({"linear": 1.5}))
        time.sleep(0.5)
        json_of(rover.run_policy(lambda seen: {"linear": 0.1, "angular": 0.1}, duration=1.0))
        task_ended(rover)
        json_of(rover.stop())
        until(lambda: state(rover) == "disarmed", "it is disarmed")
        json_of(rover.resume())
        json_of(rover.send_action({"angular": -0.2}))
        time.sleep(0.4)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
