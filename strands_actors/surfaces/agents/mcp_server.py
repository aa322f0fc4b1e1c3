"""Serve the tool of a robot, or of all robots of the mesh, over MCP, on standard input and output. The server and
the tool run in one trio loop."""

from __future__ import annotations

import json
from typing import Any, Protocol

import trio
from mcp import types
from mcp.server import Server
from mcp.server.context import ServerRequestContext
from mcp.server.stdio import stdio_server

from strands_actors.caller.handle.envelopes import Answer
from strands_actors.version import __version__

from .mcp_lines import STOP, Lines

ALLOW_MOTION = "start the server with --allow-motion"


class Served(Protocol):
    """A tool that can be served: an ``AsyncRobot``, or the tool of all robots."""

    @property
    def tool_name(self) -> str: ...

    @property
    def tool_spec(self) -> dict[str, Any]: ...

    async def use_tool(self, tool_input: object, by: str, motion: str = "") -> Answer: ...


async def serve(served: Served, allow_motion: bool, about: str = "A robot.") -> None:
    """Serve until the client closes standard input.

    Args:
        served: The tool.
        about: What the tool stands for, for the model.
        allow_motion: False refuses every motion. The refusal names the option that allows motion.
    """
    motion = "" if allow_motion else ALLOW_MOTION

    async def list_tools(context: ServerRequestContext[Any], params: Any) -> types.ListToolsResult:
        spec = served.tool_spec
        tool = types.Tool(
            name=spec["name"], description=spec["description"], input_schema=spec["inputSchema"]["json"]
        )
        return types.ListToolsResult(tools=[tool])

    async def call_tool(
        context: ServerRequestContext[Any], params: types.CallToolRequestParams
    ) -> types.CallToolResult:
        if params.name != served.tool_name:
            text = f"there is no tool {params.name!r}. The tool is {served.tool_name}"
            return types.CallToolResult(content=[types.TextContent(type="text", text=text)], is_error=True)
        return _result(await served.use_tool(params.arguments or {}, "mcp", motion))

    server = Server(
        "strands-actors",
        version=__version__,
        instructions=f"{about} {'' if allow_motion else 'Motion is refused: the server was started without it.'}",
        on_list_tools=list_tools,
        on_call_tool=call_tool,
    )

    async def stop() -> types.CallToolResult:
        return _result(await served.use_tool(STOP, "mcp"))

    lines = Lines(served.tool_name, stop)
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
