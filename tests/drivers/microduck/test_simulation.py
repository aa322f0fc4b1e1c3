"""Test that the simulation walks."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_duck_walks_for_its_duration_and_turns_its_head(run_dir: Path) -> None:
    with Robot("microduck") as sim:
        json_of(sim.send_action({"vx": 0.3, "duration": 0.8, "head_yaw": 0.5}))
        until(lambda: sim.get_observation()["vx"] == pytest.approx(0.3), "it walks")
        until(lambda: sim.get_observation()["vx"] == 0.0, "it stands when its command has ended")
        assert state(sim) == "holding"
        assert sim.get_observation()["head_yaw"] == pytest.approx(0.5), "the head keeps its position"
        json_of(sim.send_action({"z": -0.02, "open": 1.0}))
        until(lambda: sim.get_observation()["open"] == 1.0, "the mouth opens")
        assert "finite" in why(sim.send_action({"vx": float("nan")}))
        assert "robotd accepts no joint targets" in why(sim.send_action({"left_knee": 0.1}))
        json_of(sim.stop())
