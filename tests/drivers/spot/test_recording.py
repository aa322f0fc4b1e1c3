"""A recording of a Spot is decided anew by the same gate and watchdog, with equal answers."""

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
        Twin("spot", tmp_path) as twin,
        Robot("spot", mode="real", port=twin.port) as spot,
        record(spot, path),
    ):
        json_of(spot.resume())
        assert "call stand() first" in why(spot.send_action({"vx": 0.2}))
        json_of(spot.service("stand"))
        json_of(spot.send_action({"vx": 0.2}))
        json_of(spot.send_action({"arm_sh0": 0.3}))
        assert "is past" in why(spot.send_action({"vx": 2.0}))
        time.sleep(0.8)
        for _ in range(8):
            json_of(spot.send_action({"vy": 0.1, "wz": 0.1}))
            time.sleep(0.1)
        json_of(spot.stop())
        until(lambda: state(spot) == "disarmed", "it is disarmed")
        json_of(spot.resume())
        json_of(spot.send_action({"arm_f1x": -0.5}))
        time.sleep(0.4)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
