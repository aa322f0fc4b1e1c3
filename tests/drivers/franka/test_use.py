"""Test the use of a Franka arm: recorded and replayed, by an agent, from the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from strands import Agent

from strands_actors import Robot
from strands_actors.surfaces.recording import read, record, replay
from strands_actors.testing import Twin
from tests.agents.scripted import Scripted
from tests.answers import json_of, state, until, why
from tests.cli.command import PATIENCE_S, Command
from tests.trees import robot_on

from .arms_on_twins import away, wait_at


def test_a_recording_replays_with_equal_decisions(tmp_path: Path, run_dir: Path) -> None:
    path = tmp_path / "run.mcap"
    with Twin("fr3", tmp_path) as twin, robot_on(twin.port, "fr3") as arm, record(arm, path):
        goal = away(arm, 0.05)
        json_of(arm.send_action(goal))
        wait_at(arm, goal)
        assert why(arm.send_action({"fr3_joint1": 0.0}))
        assert why(arm.send_action({**goal, "fr3_joint1": 9.0}))
        json_of(arm.stop())
        assert why(arm.send_action(goal))
        json_of(arm.resume())
        json_of(arm.send_action(away(arm, -0.05)))
        twin.order("reflex joint_reflex")
        until(lambda: state(arm) == "disarmed", "the reflex ends it")
    outcome = replay(read(path))
    assert outcome.equal, outcome.difference


def test_an_agent_keeps_it_reads_it_and_can_stop_it(tmp_path: Path, run_dir: Path) -> None:
    with Twin("panda", tmp_path) as twin, robot_on(twin.port, "panda") as arm:
        model = Scripted([("panda", {"action": "sensors"})], [("panda", {"action": "stop"})], "done")
        agent = Agent(model=model, tools=[arm], callback_handler=None)
        assert agent.tool_names == ["panda"]
        agent("go on")
        (verbs,) = (spec["inputSchema"]["json"]["properties"]["action"]["enum"] for spec in model.offered)
        assert verbs == ["sensors", "status", "get_pose", "move_to", "stop", "recover"]
        seen, stopped = (results[0] for results in model.heard)
        assert seen["content"][0]["json"]["sensors"]["robot_mode"] == [1.0]
        assert stopped["status"] == "success"
        assert twin.log.host("safe")
        assert "resume() first" in why(arm.send_action(away(arm, 0.01)))


def test_the_command_serves_a_twin_of_the_selected_version(cli: Command, tmp_path: Path) -> None:
    port_file = tmp_path / "port"
    with cli.start("twin", "panda", "--port-file", str(port_file), "--option", "fci=10") as served:
        until(port_file.exists, "the twin serves", PATIENCE_S)
        arm = Robot("panda", mode="real", port=port_file.read_text())
        try:
            assert "controller has FCI 10" in (arm.connect_eagerly() or "")
        finally:
            arm.cleanup()
            served.terminate()
            served.communicate(timeout=PATIENCE_S)


@pytest.mark.parametrize(
    ("option", "said"),
    [("fci=4", "Use one of 5, 10"), ("fci", "'fci' is not KEY=VALUE"), ("speed=1", "Use host, fci, tick_wait_ms")],
)
def test_options_that_a_twin_does_not_have(cli: Command, tmp_path: Path, option: str, said: str) -> None:
    done = cli.run("twin", "panda", "--port-file", str(tmp_path / "port"), "--option", option)
    assert done.returncode == 2
    assert said in done.stderr
