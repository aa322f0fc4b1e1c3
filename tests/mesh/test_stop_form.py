"""A stop is never refused, neither because of its form nor because of another name in it."""

from __future__ import annotations

import json
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from strands_actors.kernel.channels.pubsub import Received
from strands_actors.supervisors.mesh import schemas as mesh_json
from strands_actors.supervisors.mesh.stop_rules import MessageOutline, read_loosely

from .world import Samples, mesh, raw, robot_on_mesh, run, until

NAMED = {"sender_id": "dash", "turn_id": "1"}
FORMS: list[tuple[Any, bool, str]] = [
    ({**NAMED, "command": {"action": "stop", "reason": "collision"}}, False, "dash"),
    ({**NAMED, "command": {"action": "stop", "by": None}}, False, "dash"),
    ({**NAMED, "command": {"action": " STOP ", "by": {"name": "me"}}}, False, "dash"),
    ({"sender_id": "dash", "command": {"action": "stop"}}, False, "dash"),
    ({**NAMED, "turn_id": 7, "command": {"action": "stop"}}, False, "dash"),
    ({**NAMED, "command": {"action": "estop"}}, True, "dash"),
    ({**NAMED, "command": {"action": "EStop", "reason": "collision", "by": "me"}}, True, "dash"),
    ({**NAMED, "command": "stop"}, False, "dash"),
    ({**NAMED, "target_id": None, "action": "stop"}, False, "dash"),
    ({"command": {"action": "estop"}}, True, ""),
    ({**NAMED, "command": {"action": ["stop"]}}, False, "dash"),
    ({**NAMED, "command": {"name": "halt"}}, False, "dash"),
    ({**NAMED, "command": {"stop": True}}, False, "dash"),
    ({"input": "please stop"}, False, ""),
    (["e-stop"], True, ""),
    ("emergency stop", True, ""),
    ({"op": "emergency_stop"}, True, ""),
    ({"emergencyStop": True}, True, ""),
    ("estop_all", True, ""),
    ({**NAMED, "padding": "x" * 20_000, "command": {"action": "stop"}}, False, "dash"),
]


@pytest.mark.parametrize(("body", "locks", "receiver"), FORMS, ids=lambda value: str(value)[:60])
@pytest.mark.parametrize("key", [mesh_json.BROADCAST_KEY, "cmd"])
def test_saf_006_a_stop_in_any_form_is_obeyed(key: str, body: Any, locks: bool, receiver: str) -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            answers = Samples(client, f"strands/dash/response/{robot}/*")
            await raw(client, robot, json.dumps(body).encode(), key)
            status = await tree.until("disarmed")
            assert bool(status.locked_by) is locks
            if receiver:
                answer = (await answers.wait())[-1]
                named = body.get("turn_id") == "1"
                assert (answer["result"]["locked"], answer["turn_id"]) == (locks, "1" if named else "")

    run(test)


def test_a_broadcast_for_another_robot_stops_that_one_alone() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (_, tree, _), robot_on_mesh() as (robot, other, _), mesh() as client:
            body = {"sender_id": "dash", "target_id": robot, "command": {"action": "stop", "reason": "x"}}
            for via in client.sessions.all:
                via.put(mesh_json.BROADCAST_KEY, json.dumps(body).encode(), "x")
            await other.until("disarmed")
            assert (await tree.status()).mode == "armed"

    run(test)


def test_saf_006_any_sender_on_a_robots_key_stops_that_robot_and_moves_no_other() -> None:
    async def test() -> None:
        async with robot_on_mesh() as (robot, tree, _), mesh() as client:
            await until(lambda: client.is_there(robot), "it is there")
            via, answers = client.sessions.via[robot], list[Received]()
            body = {**NAMED, "target_id": "so100_left"}
            for action in ("ping", "estop"):
                ask = json.dumps({**body, "command": {"action": action}}).encode()
                via.ask(mesh_json.command_key(robot, "me"), ask, "x", answers.append)
                await until(lambda action=action: len(answers) > (action == "estop"), "it is answered")  # type: ignore[misc]
            refused, stopped = (msgspec.json.decode(answer.payload) for answer in answers[:2])
            assert refused["refused"]["code"] == "target" and "so100_left" in refused["error"]
            assert stopped["result"]["locked"] is True
            assert (await tree.status()).locked_by == "me"

    run(test)


@given(st.binary(max_size=200) | st.text().map(str.encode))
def test_no_bytes_raise(payload: bytes) -> None:
    read_loosely(payload)
    read_loosely(b'{"command": ' + payload + b"}")


@pytest.mark.parametrize("payload", [b"", b"null", b"[]", b"[" * 5000, b'{"command": {"action": ["stopped"]}}'])
def test_a_message_without_an_action_is_not_a_stop(payload: bytes) -> None:
    assert read_loosely(payload) == MessageOutline()


@pytest.mark.parametrize("action", sorted(mesh_json.ACTIONS.keys() - {"stop", "estop"}))
def test_no_other_command_is_a_stop(action: str) -> None:
    body = {"sender_id": "stop", "turn_id": "stop", "by": "stop", "command": {"action": action, "text": "stop"}}
    assert read_loosely(json.dumps(body).encode()).action == action


def test_saf_006_a_robots_own_name_changes_nothing_of_a_stop() -> None:
    assert read_loosely(b"stop left_arm_2", "left_arm_2").stops
    assert not read_loosely(b"stop left_arm_2", "gantry").stops


@pytest.mark.parametrize("action", ["stop_task", "stop_recording", "unstoppable", "do not stop"])
def test_a_longer_action_name_is_not_a_stop(action: str) -> None:
    assert not read_loosely(json.dumps({**NAMED, "command": {"action": action}}).encode()).stops


def test_a_mistake_in_one_field_does_not_spoil_another() -> None:
    outline = read_loosely(b'{"sender_id": "a/b", "turn_id": "1", "command": {"action": "stop", "by": "\xff"}}')
    assert outline == MessageOutline(turn="1", action="stop")
    assert len(read_loosely(json.dumps({"command": {"action": "stop", "by": "x" * 999}}).encode()).by) == 256
