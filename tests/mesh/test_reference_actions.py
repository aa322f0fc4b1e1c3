"""Commands in the vocabulary of strands-robots, from other processes. A reading needs no lease. A motion takes a
lease, needs an operator's approval, and has an end."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import trio

from strands_actors import Robot, broadcast, estop, get_peers, open_mesh, tell
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.messages import Refused
from strands_actors.surfaces.mesh.client import MeshClient
from strands_actors.surfaces.mesh.mapping_commands import send
from strands_actors.testing import Twin
from tests.answers import json_of, until, why

from .world import raw

ALLOW = "STRANDS_ACTORS_ALLOW"


@pytest.fixture
def twin(tmp_path: Path) -> Iterator[Twin]:
    with Twin("so101", tmp_path) as served:
        yield served


@pytest.fixture
def arm(twin: Twin) -> Iterator[RealRobot]:
    """An armed arm with a free lease."""
    with Robot("so101", mode="real", port=twin.port) as robot:
        json_of(robot.release())
        yield robot


@pytest.fixture
def simulated() -> Iterator[RealRobot]:
    with Robot("so101") as robot:
        json_of(robot.release())
        yield robot


def on_mesh(use: Callable[[MeshClient], Any]) -> Any:
    async def run() -> Any:
        async with open_mesh() as client:
            await client.settle()
            return await use(client)

    return trio.run(run)


def sent(*commands: Any) -> list[Any]:
    """Send the commands from one sender, and return the answers."""

    async def use(client: MeshClient) -> list[Any]:
        return [await send(client, "so101", command) for command in commands]

    answers: list[Any] = on_mesh(use)
    return answers


def code(answer: Any) -> str:
    assert isinstance(answer, Refused), answer
    return answer.code


# -- reading


def test_a_reading_needs_no_lease_and_no_clock(arm: RealRobot, twin: Twin) -> None:
    began_ns = time.monotonic_ns()
    json_of(arm.send_action({"gripper": 50.0}))  # the arm's own program holds the lease
    until(lambda: twin.log.host("setpoint", began_ns), "it moves")
    for locked in (False, True):
        ping, state, features, tool, teleop, status, nothing = sent(
            "ping", "state", "features", "describe_tool", "teleop_status", "status", {}
        )
        assert (ping["pong"], ping["peer_id"]) == (True, "so101")
        assert state["joints"]["shoulder_pan.pos"] == state["joints"]["shoulder_pan"]
        assert features["action_features"]["gripper"] == "float" and features["limits"]["gripper"] == [0.0, 100.0]
        assert tool["tool_name"] == "so101" and len(tool["tool_spec_hash"]) == 64
        assert "move_to" in tool["spec"]["inputSchema"]["json"]["properties"]["action"]["enum"]
        assert teleop == {"inputs": [], "publishers": {}, "receivers": {}}
        assert status["task"]["running"] is False and nothing.keys() == status.keys()
        assert bool(status["locked_by"]) is locked
        if not locked:
            assert status["lease"].startswith("so101 in process")
            estop(by="the test")


def test_a_program_of_the_reference_is_answered_as_it_asks(arm: RealRobot) -> None:
    """Its envelope has no reading of the robot's clock. Readings are answered and motion is refused."""
    answers: list[dict[str, Any]] = []

    async def use(client: MeshClient) -> None:
        key = "strands/dashboard/response/**"
        client.subscribe(key, lambda received: answers.append(json.loads(received.payload)))
        moving = {"instruction": "wave", "policy_provider": "mock", "duration": 1.0}
        for turn, command in enumerate(({"action": "ping"}, {"action": "state"}, {"action": "execute", **moving})):
            envelope = {"sender_id": "dashboard", "turn_id": f"{turn}", "target_id": "so101", "command": command}
            await raw(client, "so101", json.dumps({**envelope, "timestamp": time.time()}).encode())
        with trio.fail_after(20):
            while len(answers) < 3:  # noqa: ASYNC110
                await trio.sleep(0.01)

    on_mesh(use)
    by_turn = {answer["turn_id"]: answer for answer in answers}
    assert [by_turn[turn]["type"] for turn in "012"] == ["response", "response", "error"]
    assert by_turn["0"]["result"]["pong"] is True and "joints" in by_turn["1"]["result"]
    assert by_turn["2"]["refused"]["code"] in ("put", "malformed")


# -- a policy


def test_a_policy_runs_for_the_requested_time_and_leaves_the_robot_free(simulated: RealRobot) -> None:
    done = tell("so101", "wave", policy_provider="mock", duration=1.0)
    assert (done["running"], done["exit_reason"], done["instruction"]) == (False, "duration", "wave"), done
    assert done["steps"] > 5
    again = tell("so101", "wave", policy_provider="mock", n_steps=5)  # no resume is needed in between
    assert (again["exit_reason"], again["steps"]) == ("n_steps", 5), again
    late = tell("so101", "wave", policy_provider="mock", duration=0.5, n_steps=10_000_000)
    assert late["exit_reason"] == "duration" and late["elapsed_s"] < 2.0, late
    until(lambda: simulated.send_action({"gripper": 50.0})["status"] == "success", "it is its own program's again")


@pytest.mark.parametrize(
    ("command", "text"),
    [
        ({"policy_provider": "mock", "instruction": ""}, "instruction"),
        ({"policy_provider": "mock", "instruction": "x" * 2001}, "instruction"),
        ({"instruction": "wave"}, "policy_provider"),
        ({"policy_provider": "mock", "instruction": "wave", "duration": 0}, "duration"),
        ({"policy_provider": "mock", "instruction": "wave", "duration": 3601}, "duration"),
        ({"policy_provider": "mock", "instruction": "wave", "durration": 1}, "durration"),
        ({"policy_provider": "teleport", "instruction": "wave"}, "policy_provider is 'teleport'. Use one of"),
        (
            {"policy_provider": "os:system", "instruction": "wave"},
            "the name of a policy that is installed on the robot",
        ),
        (
            {"policy_provider": "remote", "policy_port": 80, "policy_host": "evil.example", "instruction": "wave"},
            "policy_host is 'evil.example'",
        ),
    ],
)
def test_saf_014_an_invalid_task_starts_no_process(
    simulated: RealRobot, command: dict[str, Any], text: str
) -> None:
    (answer,) = sent({"action": "start", **command})
    assert isinstance(answer, Refused) and text in answer.text, answer
    tree = simulated.tree()
    assert tree is not None and not [one for one in tree["processes"] if one["role"] == "policy"]


def test_a_real_robot_needs_an_operators_approval(arm: RealRobot, twin: Twin) -> None:
    for command in (
        {"action": "start", "instruction": "wave", "policy_provider": "mock", "duration": 1.0},
        {"action": "execute", "instruction": "wave", "policy_provider": "mock", "duration": 1.0},
        {"action": "set_joints", "target_joints": {"gripper": 50.0}},
    ):
        (answer,) = sent(command)
        assert code(answer) == "not_approved" and ALLOW in answer.text, answer
    for action in ("step", "reset"):
        (answer,) = sent(action)
        assert code(answer) == "no_simulation", answer
    with pytest.raises(PermissionError, match="needs an operator's approval"):
        tell("so101", "wave", policy_provider="mock", duration=1.0)
    assert not twin.log.host("setpoint")


def test_saf_002_a_stop_ends_a_policy_that_was_started_over_the_mesh(
    twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(ALLOW, "start")
    with Robot("so101", mode="real", port=twin.port) as arm:
        json_of(arm.release())
        (begun,) = sent({"action": "start", "instruction": "wave", "policy_provider": "sine", "duration": 600.0})
        assert not isinstance(begun, Refused) and begun["running"] is True, begun
        until(lambda: len(twin.log.host("setpoint")) > 20, "it moves, though who asked has gone")
        (other,) = sent({"action": "start", "instruction": "wave", "policy_provider": "sine"})
        assert code(other) == "running"  # a second start, also from another sender, is refused
        assert "holds the lease" in why(arm.send_action({"gripper": 1.0}))
        stopped_ns = time.monotonic_ns()
        (stopped,) = broadcast("stop")
        assert stopped["result"]["outcome"] == "safe", stopped
        assert twin.log.setpoints_after_safe(stopped_ns) == 0
        time.sleep(1.2)  # longer than any lease
        assert twin.log.setpoints_after_safe(stopped_ns) == 0
        (late,) = sent({"action": "start", "instruction": "wave", "policy_provider": "sine"})
        assert code(late) == "disarmed", late  # a command does not restart stopped motion


def test_saf_009_a_robot_that_its_own_program_holds_is_not_taken(simulated: RealRobot) -> None:
    json_of(simulated.send_action({"gripper": 50.0}))
    for command in (
        {"action": "start", "instruction": "wave", "policy_provider": "mock"},
        {"action": "set_joints", "target_joints": {"gripper": 10.0}},
        {"action": "step"},
        {"action": "reset"},
    ):
        (answer,) = sent(command)
        assert code(answer) == "lease" and "holds the lease" in answer.text, answer
    assert simulated.get_status()["content"][0]["json"]["lease"].startswith("so101 in process")


# -- a pose


def test_a_pose_is_taken_up_for_its_time_and_then_held(twin: Twin, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(ALLOW, "set_joints")
    with Robot("so101", mode="real", port=twin.port) as arm:
        json_of(arm.release())
        for target in (40.0, 60.0):  # the second one needs no resume
            command = {"action": "set_joints", "target_joints": {"gripper": target}, "duration": 1.0}
            began = time.monotonic()
            (answer,) = sent(command)
            assert answer["commanded"] == {"gripper": target}, answer
            until(lambda target=target: abs(arm.get_observation()["gripper"] - target) < 2.0, "it is there")  # type: ignore[misc]
            until(lambda: not arm.get_status()["content"][0]["json"]["lease"], "nobody has it")
            assert time.monotonic() - began > 0.9
            until(lambda: arm.get_status()["content"][0]["json"]["state"] == "holding", "it is held")
        (bad,) = sent({"action": "set_joints", "target_joints": {"gripper": 101.0}})
        assert code(bad) == "past_travel" and bad.verb == "set_joints"
        until(lambda: not arm.get_status()["content"][0]["json"]["lease"], "nothing is left of what was refused")


def test_saf_010_a_pose_that_comes_again_or_late_is_not_taken_up(simulated: RealRobot) -> None:
    async def use(client: MeshClient) -> list[Any]:
        clock = await client.clock("so101")
        assert not isinstance(clock, Refused)
        command = {"action": "set_joints", "target_joints": {"gripper": 10.0}, "clock": clock.name}
        late = {**command, "deadline_ns": clock.deadline(client.now_ns()) - 1}
        in_time = {**command, "deadline_ns": clock.deadline(client.now_ns()) + 5 * 10**9}
        answers = [await client.request("so101", late)]
        monkey = client._new_turn
        client._new_turn = lambda: "the-same"  # type: ignore[method-assign]
        try:
            answers += [await client.request("so101", in_time) for _ in range(2)]
        finally:
            client._new_turn = monkey  # type: ignore[method-assign]
        return answers

    late, first, again = on_mesh(use)
    assert code(late) == "expired"
    assert not isinstance(first, Refused), first
    assert code(again) == "duplicate"


# -- a simulation


@pytest.mark.long
def test_a_simulation_steps_and_is_put_back(simulated: RealRobot) -> None:
    home = simulated.get_observation()["gripper"]
    moved, stepped = sent(
        {"action": "set_joints", "target_joints": {"gripper": home + 40.0}, "duration": 5.0},
        {"action": "step", "steps": 500},
    )
    assert moved["commanded"] == {"gripper": home + 40.0}, moved
    assert stepped["position"]["gripper"] == pytest.approx(home + 40.0, abs=3.0), stepped
    (back,) = sent("reset")
    assert code(back) == "lease"  # another sender's pose still holds the lease
    until(lambda: not simulated.get_status()["content"][0]["json"]["lease"], "its time is over")
    (back,) = sent("reset")
    assert not isinstance(back, Refused), back
    until(lambda: abs(simulated.get_observation()["gripper"] - home) < 2.0, "it is where it began")
    assert simulated.get_status()["content"][0]["json"]["state"] == "armed"


# -- requests to all robots


def test_robots_are_listed_and_a_request_goes_to_all() -> None:
    with Robot("so101") as one, Robot("koch") as other:
        until(lambda: one.is_connected and other.is_connected, "both are there")
        peers = get_peers()
        assert [peer["peer_id"] for peer in peers] == ["koch", "so101"]
        assert all(peer["type"] == "robot" and peer["reachable"] and peer["age"] < 2.0 for peer in peers)
        assert peers[1]["hw"] == "so101" and peers[1]["hostname"]
        answers = broadcast({"action": "ping"})
        assert [(row["responder_id"], row["result"]["pong"]) for row in answers] == [
            ("koch", True),
            ("so101", True),
        ]
        with pytest.raises(PermissionError, match="execute cannot be sent to all robots at once"):
            broadcast({"action": "execute", "instruction": "wave"})
        with pytest.raises(PermissionError, match="'dance' is no action") as refused:
            broadcast("dance")
        offered = "Send status, observe, ping, state, features, describe_tool, teleop_status, stop"
        assert str(refused.value).endswith(offered), "it lists exactly the requests that go to all robots"
        for nothing in (None, 5, ["ping"]):
            with pytest.raises(PermissionError, match=r"the command is .* Give an action"):
                broadcast(nothing)  # type: ignore[arg-type]
        with pytest.raises(
            PermissionError, match=r"the action 'call' is not available: .* Use the tool with an agent"
        ):
            broadcast({"action": "call", "function": "render"})
        with pytest.raises(PermissionError, match="nemo is not on the mesh"):
            tell("nemo", "wave", policy_provider="mock")
    assert get_peers() == []
