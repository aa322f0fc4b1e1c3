"""A recording of the duck is decided anew by the same gate and watchdog, with equal answers."""

from __future__ import annotations

import time
from pathlib import Path

from strands_actors import Robot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import Twin
from tests.answers import json_of, state, until, why
from tests.trees import connected


def test_a_recording_replays_with_equal_decisions(tmp_path: Path, run_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    with (
        Twin("microduck", tmp_path) as twin,
        Robot("microduck", mode="real", port=twin.port) as duck,
        record(connected(duck), path),
    ):
        assert "call enable() first" in why(duck.send_action({"vx": 0.1}))
        json_of(duck.enable())
        json_of(duck.send_action({"vx": 0.2, "duration": 0.4}))
        json_of(duck.send_action({"head_yaw": 0.3}))
        assert "vx=0.5 m/s is over 0.3 for walk" in why(duck.send_action({"vx": 0.5}))
        time.sleep(0.6)
        json_of(duck.do(skill="kick_left"))
        json_of(duck.stop())
        until(lambda: state(duck) == "disarmed", "it is disarmed")
        json_of(duck.resume())
        json_of(duck.send_action({"vyaw": -0.2, "duration": 0.3}))
        time.sleep(0.5)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
