"""Lines on an MCP server's standard input that no client of the SDK sends."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from strands_actors.surfaces.agents.mcp_lines import INVALID_REQUEST, PARSE_ERROR, understood
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
    ],
    ids=["words", "half", "nested", "a number", "another protocol", "an odd number"],
)
def test_what_is_no_message_is_refused(line: str, code: int, number: int | None) -> None:
    refusal = understood(line)
    assert not isinstance(refusal, str)
    assert (refusal.error.code, refusal.id) == (code, number)


@pytest.mark.parametrize("line", [call({"action": "status"}), call(None), '{"jsonrpc": "2.0", "method": "x"}'])
def test_what_is_one_is_left_as_it_is(line: str) -> None:
    assert understood(line) == line


@pytest.mark.parametrize("arguments", ["stop", '{"action": "stop"}', ["stop"]])
def test_saf_006_arguments_in_another_form_reach_the_tool(arguments: Any) -> None:
    found = understood(call(arguments))
    assert isinstance(found, str)
    assert json.loads(found)["params"]["arguments"] == {"input": arguments}


def test_saf_006_a_stop_as_text_stops_and_each_line_is_answered(twin: Twin, run_dir: Path) -> None:
    greeting = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}
    lines = [
        json.dumps({"jsonrpc": "2.0", "id": 1, "method": "initialize", "params": greeting}),
        json.dumps({"jsonrpc": "2.0", "method": "notifications/initialized"}),
        "hello",
        call({"action": "move_to", "targets": {"shoulder_pan": 5.0}}, 2),
        call('{"action": "stop"}', 3),
    ]
    with subprocess.Popen(
        [sys.executable, "-c", MAIN, "mcp", "so101", "--port", twin.port, "--allow-motion"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "STRANDS_ACTORS_RUN": str(run_dir)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as server:
        assert server.stdin is not None and server.stdout is not None
        answers: dict[Any, dict[str, Any]] = {}
        for line, number in zip(lines, (1, 0, None, 2, 3), strict=True):
            server.stdin.write(line + "\n")
            server.stdin.flush()
            while number != 0 and number not in answers:
                answer = json.loads(server.stdout.readline())
                answers[answer["id"]] = answer
        server.stdin.close()
        assert server.wait(20.0) == 0
    assert answers[None]["error"]["code"] == PARSE_ERROR
    told = answers[3]["result"]["structuredContent"]
    assert told["content"][0]["json"]["safe_state"] == "limp", told
    assert limps(twin.log)
