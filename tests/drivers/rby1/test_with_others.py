"""An e-stop on the mesh stops it beside an SO-101; an agent keeps it and can stop it."""

from __future__ import annotations

import time
from pathlib import Path

import strands

from strands_actors import Robot, estop
from strands_actors.testing import Twin
from tests.agents.scripted import Scripted
from tests.answers import json_of, state, until, why


def test_saf_007_one_estop_stops_it_beside_an_so101(tmp_path: Path, run_dir: Path) -> None:
    moves = {"rby1": ("head_0", 0.03), "so101": ("shoulder_pan", 20.0)}
    for kind in moves:
        (tmp_path / kind).mkdir()
    with (
        Twin("rby1", tmp_path / "rby1") as large,
        Twin("so101", tmp_path / "so101") as small,
        Robot("rby1", mode="real", port=large.port) as rby1,
        Robot("so101", mode="real", port=small.port) as so101,
    ):
        for kind, robot in (("rby1", rby1), ("so101", so101)):
            until(lambda robot=robot: robot.connect_eagerly() is None, "it is connected")
            joint, by = moves[kind]
            json_of(robot.send_action({joint: robot.get_observation()[joint] + by}))
        began_ns = time.monotonic_ns()
        outcomes = {outcome.robot: outcome for outcome in estop(by="the button", within_s=3.0)}
        assert {robot: outcome.outcome for robot, outcome in outcomes.items()} == {"rby1": "safe", "so101": "safe"}
        assert (outcomes["rby1"].safe_state, outcomes["so101"].safe_state) == ("stop", "limp")
        time.sleep(0.3)
        for twin in (large, small):
            assert twin.log.safe_within(began_ns, 1.0) >= 0
            assert twin.log.setpoints_after_safe(began_ns) == 0
        assert "e-stopped by the button" in why(rby1.send_action({"head_0": 0.0}))
        json_of(rby1.resume())
        assert "e-stopped" in why(so101.send_action({"shoulder_pan": 0.0})), "each is resumed by itself"


def test_an_agent_keeps_it_and_can_stop_it(tmp_path: Path, run_dir: Path) -> None:
    verbs = [("rby1", {"action": action}) for action in ("state", "sensors", "status", "stop")]
    with Twin("rby1", tmp_path) as twin, Robot("rby1", mode="real", port=twin.port) as robot:
        until(lambda: robot.connect_eagerly() is None, "it is connected")
        model = Scripted(*([verb] for verb in verbs), [("rby1", {"action": "dance"})], "done")
        agent = strands.Agent(model=model, tools=[robot], callback_handler=None)
        assert agent.tool_names == ["rby1"]
        began_ns = time.monotonic_ns()
        agent("Look, then stop.")
        ((first,), (sensors,), (told,), (stopped,), (refused,)) = model.heard
        assert len(json_of(first)["positions"]) == 22
        assert json_of(sensors)["sensors"]["battery_pct"] == [80.0]
        assert json_of(told)["state"] == "armed"
        assert json_of(stopped)["safe_state"] == "stop"
        assert "use sensors, state, status, stop" in why(refused)
        assert twin.log.first_safe(began_ns) is not None
        assert state(robot) == "disarmed"
