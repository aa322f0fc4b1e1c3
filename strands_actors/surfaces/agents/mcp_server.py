"""Serve a robot's tool over MCP, on standard input and output. The server and the robot's handle run in one
trio loop."""

from __future__ import annotations

import json
from typing import Any

import trio
from mcp import types
from mcp.server import Server
from mcp.server.context import ServerRequestContext
from mcp.server.stdio import stdio_server

from strands_actors.caller.handle.async_robot import AsyncRobot
from strands_actors.caller.handle.envelopes import Answer
from strands_actors.version import __version__

from .mcp_lines import STOP, Lines

ALLOW_MOTION = "start the server with --allow-motion"


async def serve(robot: AsyncRobot, allow_motion: bool) -> None:
    """Serve until the client closes standard input.

    Args:
        robot: The robot.
        allow_motion: False refuses every motion. The refusal names the option that allows motion.
    """
    motion = "" if allow_motion else ALLOW_MOTION

    async def list_tools(context: ServerRequestContext[Any], params: Any) -> types.ListToolsResult:
        spec = robot.tool_spec
        tool = types.Tool(
            name=spec["name"], description=spec["description"], input_schema=spec["inputSchema"]["json"]
        )
        return types.ListToolsResult(tools=[tool])

    async def call_tool(
        context: ServerRequestContext[Any], params: types.CallToolRequestParams
    ) -> types.CallToolResult:
        if params.name != robot.tool_name:
            text = f"there is no tool {params.name!r}. The tool is {robot.tool_name}"
            return types.CallToolResult(content=[types.TextContent(type="text", text=text)], is_error=True)
        return _result(await robot.use_tool(params.arguments or {}, "mcp", motion))

    server = Server(
        "strands-actors",
        version=__version__,
        instructions=f"A robot. {'' if allow_motion else 'Motion is refused: the server was started without it.'}",
        on_list_tools=list_tools,
        on_call_tool=call_tool,
    )

    async def stop() -> types.CallToolResult:
        return _result(await robot.use_tool(STOP, "mcp"))

    lines = Lines(robot.tool_name, stop)
    async with (
        stdio_server(stdin=lines) as (incoming, outgoing),  # type: ignore[arg-type]
        trio.open_nursery() as nursery,
    ):
        nursery.start_soon(lines.answer, outgoing)
        await server.run(incoming, outgoing, server.create_initialization_options())
        nursery.cancel_scope.cancel()


def _result(answer: Answer) -> types.CallToolResult:
    """Convert a robot's answer to an MCP result, with the answer as text for models and as structured content
    for programs."""
    blocks = [block["text"] if "text" in block else json.dumps(block["json"]) for block in answer["content"]]
    return types.CallToolResult(
        content=[types.TextContent(type="text", text=text) for text in blocks],
        structured_content=dict(answer),
        is_error=answer["status"] != "success",
    )
