"""A recording of a Stretch is decided anew by the same gate and watchdog, with equal answers."""

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
        Twin("stretch3", tmp_path) as twin,
        Robot("stretch3", mode="real", port=twin.port) as robot,
        record(robot, path),
    ):
        json_of(robot.send_action({"lift": 0.52, "head_pan": 0.2}))
        for _ in range(5):
            json_of(robot.set_twist(vx=0.1))
            time.sleep(0.1)
        assert "soft limits" in why(robot.send_action({"arm": 0.6}))
        assert "cannot strafe" in why(robot.set_twist(vy=0.1))
        time.sleep(0.5)
        json_of(robot.stop())
        until(lambda: state(robot) == "disarmed", "it is disarmed")
        json_of(robot.resume())
        json_of(robot.send_action({"wrist_roll": 0.2}))
        time.sleep(0.3)
    recording = read(path)
    outcome = replay(recording, build_driver(recording.info))
    assert outcome.equal, outcome.difference
    assert outcome.steps > 20 and outcome.gaps == 0 and outcome.skipped == 0
