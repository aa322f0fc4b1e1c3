"""``strands-actors mcp``, driven by the official client over its standard input and output."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import trio
from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client

from strands_actors.testing import Twin
from tests.answers import json_of, until, why
from tests.cli.command import MAIN, ROOT
from tests.robot.helpers import goals, limps, torque_now


@contextlib.asynccontextmanager
async def served(run_dir: Path, *arguments: str, robot: str = "so101") -> AsyncIterator[Client]:
    server = StdioServerParameters(
        command=sys.executable,
        args=["-c", MAIN, "mcp", robot, *arguments],
        env={
            "PYTHONPATH": str(ROOT),
            "STRANDS_ACTORS_RUN": str(run_dir),
            "STRANDS_ACTORS_DATA": str(run_dir / "data"),
        },
    )
    async with Client(stdio_client(server)) as client:
        yield client


async def use(client: Client, **given: Any) -> dict[str, Any]:
    """Return the envelope. Its status must agree with the error flag of the protocol."""
    result = await client.call_tool("so101", given)
    envelope = result.structured_content
    assert envelope is not None
    assert result.is_error is (envelope["status"] == "error")
    assert len(result.content) == len(envelope["content"])
    return dict(envelope)


async def command(run_dir: Path, *arguments: str) -> tuple[int, str]:
    """Run the command without a client. Return its exit code and its output."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "STRANDS_ACTORS_RUN": str(run_dir)}
    done = await trio.run_process(
        [sys.executable, "-c", MAIN, "mcp", "so101", *arguments], capture_stderr=True, check=False, env=environment
    )
    return done.returncode, done.stderr.decode()


def run(test: Callable[[], Awaitable[None]]) -> None:
    async def bounded() -> None:
        with trio.fail_after(60.0):
            await test()

    trio.run(bounded)


def test_without_allow_motion_nothing_is_energised_and_stop_works(twin: Twin, run_dir: Path) -> None:
    async def main() -> None:
        async with served(run_dir, "--port", twin.port) as client:
            (tool,) = (await client.list_tools()).tools
            assert tool.name == "so101"
            assert tool.input_schema["properties"]["action"]["enum"][0] == "status"

            assert json_of(await use(client, action="status"))["state"] == "disarmed"
            assert "shoulder_pan" in json_of(await use(client, action="sensors"))["positions"]
            refusal = await use(client, action="move_to", targets={"gripper": 30.0})
            assert "this tool does not allow motion. Start the server with --allow-motion" in why(refusal)
            assert refusal["content"][1]["json"]["refused"]["code"] == "no_motion"
            assert "--allow-motion" in why(await use(client, action="set_torque", enabled=True))
            assert "is not a verb" in why(await use(client, action="dance"))
            assert json_of(await use(client, action="stop"))["unconfirmed"] == []
            unknown = await client.call_tool("so100", {"action": "stop"})
            assert unknown.is_error
            assert "The tool is so101" in str(unknown.content)

    run(main)
    assert not twin.log.host("enable")
    assert not twin.log.host("setpoint")


def test_with_allow_motion_it_moves_within_limits_and_is_safe_at_the_end(twin: Twin, run_dir: Path) -> None:
    async def main() -> None:
        async with served(run_dir, "--port", twin.port, "--allow-motion") as client:
            assert "is past 110.1" in why(await use(client, action="move_to", targets={"shoulder_pan": 400.0}))
            moved = json_of(await use(client, action="move_to", targets={"shoulder_pan": 10.0}))
            assert moved["commanded"] == {"shoulder_pan": 10.0}
            assert "so101 in process" in json_of(await use(client, action="status"))["lease"]
            code, output = await command(run_dir, "--port", twin.port)  # a second server for the same robot
            assert (code, output.count("\n")) == (2, 1), output
            assert "in use by" in output
            json_of(await use(client, action="stop"))
            # The server has no terminal on which a person could approve it.
            refusal = await use(client, action="set_torque", enabled=True)
            assert "set_torque needs an operator's approval" in why(refusal)
            assert json_of(await use(client, action="status"))["state"] == "disarmed"

    run(main)
    until(lambda: goals(twin.log.host("setpoint")[-1])[1] == 2161, "it goes there, and no further")
    until(lambda: limps(twin.log), "it is released when the client leaves")
    assert set(torque_now(twin.log).values()) == {0}


@pytest.mark.long
def test_an_interrupt_ends_it_safely(twin: Twin, run_dir: Path) -> None:
    server = subprocess.Popen(
        [sys.executable, "-c", MAIN, "mcp", "so101", "--port", twin.port, "--allow-motion"],
        env={**os.environ, "PYTHONPATH": str(ROOT), "STRANDS_ACTORS_RUN": str(run_dir)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        until(lambda: len(twin.log.host("enable")) >= 6, "it is energised")
        until(lambda: set(torque_now(twin.log).values()) == {1}, "it is armed")
        server.send_signal(signal.SIGINT)
        code = server.wait(20.0)  # its standard input is still open
        _, output = server.communicate()
    finally:
        server.kill()
    assert code == 130
    assert [line for line in output.splitlines() if "is not calibrated" not in line] == []
    assert limps(twin.log)


@pytest.mark.long
def test_a_robot_that_cannot_be_served_is_refused_in_one_line(run_dir: Path) -> None:
    async def main() -> None:
        code, output = await command(run_dir, "--port", "/dev/nowhere")
        assert (code, output.count("\n")) == (2, 1), output
        assert "/dev/nowhere" in output
        code, output = await command(run_dir, "--transport", "pigeon")
        assert (code, output.count("\n")) == (2, 1), output
        assert "It offers twin" in output

    run(main)
