"""Test that the simulation drives."""

from __future__ import annotations

from pathlib import Path

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_rover_drives_for_its_lifetime_and_stands(run_dir: Path) -> None:
    with Robot("earthrover") as sim:
        json_of(sim.send_action({"linear": 0.5}))
        assert sim.get_observation()["linear"] in (0.0, 0.5)
        until(lambda: sim.get_observation()["linear"] == 0.5, "it drives")
        until(lambda: sim.get_observation()["linear"] == 0.0, "it stands when its command has ended")
        assert state(sim) == "holding"
        assert "finite" in why(sim.send_action({"linear": float("nan")}))
        json_of(sim.stop())
