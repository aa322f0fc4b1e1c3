"""Read the standard input of an MCP server, line by line.

A line that is not a JSON-RPC message is answered with a JSON-RPC error. A stop is carried out even if its
line is malformed. A tool's input that is not an object still reaches the tool.
"""

from __future__ import annotations

import json
import sys
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any, NamedTuple

import trio
from mcp.shared.message import SessionMessage
from mcp.types import CallToolResult, ErrorData, JSONRPCError, JSONRPCResponse, jsonrpc_message_adapter

from strands_actors.contract.stop_words import asks_for_stop

PARSE_ERROR, INVALID_REQUEST = -32700, -32600
CALL, STOP = "tools/call", "stop"
OF_A_CALL = ("name", "arguments", "task", "_meta")
"""Parameters of a call in the protocol."""
PENDING = 16
"""Most answers that wait to be written. Beyond that, no line is read until the client reads."""


class Stop(NamedTuple):
    """A stop in a line that the MCP SDK would not accept as a tool call. ``id`` is the request's id."""

    id: str | int | None


class Lines:
    """Iterate over the lines that the MCP server should handle. Answer all other lines here.

    A task that waits for a line can be cancelled, although the thread that reads cannot.

    Args:
        tool: The name of the robot's tool.
        stop: Stops the robot and returns the result.
    """

    def __init__(self, tool: str, stop: Callable[[], Awaitable[CallToolResult]]) -> None:
        self._tool = tool
        self._stop = stop
        # At exit the interpreter closes sys.stdin, which fails while a thread reads from it. So read from
        # another file object on the same descriptor.
        own = open(sys.stdin.fileno(), "rb", closefd=False)  # noqa: SIM115
        self._readline: Callable[[], bytes] = own.readline
        self._answered, self._answers = trio.open_memory_channel[JSONRPCResponse | JSONRPCError](PENDING)

    def __aiter__(self) -> AsyncIterator[str]:
        return self

    async def __anext__(self) -> str:
        while True:
            line = await trio.to_thread.run_sync(self._readline, abandon_on_cancel=True)
            if not line:
                raise StopAsyncIteration
            if not line.strip():
                continue
            parsed = understood(line.decode("utf-8", "replace"), self._tool)
            if isinstance(parsed, str):
                return parsed
            if isinstance(parsed, Stop):
                result = (await self._stop()).model_dump(mode="json", by_alias=True, exclude_none=True)
                # A response needs an id. A client ignores a response with an unknown id.
                number = STOP if parsed.id is None else parsed.id
                await self._answered.send(JSONRPCResponse(jsonrpc="2.0", id=number, result=result))
            else:
                await self._answered.send(parsed)

    async def answer(self, outgoing: Any) -> None:
        """Send the answers to lines that do not reach the server, until cancelled."""
        async for answer in self._answers:
            await outgoing.send(SessionMessage(answer))


def understood(line: str, tool: str) -> str | Stop | JSONRPCError:
    """Decide about a received line: return the line for the server, a stop, or an error. No I/O.

    Args:
        line: The received line.
        tool: The name of the robot's tool.
    """
    try:
        message = json.loads(line.lstrip("\ufeff"))
    except (ValueError, RecursionError) as error:
        if asks_for_stop(line, tool):
            return Stop(None)
        return _refusal(PARSE_ERROR, f"no JSON: {error}. Send one JSON-RPC message a line")
    is_message = isinstance(message, dict) and message.get("jsonrpc") == "2.0"
    stops = [part for part in (message if isinstance(message, list) else [message]) if _is_stop(part, tool)]
    if stops and not (is_message and _reaches_tool(message, tool)):
        return Stop(_id_of(stops[0]))
    if not is_message:
        return _refusal(
            INVALID_REQUEST, 'no JSON-RPC message. Send an object with "jsonrpc": "2.0" a line', _id_of(message)
        )
    if "id" in message and _id_of(message) is None:
        return _refusal(INVALID_REQUEST, "the id is neither text nor a whole number. Give it as one of these")
    return _checked(_with_object(message), _id_of(message))


def _reaches_tool(message: dict[str, Any], tool: str) -> bool:
    """Return True for a call that the SDK passes on to the tool."""
    params = message.get("params")
    if message.get("method") != CALL or _id_of(message) is None or not isinstance(params, dict):
        return False
    return params.get("name") == tool and isinstance(params.get("_meta"), dict | None)


def _is_stop(message: object, tool: str) -> bool:
    if not isinstance(message, dict):
        return asks_for_stop(message, tool)
    method = message.get("method", CALL)
    if isinstance(method, str) and method.strip().lower() != CALL:
        return asks_for_stop(method, tool)
    params = message.get("params") if "params" in message else message
    name = params.get("name") if isinstance(params, dict) else None
    is_of_another = isinstance(name, str) and not asks_for_stop(f"stop {name}", tool)
    return not is_of_another and asks_for_stop(params, tool)


def _with_object(message: dict[str, Any]) -> dict[str, Any]:
    """Return a tool call with its arguments in an object. A client may have sent them beside the tool's name,
    or as another type."""
    params = message.get("params")
    if message.get("method") != CALL or not isinstance(params, dict) or isinstance(params.get("arguments"), dict):
        return message
    beside = {key: value for key, value in params.items() if key not in OF_A_CALL}
    sent = beside if params.get("arguments") is None else params["arguments"]
    return {**message, "params": {**params, "arguments": {"input": sent}}} if sent != {} else message


def _checked(message: dict[str, Any], number: str | int | None) -> str | JSONRPCError:
    """Return a message as a line, or an error if the MCP SDK cannot read the message. The SDK would not answer
    such a line."""
    try:
        line = json.dumps(message)
        jsonrpc_message_adapter.validate_json(line, by_name=False)
    except (ValueError, RecursionError):
        return _refusal(INVALID_REQUEST, "no JSON-RPC request. Send a method, and params in an object", number)
    return line


def _id_of(message: object) -> str | int | None:
    id = message.get("id") if isinstance(message, dict) else None
    return id if isinstance(id, str | int) and not isinstance(id, bool) else None


def _refusal(code: int, reason: str, number: str | int | None = None) -> JSONRPCError:
    return JSONRPCError(jsonrpc="2.0", id=number, error=ErrorData(code=code, message=reason))
