"""Test that the simulation moves."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors import Robot
from tests.answers import json_of, until, why


def test_a_simulated_reachy_moves_the_commanded_joints(run_dir: Path) -> None:
    with Robot("reachy_mini") as sim:
        json_of(sim.send_action({"head_yaw": 30.0, "antenna_left": -45.0, "head_z": 10.0}))
        until(lambda: abs(sim.get_observation()["antenna_left"] + 45.0) < 0.1, "it is there")
        seen = sim.get_observation()
        assert (seen["head_yaw"], seen["head_z"]) == pytest.approx((30.0, 10.0), abs=0.1)
        assert "finite" in why(sim.send_action({"head_yaw": float("nan")}))
        json_of(sim.stop())
