"""Run the conformance checks on a Stretch 3; ``tests/drivers`` does so for a Stretch 2. The simulation lifts,
reaches and drives."""

from __future__ import annotations

from pathlib import Path

import pytest

from strands_actors import Robot
from strands_actors.drivers.stretch.driver import Stretch
from strands_actors.testing import conformance
from tests.answers import json_of, state, until, why


@pytest.mark.parametrize("check", conformance(Stretch, "stretch3", twin=False), ids=str)
def test_stretch_3_conforms(check: object) -> None:
    assert callable(check)
    check()


@pytest.mark.parametrize("name", ["stretch2", "stretch3"])
def test_a_simulated_stretch_lifts_reaches_and_drives_for_its_lifetime(name: str, run_dir: Path) -> None:
    with Robot(name) as sim:
        json_of(sim.send_action({"lift": 0.53, "wrist_yaw": 0.4, "head_pan": -0.3}))
        until(lambda: sim.get_observation()["lift"] == pytest.approx(0.53, abs=1e-3), "the lift is there")
        until(lambda: sim.get_observation()["wrist_yaw"] == pytest.approx(0.4, abs=0.02), "the wrist is there")
        until(lambda: sim.get_observation()["head_pan"] == pytest.approx(-0.3, abs=0.02), "the head is there")
        json_of(sim.set_twist(vx=0.2))
        until(lambda: sim.get_observation()["vx"] > 0.01, "it drives")
        until(lambda: sim.get_observation()["vx"] == pytest.approx(0.0, abs=1e-6), "it stands when that has ended")
        assert state(sim) == "holding"
        assert "cannot drive sideways" in why(sim.set_twist(vy=0.1))
        json_of(sim.stop())
