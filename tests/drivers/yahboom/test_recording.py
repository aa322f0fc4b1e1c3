"""A recording of an M3 Pro is decided anew by the same gate and watchdog, with equal answers."""

from __future__ import annotations

import time
from pathlib import Path

from strands_actors import Robot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.surfaces.recording.code import build_driver
from strands_actors.testing import Twin
from tests.answers import json_of, state, until, why


def test_a_recording_replays_with_equal_decisions(tmp_path: Path, run_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    with (
        Twin("yahboom_m3pro", tmp_path) as twin,
        Robot("yahboom_m3pro", mode="real", port=twin.port) as m3,
        record(m3, path),
    ):
        json_of(m3.send_action({"linear.x": 0.2}))
        json_of(m3.send_action({"arm1": 0.3, "time_ms": 300}))
        assert "is past" in why(m3.send_action({"linear.x": 1.5}))
        time.sleep(0.5)
        for _ in range(8):
            json_of(m3.send_action({"linear.y": 0.1, "angular.z": 0.1}))
            time.sleep(0.1)
        json_of(m3.stop())
        until(lambda: state(m3) == "disarmed", "it is disarmed")
        json_of(m3.resume())
        json_of(m3.send_action({"gripper": -0.5}))
        time.sleep(0.4)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
