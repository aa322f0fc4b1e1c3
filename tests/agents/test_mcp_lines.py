"""Send an MCP server lines that no client of the SDK would send."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from strands_actors.surfaces.agents.mcp_lines import INVALID_REQUEST, PARSE_ERROR, Stop, understood
from strands_actors.testing import Twin
from tests.cli.command import MAIN, ROOT
from tests.robot.helpers import limps


def call(arguments: Any, number: int = 7) -> str:
    params = {"name": "so101", "arguments": arguments}
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": "tools/call", "params": params})


@pytest.mark.parametrize(
    ("line", "code", "number"),
    [
        ("hello\n", PARSE_ERROR, None),
        ('{"jsonrpc": "2.0", "id": 3\n', PARSE_ERROR, None),
        ("[" * 100_000, PARSE_ERROR, None),
        ("3\n", INVALID_REQUEST, None),
        ('{"id": 3, "method": "ping"}\n', INVALID_REQUEST, 3),
        ('{"id": [3], "method": "ping"}\n', INVALID_REQUEST, None),
        ('{"jsonrpc": "2.0", "id": 1.5, "method": "ping"}', INVALID_REQUEST, None),
        ('{"jsonrpc": "2.0", "id": null, "method": "ping"}', INVALID_REQUEST, None),
        ('{"jsonrpc": "2.0", "id": 3}', INVALID_REQUEST, 3),
        ('{"jsonrpc": "2.0", "id": 3, "method": "tools/call", "params": "status"}', INVALID_REQUEST, 3),
        ('{"jsonrpc": "2.0", "id": 3, "method": "ping", "params": {"x": "\\ud800"}}', INVALID_REQUEST, 3),
        ("\ufffd\ufffd", PARSE_ERROR, None),
    ],
    ids=lambda value: str(value)[:30],
)
def test_an_invalid_message_is_refused(line: str, code: int, number: int | None) -> None:
    refusal = understood(line, "so101")
    assert not isinstance(refusal, str | Stop)
    assert (refusal.error.code, refusal.id) == (code, number)


@pytest.mark.parametrize("line", [call({"action": "status"}), call(None), '{"jsonrpc": "2.0", "method": "x"}'])
def test_a_valid_message_is_not_changed(line: str) -> None:
    assert understood(line, "so101") == line


STOP = {"action": "stop", "why": "a hand"}
STOPS: list[tuple[Any, Any]] = [
    ([json.loads(call(STOP))], 7),
    ({"id": 7, "method": "tools/call", "params": {"name": "so101", "arguments": STOP}}, 7),
    ({"jsonrpc": "2.0", "method": "tools/call", "params": {"name": "so101", "arguments": STOP}}, None),
    ({"jsonrpc": "2.0", "id": 1.5, "method": "tools/call", "params": {"arguments": STOP}}, None),
    ({"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": "so101", **STOP, "_meta": 5}}, 7),
    ({"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": ["so101", STOP]}, 7),
    ({"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": "so101_stop", "arguments": {}}}, 7),
    ({"jsonrpc": "2.0", "id": 7, "method": "Tools/Call", "params": {"name": "stop"}}, 7),
    ({"jsonrpc": "2.0", "id": 7, "method": "stop"}, 7),
    ({"action": "stop", "speed": float("nan")}, None),
    ("stop", None),
]


@pytest.mark.parametrize(("message", "number"), STOPS, ids=lambda value: str(value)[:60])
def test_saf_006_a_stop_in_another_message_than_a_call_is_a_stop(message: Any, number: Any) -> None:
    for line in (json.dumps(message), "\ufeff" + json.dumps(message)):
        assert understood(line, "so101") == Stop(number)


@pytest.mark.parametrize("line", ["stop\n", "Stop the robot!\n", '{"action": "stop", "why": "a hand'])
def test_saf_006_a_stop_in_plain_text_is_a_stop(line: str) -> None:
    assert understood(line, "so101") == Stop(None)


@pytest.mark.parametrize(
    "body",
    [
        {"jsonrpc": "2.0", "id": 7, "method": "prompts/get", "params": {"name": "stop"}},
        {"jsonrpc": "2.0", "id": "stop", "method": "ping"},
        {"jsonrpc": "2.0", "method": "notifications/cancelled", "params": {"requestId": 7, "reason": "stop"}},
        json.loads(call({"action": "say", "text": "stop"})),
        {"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": "so100", "arguments": STOP}},
    ],
)
def test_another_request_is_not_a_stop(body: Any) -> None:
    assert json.loads(str(understood(json.dumps(body), "so101"))) == body


FORMS: list[dict[str, Any]] = [
    {"input": {"action": "stop"}},
    {"action": "move_to"},
    {"arguments": ["stop"]},
    {"arguments": '{"action": "stop"}'},
]


@pytest.mark.parametrize("params", FORMS)
def test_saf_006_arguments_in_another_form_reach_the_tool(params: Any) -> None:
    request = {"jsonrpc": "2.0", "id": 7, "method": "tools/call", "params": {"name": "so101", **params}}
    found = json.loads(str(understood(json.dumps(request), "so101")))
    assert found["params"]["arguments"] == {"input": params.get("arguments", params)}


def test_saf_006_a_stop_as_text_stops_and_each_line_is_answered(twin: Twin, run_dir: Path) -> None:
    greeting = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}
    lines = [
        json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": greeting}),
        json.dumps({"jsonrpc": "2.0", "method": "notifications/initialized"}),
        "hello \udcff",
        call({"action": "move_to", "targets": {"shoulder_pan": 5.0}}, 2),
        call('{"action": "stop"}', 3),
        '{"jsonrpc": "2.0", "id": 4, "method": "stop"}',
    ]
    with subprocess.Popen(
        [sys.executable, "-c", MAIN, "mcp", "so101", "--port", twin.port, "--allow-motion"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "STRANDS_ACTORS_RUN": str(run_dir)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        errors="surrogateescape",
    ) as server:
        assert server.stdin is not None and server.stdout is not None
        answers: dict[Any, dict[str, Any]] = {}
        for line, number in zip(lines, (1, 0, None, 2, 3, 4), strict=True):
            server.stdin.write(line + "\n")
            server.stdin.flush()
            while number != 0 and number not in answers:
                answer = json.loads(server.stdout.readline())
                answers[answer["id"]] = answer
        server.stdin.close()
        assert server.wait(20.0) == 0
    assert answers[None]["error"]["code"] == PARSE_ERROR
    for number in (3, 4):
        reply = answers[number]["result"]["structuredContent"]
        assert reply["content"][0]["json"]["safe_state"] == "lowered", reply
    assert limps(twin.log)
