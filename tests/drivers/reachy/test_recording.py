"""A recording of Reachy is decided anew by the same gate and watchdog, with equal answers."""

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
        Twin("reachy_mini", tmp_path) as twin,
        Robot("reachy_mini", mode="real", port=twin.port) as reachy,
        record(reachy, path),
    ):
        json_of(reachy.send_action({"head_yaw": 20.0}))
        assert "is past" in why(reachy.send_action({"head_pitch": 41.0}))
        json_of(reachy.wake())
        json_of(reachy.send_action({"look_x": 1.0, "look_y": 0.2, "look_z": 0.0}))
        json_of(reachy.stop())
        until(lambda: state(reachy) == "disarmed", "it is disarmed")
        assert "disarmed" in why(reachy.express(move="yes1"))
        json_of(reachy.resume())
        json_of(reachy.send_action({"antenna_left": 5.0}))
        time.sleep(0.2)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
