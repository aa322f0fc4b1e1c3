"""A browser sets up robots through ``strands-actors web``: ports, calibration of a twin, ids, a drill, trees."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection

from strands_actors.testing import Twin
from tests.answers import until
from tests.calibration.hands import JOINTS, registers_of
from tests.cli.command import Command

from .browser import PATIENCE_S, Visitor
from .serving import console_of

TO_RAD, SWEPT_DEGREES = 0.6, 20.0
"""Where the hand moves each joint, and after which way it is enough."""


@pytest.fixture
def visitor(tmp_path: Path, cli: Command) -> Iterator[Visitor]:
    cli.environment["HF_LEROBOT_CALIBRATION"] = str(tmp_path / "lerobot")
    with console_of(cli) as facts, Visitor(facts["url"]) as visitor:
        yield visitor


def messages(socket: ClientConnection) -> Iterator[dict[str, Any]]:
    try:
        while True:
            yield json.loads(socket.recv(timeout=2 * PATIENCE_S))
    except ConnectionClosed:
        return


def result_of(socket: ClientConnection) -> dict[str, Any]:
    """Read until the end, and return the message without a type."""
    (result,) = (message for message in messages(socket) if "type" not in message)
    return result


def move_through(socket: ClientConnection, twin: Twin) -> dict[str, Any]:
    """Move each joint that is asked for by hand, and return the message after the last one."""
    number = at = 0
    for message in messages(socket):
        assert "type" in message, message
        match message["type"]:
            case "ready":
                number, at = message["number"], 0
            case "moved" if number and at == 0:
                twin.move_by_hand(**{message["joint"]: TO_RAD})
                at = 1
            case "moved" if number and message["degrees"][message["joint"]] > SWEPT_DEGREES:
                # An answer to the question before this one counts for nothing.
                for each in (number - 1, number):
                    socket.send(json.dumps({"number": each}))
                number = 0
            case "moved":
                pass
            case _:
                return message
    raise AssertionError("the command ended")


def test_a_page_calibrates_an_arm_and_puts_the_old_values_back(
    visitor: Visitor, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Twin("so101", tmp_path, by_hand=True) as twin:
        before = registers_of("so101", twin)
        order = {"robot": "so101", "port": twin.port, "id": "left"}
        with visitor.command(type="calibrate", accept=JOINTS, **order) as socket:
            proposal = move_through(socket, twin)
            assert [joint["joint"] for joint in proposal["joints"]] == list(JOINTS)
            assert proposal["type"] == "confirm" and proposal["joints"][0]["swept"] > SWEPT_DEGREES
            with visitor.command(type="calibrate", **order) as other:
                assert "from another page" in result_of(other)["error"]
            socket.send(json.dumps({"number": proposal["number"], "text": "yes"}))
            file = Path(result_of(socket)["file"])
        assert file.is_relative_to(tmp_path) and list(json.loads(file.read_text())) == list(JOINTS)
        assert registers_of("so101", twin) != before
        with visitor.command(type="calibrate", undo=True, **order) as socket:
            assert result_of(socket)["robot"] == "so101"
        assert registers_of("so101", twin) == before and not file.exists()


def test_a_page_that_closes_ends_its_command_and_nothing_is_written(
    visitor: Visitor, cli: Command, tmp_path: Path
) -> None:
    with Twin("so101", tmp_path, by_hand=True) as twin:
        before, alone = registers_of("so101", twin), set(cli.processes())
        with visitor.command(type="calibrate", robot="so101", port=twin.port) as socket:
            assert next(messages(socket))["type"] == "ready"
        until(lambda: set(cli.processes()) <= alone, "the command ends")
        assert registers_of("so101", twin) == before, "the port is free, and the values are the old ones"


@pytest.mark.parametrize(
    ("order", "problem"),
    [
        ({"type": "calibrate", "robot": "so11", "port": "/dev/null"}, "so101?"),
        ({"type": "calibrate", "robot": "--undo", "port": "/dev/null"}, "'--undo' is not known"),
        ({"type": "setup-motors", "robot": "so101", "port": "/dev/null", "joints": ["knee"]}, "has no knee"),
    ],
)
def test_what_a_command_refuses_is_shown(shared_visitor: Visitor, order: dict[str, Any], problem: str) -> None:
    with shared_visitor.command(**order) as socket:
        assert problem in result_of(socket)["error"]


def test_a_drill_asks_for_consent(shared_visitor: Visitor) -> None:
    with shared_visitor.command(type="drill", robot="so101", port="/nowhere") as socket:
        asked = next(messages(socket))
        assert asked["type"] == "consent" and "hands off" in asked["text"]
        socket.send(json.dumps({"number": asked["number"], "text": "so10"}))
        assert "you did not consent, so nothing was done" in result_of(socket)["error"]


@pytest.mark.long
def test_a_page_drills_a_simulated_arm(shared_visitor: Visitor) -> None:
    with shared_visitor.command(type="drill", robot="so101") as socket:
        seen = list(messages(socket))
    steps = [message["result"]["step"] for message in seen if message.get("type") == "step"]
    assert steps[:2] == ["stop", "policy kill"]
    (result,) = (message for message in seen if "type" not in message)
    assert result["robot"] == "so101" and len(result["figures"]) == len(steps)


@pytest.mark.long
def test_new_servos_get_their_ids(visitor: Visitor, tmp_path: Path) -> None:
    with Twin("so101", tmp_path) as twin:
        others = [f"off:{number}" for number in range(1, 6)]
        for fault in others:
            twin.fault(fault)
        with visitor.command(type="setup-motors", robot="so101", port=twin.port, joints=["gripper"]) as socket:
            for message in messages(socket):
                if message.get("type") == "ready":
                    assert "connect the servo of gripper" in message["text"]
                    socket.send(json.dumps({"number": message["number"]}))
                if "type" not in message:
                    assert message == {"robot": "so101", "servos": [{"joint": "gripper", "was": 6, "id": 6}]}
                    return
    raise AssertionError("no result")


def test_ports_kinds_and_the_state_of_this_computer(shared_visitor: Visitor) -> None:
    http = shared_visitor.http
    assert all(port["port"].startswith("/dev/") for port in http.get("/setup/ports").json()["ports"])
    kinds = {kind["name"]: kind for kind in http.get("/setup/kinds").json()["kinds"]}
    assert kinds["so101"] == {"name": "so101", "joints": list(JOINTS), "drills": True}
    assert kinds["koch_leader"]["joints"] and not kinds["koch_leader"]["drills"] and not kinds["ur5e"]["joints"]
    checks = shared_visitor.order("/setup/doctor")["checks"]
    assert {"python", "zenoh", "serial"} <= {check["name"] for check in checks}
