"""Test that the simulation drives and reaches."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_m3_pro_drives_for_its_lifetime_and_its_arm_reaches(run_dir: Path) -> None:
    with Robot("yahboom_m3pro") as sim:
        json_of(sim.send_action({"linear.x": 0.5, "arm1": 0.4}))
        until(lambda: sim.get_observation()["linear.x"] == pytest.approx(0.5), "it drives")
        until(lambda: sim.get_observation()["linear.x"] == 0.0, "it stands when its command has ended")
        assert state(sim) == "holding"
        json_of(sim.send_action({"arm1": 0.4}))
        until(lambda: sim.get_observation()["arm1"] == pytest.approx(0.4), "the arm is there")
        assert "finite" in why(sim.send_action({"linear.x": float("nan")}))
        json_of(sim.stop())
