"""A real strands ``Agent`` with a scripted model drives a robot."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from strands import Agent, tool

from strands_actors import Robot
from strands_actors.caller.handle.robot import RealRobot
from strands_actors.kernel.processes.guard import ALLOW
from strands_actors.surfaces.agents.approval import Request
from strands_actors.testing import Twin
from tests.answers import json_of, state, status, task, until, why
from tests.robot.conftest import NewArm
from tests.robot.helpers import armed_at, at, goals, limps, torque_now

from .scripted import Scripted, Turn


def agent(model: Scripted, *tools: Any) -> Agent:
    return Agent(model=model, tools=list(tools), callback_handler=None)


def told(model: Scripted, *tools: Any) -> list[list[dict[str, Any]]]:
    """Return the tool results that the model received, by turn."""
    agent(model, *tools)("go on")
    return model.heard


def call(robot: RealRobot, given: Any) -> dict[str, Any]:
    """Call the tool once, as the agent's loop does."""

    async def use() -> dict[str, Any]:
        (result,) = [event async for event in robot.stream({"input": given, "name": "so101", "toolUseId": "u"}, {})]
        return result

    return asyncio.run(use())


def moves(**targets: float) -> tuple[str, dict[str, Any]]:
    return "so101", {"action": "move_to", "targets": targets}


# -- it is a tool

STRANDS_FIRST = """
import strands
from strands_actors import Robot
robot = Robot("so101", mode="real", port="/dev/nowhere")
"""
STRANDS_LAST = """
from strands_actors import Robot
robot = Robot("so101", mode="real", port="/dev/nowhere")
assert not isinstance(robot, str)
import strands
"""
KEPT = """
from tests.agents.scripted import Scripted
agent = strands.Agent(model=Scripted(), tools=[robot])
assert agent.tool_names == ["so101"], agent.tool_names
"""
WITHOUT = """
import sys
sys.modules["strands"] = None
from strands_actors import Robot
robot = Robot("so101", mode="real", port="/dev/nowhere")
assert not isinstance(robot, dict)
assert robot.tool_spec["name"] == robot.tool_name == "so101"
heavy = {"pydantic", "boto3", "mcp", "numpy", "mujoco"} & set(sys.modules)
assert not heavy, heavy
"""


@pytest.mark.parametrize("script", [STRANDS_FIRST + KEPT, STRANDS_LAST + KEPT, WITHOUT])
def test_an_agent_keeps_the_robot_in_either_order_of_imports(script: str) -> None:
    subprocess.run([sys.executable, "-W", "ignore", "-c", script], check=True)


def test_the_tool_has_every_attribute_that_an_agent_reads(new_arm: NewArm) -> None:
    robot = new_arm(port="/dev/nowhere", tool_name="left")
    assert agent(Scripted(), robot).tool_names == ["left"]
    assert (robot.tool_type, robot.supports_hot_reload, robot.is_dynamic) == ("robot", False, False)
    assert robot.get_display_properties() == {"Name": "left", "Type": "robot", "Robot": "so101"}
    other = Robot("so101", mode="real", port="/dev/nowhere")
    robot.mark_dynamic()
    assert (robot.is_dynamic, other.is_dynamic) == (True, False)
    assert type(robot) is robot.__class__ is RealRobot


# -- the whole loop


def test_a_refusal_reaches_the_model_as_a_typed_result_and_the_next_call_moves(arm: RealRobot, twin: Twin) -> None:
    model = Scripted([moves(shoulder_pan=400.0)], [moves(shoulder_pan=10.0)], "done")
    (refused,), (moved,) = told(model, arm)

    assert (refused["toolUseId"], refused["status"]) == ("use-0", "error")
    text, details = refused["content"]
    assert text == {"text": "move_to: shoulder_pan 400.0 deg is past 110.1. Stay within -110.0..110.1"}
    assert details["json"]["refused"] == {
        "verb": "move_to",
        "code": "past_travel",
        "reason": "shoulder_pan 400.0 deg is past 110.1",
        "remedy": "stay within -110.0..110.1",
        "offered": "400.0",
        "limit": "-110.0..110.1",
    }

    assert (moved["toolUseId"], moved["status"]) == ("use-1", "success")
    assert moved["content"][0]["json"]["commanded"] == {"shoulder_pan": 10.0}
    until(lambda: goals(twin.log.host("setpoint")[-1])[1] == 2161, "its last setpoint is on the wire")
    at(arm, "shoulder_pan", 10.0)
    assert model.offered[0]["name"] == "so101"


def test_every_verb_of_the_arm(arm: RealRobot, twin: Twin, monkeypatch: pytest.MonkeyPatch) -> None:
    assert call(arm, {"action": "status"})["content"][0]["json"]["state"] == "armed"
    sensors = json_of(call(arm, {"action": "sensors"}))
    assert list(sensors["positions"]) == list(arm.get_observation())
    assert sensors["sensors"]
    assert 0 <= sensors["age_s"] < 1.0

    assert json_of(call(arm, {"action": "set_torque", "enabled": False}))["unconfirmed"] == []
    assert set(torque_now(twin.log).values()) == {0}
    refused = why(call(arm, moves(gripper=40.0)[1]))
    assert refused.startswith("move_to: the robot is disarmed"), refused
    assert refused.endswith("set_torque with enabled=true energises it, which an operator has to approve"), refused
    monkeypatch.setenv(ALLOW, "set_torque")
    assert json_of(call(arm, {"action": "set_torque", "enabled": True}))["armed"] is True
    json_of(call(arm, moves(gripper=40.0)[1]))
    assert json_of(call(arm, {"action": "stop", "targets": "at once"}))["safe_state"] == "limp"
    assert state(arm) == "disarmed"


def test_an_undeclared_input_is_never_written(arm: RealRobot, twin: Twin) -> None:
    for given, text in (
        ({"action": "dance"}, "'dance' is not a verb of so101. Use status, sensors, get_pose, move_to"),
        ({"action": "send_action", "shoulder_pan": 5.0}, "is not a verb"),
        ({"targets": {"gripper": 5.0}}, "no action is given"),
        ([], "Give an object"),
        ({"action": "move_to", "shoulder_pan": 5.0}, "there is no input 'shoulder_pan'. Use targets, seconds"),
        ({"action": "move_to", "targets": [5.0]}, "targets is [5.0]. Give targets as object"),
        ({"action": "move_to"}, "targets is missing"),
        ({"action": "move_to", "targets": {"elbow": 5.0}}, "elbow is not a joint of so101"),
        ({"action": "move_to", "targets": {"gripper": "wide"}}, "gripper is wide"),
        ({"action": "move_to", "targets": {}}, "names no joint"),
        ({"action": "set_torque", "enabled": "no"}, "enabled is 'no'. Give enabled as boolean"),
    ):
        answer = call(arm, given)
        assert text in why(answer), answer
        assert answer["content"][1]["json"]["refused"]["code"], answer
    assert not twin.log.host("setpoint")
    assert state(arm) == "armed"


def test_saf_014_an_agent_does_not_energise_a_stopped_robot_without_an_operator(
    arm: RealRobot, twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is named in ``guarded=`` here. The operator's own ``resume()`` needs no approval."""
    monkeypatch.delenv(ALLOW, raising=False)
    json_of(arm.stop())
    stopped_ns = time.monotonic_ns()
    refused = call(arm, {"action": "set_torque", "enabled": True})
    assert why(refused).startswith("set_torque: set_torque needs an operator's approval: no operator can be asked")
    assert refused["content"][1]["json"]["refused"]["code"] == "not_approved"
    assert state(arm) == "disarmed" and not twin.log.host("enable", stopped_ns)
    json_of(arm.resume())
    json_of(call(arm, {"action": "set_torque", "enabled": False}))  # a stop needs no approval


def test_an_agent_does_not_lift_an_operators_lockout(
    arm: RealRobot, twin: Twin, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not even if the operator allows the agent to energise the arm."""
    monkeypatch.setenv(ALLOW, "set_torque")
    from strands_actors.caller.session.portal import portal
    from strands_actors.contract.driver import Reason

    portal().call(arm._tree.stop, Reason.ESTOP, True)  # type: ignore[union-attr]
    locked_ns = time.monotonic_ns()
    refusal = call(arm, {"action": "set_torque", "enabled": True})
    assert "e-stopped by so101" in why(refusal)
    assert "Ask a person to lift the e-stop" in why(refusal)
    refused = why(call(arm, moves(gripper=40.0)[1]))
    assert "e-stopped" in refused and "Ask a person to lift the e-stop" in refused
    assert not twin.log.host("enable", locked_ns)
    json_of(arm.resume())
    json_of(call(arm, moves(gripper=40.0)[1]))


def test_a_call_of_an_unconnected_robot_is_refused(new_arm: NewArm) -> None:
    robot = new_arm(port="/dev/nowhere")
    assert json_of(call(robot, {"action": "status"}))["connected"] is False
    for action in ({"action": "sensors"}, {"action": "stop"}, moves(gripper=1.0)[1]):
        assert "Call connect_eagerly() first" in why(call(robot, action))
    robot.cleanup()
    assert "cleaned up. Make a new one" in why(call(robot, {"action": "stop"}))


# -- calls do not wait for each other


def test_saf_006_a_stop_is_answered_while_a_policy_spins(arm: RealRobot, twin: Twin) -> None:
    ended = threading.Event()

    def spin(observation: Any) -> dict[str, float]:
        if task(arm)["steps"] > 5:
            while not ended.is_set():
                pass
        return {"shoulder_pan": observation["shoulder_pan"] + 0.5}

    took_s = []
    for _ in range(3):
        ended.clear()
        json_of(arm.run_policy(spin, control_frequency=50))
        until(lambda: status(arm)["writes"] > 5, "it moves")
        time.sleep(0.05)
        began_ns = time.monotonic_ns()
        json_of(call(arm, {"action": "stop"}))
        took_s.append((time.monotonic_ns() - began_ns) / 1e9)
        ended.set()
        assert limps(twin.log, began_ns)
        assert twin.log.setpoints_after_safe(began_ns) == 0
        json_of(arm.resume())
    print("stop answered in", [f"{seconds * 1e3:.1f} ms" for seconds in took_s])
    assert min(took_s) < 0.1
    assert max(took_s) < 1.0


def test_two_tools_called_at_once_overlap(twin: Twin, new_arm: NewArm) -> None:
    """The move waits for an approval, which the other tool gives."""
    released = threading.Event()

    @tool
    def release() -> str:
        """Approve the move."""
        released.set()
        return "released"

    def approve(request: Request) -> bool:
        return released.wait(20.0)

    arm = new_arm(port=twin.port, guarded=("move_to",), approve=approve)
    assert arm.connect_eagerly() is None
    model = Scripted([moves(gripper=30.0), ("release", {})], "done")
    ((moved, other),) = told(model, arm, release)
    assert {moved["status"], other["status"]} == {"success"}


def test_a_call_that_is_cancelled_moves_nothing_later(twin: Twin, new_arm: NewArm) -> None:
    was_requested, answer = threading.Event(), threading.Event()

    def approve(request: Request) -> bool:
        was_requested.set()
        return answer.wait(20.0)

    arm = new_arm(port=twin.port, guarded=("move_to",), approve=approve)
    assert arm.connect_eagerly() is None

    async def give_up() -> None:
        use = asyncio.ensure_future(anext(arm.stream({"input": moves(gripper=30.0)[1]}, {})))
        await asyncio.to_thread(was_requested.wait, 20.0)
        use.cancel()
        with pytest.raises(asyncio.CancelledError):
            await use

    asyncio.run(give_up())
    answer.set()
    json_of(arm.send_action({"shoulder_pan": arm.get_observation()["shoulder_pan"]}))
    written = until(lambda: twin.log.host("setpoint"), "the next command is written")
    resting = armed_at(twin.log)
    assert {goals(entry)[6] for entry in written} == {resting[6]}


# -- the operator


def test_a_guarded_call_runs_when_the_operator_agrees(
    twin: Twin, new_arm: NewArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    requests: list[Request] = []
    answers = iter((False, True))

    def approve(request: Request) -> bool:
        requests.append(request)
        return next(answers)

    arm = new_arm(port=twin.port, guarded=("move_to", "set_torque"), approve=approve)
    assert arm.connect_eagerly() is None
    script: list[Turn] = [[moves(gripper=30.0)]] * 2
    (refused,), (moved,) = told(Scripted(*script, "done"), arm)
    assert why(refused).startswith("move_to: move_to needs an operator's approval: it was not given")
    assert refused["content"][1]["json"]["refused"]["code"] == "not_approved"
    json_of(moved)
    assert [str(request) for request in requests] == ["agent asks so101: move_to targets={'gripper': 30.0}"] * 2

    json_of(call(arm, {"action": "set_torque", "enabled": False}))  # a stop needs no approval
    json_of(call(arm, {"action": "stop"}))
    json_of(call(arm, {"action": "sensors"}))
    assert len(requests) == 2
    monkeypatch.setenv(ALLOW, "land, set_torque")
    json_of(call(arm, {"action": "set_torque", "enabled": True}))
    json_of(arm.send_action({"gripper": 40.0}))  # a call by the robot's own program needs no approval
    assert len(requests) == 2
