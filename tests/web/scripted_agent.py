"""Agents of tests for the console, with scripted models."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

from strands import Agent

from tests.agents.scripted import Scripted

RUN = {"action": "run", "robot": "so101", "instruction": "wave", "policy": "mock", "seconds": 1.0}


def helpful(tools: list[Any]) -> Agent:
    """Return an agent that lists the robots, asks for a task, and prints, as users' code may do."""
    print("this is not a message")
    model = Scripted([("fleet", {"action": "list"})], [("fleet", RUN)], "that is all")
    return Agent(model=model, tools=tools, callback_handler=None)


class _Slow(Scripted):
    async def stream(self, *_: Any, **__: Any) -> AsyncIterator[Any]:
        yield {"messageStart": {"role": "assistant"}}
        await asyncio.sleep(600)


def slow(tools: list[Any]) -> Agent:
    """Return an agent whose model does not answer."""
    return Agent(model=_Slow(), tools=tools, callback_handler=None)


def broken(tools: list[Any]) -> Agent:
    """Fail, as a provider without a key does."""
    raise RuntimeError("no key")
