"""Test that the simulation moves."""

from __future__ import annotations

from pathlib import Path

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_t1_stands_and_moves_its_arms(run_dir: Path) -> None:
    with Robot("booster_t1") as sim:
        assert abs(sim.get_observation()["left_elbow_pitch"]) < 0.01
        until(
            lambda: (
                sim.send_action({"left_elbow_pitch": 0.5, "right_elbow_pitch": -0.5})
                and sim.get_observation()["left_elbow_pitch"] > 0.45
            ),
            "it moves",
        )
        assert sim.get_observation()["right_elbow_pitch"] < -0.4
        assert "finite" in why(sim.send_action({"left_elbow_pitch": float("nan")}))
        assert "moved only by the onboard controller" in why(sim.send_action({"waist": 0.1}))
        json_of(sim.stop())
        until(lambda: state(sim) == "disarmed", "it is stopped")
        assert sim.get_observation()["left_elbow_pitch"] > 0.4, "the arms do not fall after a stop"
