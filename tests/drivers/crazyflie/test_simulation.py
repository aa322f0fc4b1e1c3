"""Test that the simulation flies."""

from __future__ import annotations

from pathlib import Path

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_drone_rises_moves_hovers_and_lands(run_dir: Path) -> None:
    with Robot("crazyflie") as sim:
        assert abs(sim.get_observation()["z"]) < 0.01, "the drone starts on the floor"
        until(lambda: sim.send_action({"z": 0.5}) and sim.get_observation()["z"] > 0.4, "it rises")
        until(lambda: sim.send_action({"vx": 0.3, "z": 0.5}) and sim.get_observation()["vx"] > 0.2, "it moves")
        until(lambda: abs(sim.get_observation()["vx"]) < 0.02, "a late command ends in a hover")
        assert sim.get_observation()["z"] > 0.3
        assert state(sim) == "holding"
        assert "finite" in why(sim.send_action({"vx": float("nan")}))
        json_of(sim.stop())
        until(lambda: abs(sim.get_observation()["z"]) < 0.01, "a stop lands it")
