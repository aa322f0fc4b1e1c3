"""Standard input of an MCP server, line by line. A line that is no JSON-RPC message is answered as the
protocol says, and a tool's input in another form than an object reaches the tool all the same: it may
be a stop."""

from __future__ import annotations

import sys
from collections.abc import AsyncIterator, Callable
from typing import Any

import msgspec
import trio
from mcp.shared.message import SessionMessage
from mcp.types import ErrorData, JSONRPCError

PARSE_ERROR, INVALID_REQUEST = -32700, -32600
PENDING = 16
"""Refusals that wait to be written. Then no line is read until the client reads."""


class Lines:
    """The lines, and the answers to those that are none. Who waits for a line can be cancelled: a
    thread that hangs in it is left."""

    def __init__(self) -> None:
        self._readline: Callable[[], str] = sys.stdin.readline
        self._refused, self._refusals = trio.open_memory_channel[JSONRPCError](PENDING)

    def __aiter__(self) -> AsyncIterator[str]:
        return self

    async def __anext__(self) -> str:
        while True:
            line = await trio.to_thread.run_sync(self._readline, abandon_on_cancel=True)
            if not line:
                raise StopAsyncIteration
            if not line.strip():
                continue
            found = understood(line)
            if isinstance(found, str):
                return found
            await self._refused.send(found)

    async def answer(self, outgoing: Any) -> None:
        """Send what refused lines are answered with, until cancelled."""
        async for refusal in self._refusals:
            await outgoing.send(SessionMessage(refusal))


def understood(line: str) -> str | JSONRPCError:
    """Return a line as the server reads it, or how it is refused. Pure."""
    try:
        said = msgspec.json.decode(line)
    except (msgspec.DecodeError, RecursionError) as error:
        return _refusal(PARSE_ERROR, f"no JSON: {error}. send one JSON-RPC message a line")
    if not isinstance(said, dict) or said.get("jsonrpc") != "2.0":
        id = said.get("id") if isinstance(said, dict) else None
        why = 'no JSON-RPC message. send an object with "jsonrpc": "2.0" a line'
        return _refusal(INVALID_REQUEST, why, id if isinstance(id, str | int) else None)
    given = said.get("params")
    if said.get("method") != "tools/call" or not isinstance(given, dict):
        return line
    if isinstance(given.get("arguments", {}), dict | None):
        return line
    given["arguments"] = {"input": given["arguments"]}
    return msgspec.json.encode(said).decode()


def _refusal(code: int, why: str, number: str | int | None = None) -> JSONRPCError:
    return JSONRPCError(jsonrpc="2.0", id=number, error=ErrorData(code=code, message=why))
