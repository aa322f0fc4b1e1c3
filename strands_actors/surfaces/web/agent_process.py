"""The process of the console's agent. Its arguments are the user's ``module:function``, and the mesh's file.

The function gets the tools, and returns an agent of strands-agents with the user's own model. Each line of standard
input is a ``Prompt``, and each line of standard output an ``Entry``. When standard input ends, the process ends at
once, so that no agent goes on without its console.

What the user's code prints goes to standard error.
"""

from __future__ import annotations

import asyncio
import contextlib
import enum
import os
import sys
import threading
from collections.abc import Callable
from typing import Any, BinaryIO

import msgspec

from strands_actors import ask_on_console, fleet
from strands_actors.contract.loading import load

LONGEST_VALUE = 4000
"""Longest shown input or answer of a tool, in characters."""


class Kind(enum.StrEnum):
    """The kind of an entry in the conversation."""

    PROMPT = "prompt"
    """A person's words."""
    READY = "ready"
    TEXT = "text"
    """A part of the agent's words."""
    ASKS = "asks"
    """The agent calls a tool."""
    GOT = "got"
    """The answer of the tool."""
    REFUSED = "refused"
    """The tool has refused, with the reason."""
    DONE = "done"
    FAILED = "failed"
    ENDED = "ended"
    """The process has ended, and the agent has forgotten the conversation."""


class Prompt(msgspec.Struct, frozen=True):
    """A person's words to the agent."""

    text: str


class Entry(msgspec.Struct, frozen=True):
    """A part of the conversation.

    Attributes:
        kind: Its kind.
        text: Words, the answer of a tool, or the reason of a failure.
        tool: The tool that is called, or that answers.
        by: The person, for ``PROMPT``.
    """

    kind: Kind
    text: str = ""
    tool: str = ""
    by: str = ""


def main(factory: str, mesh: str) -> None:
    """Run the agent until standard input ends.

    Args:
        factory: ``module:function`` of the user. It gets a list of tools and returns an ``Agent``.
        mesh: The file that configures the mesh; empty for the robots of this user.
    """
    with os.fdopen(os.dup(1), "wb", buffering=0) as output:
        os.dup2(2, 1)
        asyncio.run(_talk(factory, mesh, output))


async def _talk(factory: str, mesh: str, output: BinaryIO) -> None:
    def put(kind: Kind, text: str = "", tool: str = "") -> None:
        output.write(msgspec.json.encode(Entry(kind, text[:LONGEST_VALUE], tool)) + b"\n")

    prompts = _prompts()
    try:
        agent = load(factory)([fleet(mesh=mesh or None, approve=ask_on_console)])
        _show_tools(agent, put)
    except Exception as error:  # The user's code may raise anything, and the operator should read it.
        put(Kind.FAILED, f"the agent cannot be made: {type(error).__name__}: {error}")
        return
    put(Kind.READY)
    while True:
        prompt = await prompts.get()
        try:
            async for event in agent.stream_async(prompt.text):
                if isinstance(event.get("data"), str):
                    put(Kind.TEXT, event["data"])
        except Exception as error:  # The same: the model's provider may raise anything.
            put(Kind.FAILED, f"{type(error).__name__}: {error}")
        else:
            put(Kind.DONE)


def _show_tools(agent: Any, put: Callable[[Kind, str, str], None]) -> None:
    """Show each call of a tool, and its answer."""
    from strands.hooks import AfterToolCallEvent, BeforeToolCallEvent

    def before(event: BeforeToolCallEvent) -> None:
        put(Kind.ASKS, _json(event.tool_use["input"]), event.tool_use["name"])

    def after(event: AfterToolCallEvent) -> None:
        kind = Kind.GOT if event.result["status"] == "success" else Kind.REFUSED
        texts = [block.get("text") or _json(block.get("json", "")) for block in event.result["content"]]
        put(kind, "\n".join(texts[:1] if kind is Kind.REFUSED else texts), event.tool_use["name"])

    agent.add_hook(before, BeforeToolCallEvent)
    agent.add_hook(after, AfterToolCallEvent)


def _prompts() -> asyncio.Queue[Prompt]:
    """Read standard input in a thread."""
    queue: asyncio.Queue[Prompt] = asyncio.Queue()
    loop = asyncio.get_running_loop()

    def read() -> None:
        with contextlib.suppress(msgspec.MsgspecError, RuntimeError):
            for line in sys.stdin.buffer:
                loop.call_soon_threadsafe(queue.put_nowait, msgspec.json.decode(line, type=Prompt))
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return queue


def _json(value: object) -> str:
    return msgspec.json.encode(value, enc_hook=str).decode()


if __name__ == "__main__":
    main(sys.argv[1], *sys.argv[2:] or [""])
