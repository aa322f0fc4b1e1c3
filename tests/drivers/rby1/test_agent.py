"""Test that an agent can keep an RB-Y1 as its tool, and stop it."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import strands

from strands_actors import Robot
from strands_actors.testing import Twin
from tests.agents.scripted import Scripted
from tests.answers import json_of, state, until, why


def test_an_agent_keeps_it_and_can_stop_it(tmp_path: Path, run_dir: Path) -> None:
    verbs = [("rby1", {"action": action}) for action in ("state", "sensors", "status", "stop")]
    with Twin("rby1", tmp_path) as twin, Robot("rby1", mode="real", port=twin.port) as robot:
        until(lambda: robot.connect_eagerly() is None, "it is connected")
        model = Scripted(*([verb] for verb in verbs), [("rby1", {"action": "dance"})], "done")
        agent = strands.Agent(model=model, tools=[robot], callback_handler=None)
        assert agent.tool_names == ["rby1"]
        began_ns = time.monotonic_ns()
        agent("Look, then stop.")
        ((first,), (sensors,), (reported,), (stopped,), (refused,)) = model.heard
        assert len(json_of(first)["positions"]) == 22
        assert json_of(sensors)["sensors"]["battery_pct"] == [pytest.approx(80.0, abs=0.5)]
        assert json_of(reported)["state"] == "armed"
        assert json_of(stopped)["safe_state"] == "stop"
        assert "Use sensors, state, status, move_to, stop" in why(refused)
        assert twin.log.first_safe(began_ns) is not None
        assert state(robot) == "disarmed"
