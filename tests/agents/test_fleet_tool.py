"""One tool for all robots: a real strands ``Agent``, and an MCP client, list, task and stop them."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from strands import Agent

from strands_actors import Robot, fleet
from strands_actors.caller.handle.real_robot import RealRobot
from strands_actors.kernel.messages import Refused
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.surfaces.agents.fleet import FleetTool
from strands_actors.surfaces.agents.fleet_calls import STOP_ALL, FleetCall, read, spec
from tests.answers import json_of, pids, state, task, why
from tests.trees import connected

from .scripted import Scripted
from .test_mcp import run, served

RUN = {"action": "run", "robot": "left", "instruction": "wave", "policy": "mock", "seconds": 20.0}


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch) -> Iterator[RealRobot]:
    monkeypatch.setenv(ALLOW, "start")  # the robot reads it when its processes start
    robot = Robot("so101", mode="real", transport="twin", id="left")
    yield connected(robot)
    robot.cleanup()


@pytest.fixture
def tool() -> Iterator[FleetTool]:
    one = fleet()
    yield one
    one.close()


def told(tool: FleetTool, *calls: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the result of each call, as the model of an agent received it."""
    model = Scripted(*([("fleet", call)] for call in calls), "done")
    Agent(model=model, tools=[tool], callback_handler=None)("go on")
    assert model.offered[0]["name"] == "fleet"
    return [turn[0] for turn in model.heard]


@pytest.mark.long
def test_a_task_needs_the_approval_that_the_robot_asks_for(tool: FleetTool) -> None:
    with Robot("so101", mode="real", transport="twin", id="left"):
        (refused,) = told(tool, RUN)
    assert "start needs an operator's approval" in why(refused)


def test_an_agent_lists_tasks_and_stops_robots_and_each_robot_decides(left: RealRobot, tool: FleetTool) -> None:
    listed, refused = told(tool, {"action": "list"}, RUN)
    (row,) = json_of(listed)["robots"]
    assert (row["robot"], row["type"], row["state"], row["answers"]) == ("left", "so101", "armed", True)
    assert "left in process" in row["commanded_by"]
    assert "left in process" in why(refused), "the lease decides: this program commands the robot"

    left.release()
    begun, status = told(tool, RUN, {"action": "status", "robot": "left"})
    assert begun["status"] == "success", begun
    assert json_of(status)["task"]["running"]
    (stopped,) = told(tool, {"action": "stop", "robot": "left", "why": "a hand"})
    assert [(row["robot"], row["outcome"]) for row in json_of(stopped)["robots"]] == [("left", "safe")]
    assert state(left) == "disarmed"
    assert not task(left)["running"]
    (again,) = told(tool, RUN)
    assert again["status"] == "error", "a stopped robot needs a resume by a person"


@pytest.mark.long
def test_a_robot_that_does_not_answer_is_named(left: RealRobot, tool: FleetTool) -> None:
    (stopped,) = told(tool, "stop everything now")  # type: ignore[arg-type]  # models do that
    assert json_of(stopped)["robots"][0]["outcome"] == "safe"
    processes = pids(left)
    for role in ("root", "wire"):
        os.kill(processes[role], signal.SIGSTOP)
    (silent,) = told(tool, {"action": "stop_all"})
    assert silent["status"] == "error"
    assert "left is unreachable" in why(silent)


@pytest.mark.parametrize(
    "given",
    [
        {"action": "stop"},
        {"action": "STOP_ALL"},
        "stop",
        {"command": "estop"},
        ["halt"],
        {"action": "stop", "robot": 3},
    ],
)
def test_a_stop_in_any_form_stops_all(given: object) -> None:
    assert read(given) == FleetCall(STOP_ALL)


@pytest.mark.parametrize(
    ("given", "code", "part"),
    [
        (3, "bad_input", "the input is 3"),
        ({"action": "dance"}, "unknown_verb", "list, status, run, stop, stop_all"),
        ({"action": "run", "robot": "left"}, "bad_input", "instruction is missing"),
        ({"action": "run", "robot": 3, "instruction": "x", "policy": "mock"}, "bad_input", "robot is 3"),
        ({"action": "status", "robt": "left"}, "unknown_input", "'robot'"),
        ({"action": "list", "seconds": True}, "unknown_input", "no input"),
    ],
)
def test_a_wrong_call_is_refused_with_what_is_right(given: object, code: str, part: str) -> None:
    refused = read(given)
    assert isinstance(refused, Refused)
    assert refused.code == code
    assert part in refused.text


def test_the_description_is_plain_json() -> None:
    assert json.loads(json.dumps(spec()))["inputSchema"]["json"]["required"] == ["action"]


@pytest.mark.long
def test_an_mcp_client_reaches_all_robots(left: RealRobot, run_dir: Path) -> None:
    async def main() -> None:
        async with served(run_dir, robot="--all") as client:
            (offered,) = (await client.list_tools()).tools
            assert offered.name == "fleet"

            async def use(**given: Any) -> dict[str, Any]:
                envelope = (await client.call_tool("fleet", given)).structured_content
                assert envelope is not None
                return dict(envelope)

            assert json_of(await use(action="list"))["robots"][0]["robot"] == "left"
            assert "--allow-motion" in why(await use(**RUN))
            assert json_of(await use(action="stop_all"))["robots"][0]["outcome"] == "safe"
            assert "nowhere" in why(await use(action="stop", robot="nowhere"))

    run(main)
    assert state(left) == "disarmed"
