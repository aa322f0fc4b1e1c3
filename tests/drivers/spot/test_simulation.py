"""Test that the simulation stands up, walks and reaches."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors import Robot
from tests.answers import json_of, state, until, why


def test_a_simulated_spot_stands_up_walks_for_its_lifetime_and_its_arm_reaches(run_dir: Path) -> None:
    with Robot("spot") as sim:
        json_of(sim.send_action({"vx": 0.5, "arm_el0": 2.0}))
        until(lambda: sim.get_observation()["vx"] == pytest.approx(0.5), "it walks")
        until(lambda: sim.get_observation()["vx"] == 0.0, "it stands when its command has ended")
        assert state(sim) == "holding"
        json_of(sim.send_action({"arm_el0": 2.0}))
        until(lambda: sim.get_observation()["arm_el0"] == pytest.approx(2.0), "the arm is there")
        assert "locomotion controller" in why(sim.send_action({"fl_hx": 0.1}))
        json_of(sim.stop())
