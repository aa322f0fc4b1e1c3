"""A model for strands-agents that returns scripted turns and records the tool results. It needs no network."""

from __future__ import annotations

import copy
import itertools
import json
from collections.abc import AsyncIterator
from typing import Any

from strands.models import Model

Turn = str | list[tuple[str, dict[str, Any]]]
"""A text, or tools that are called at the same time, each with its input."""


class Scripted(Model):
    def __init__(self, *turns: Turn) -> None:
        self._turns = iter(turns)
        self._ids = itertools.count()
        self.offered: list[dict[str, Any]] = []
        self.heard: list[list[dict[str, Any]]] = []
        """The received tool results, by turn."""

    def update_config(self, **_: Any) -> None:
        pass

    def get_config(self) -> dict[str, Any]:
        return {}

    def structured_output(self, *_: Any, **__: Any) -> Any:
        raise NotImplementedError

    async def stream(self, messages: Any, tool_specs: Any = None, *_: Any, **__: Any) -> AsyncIterator[Any]:
        self.offered = tool_specs or []
        blocks = copy.deepcopy(messages[-1]["content"])
        if results := [block["toolResult"] for block in blocks if "toolResult" in block]:
            self.heard.append(results)
        turn = next(self._turns)
        yield {"messageStart": {"role": "assistant"}}
        if isinstance(turn, str):
            yield {"contentBlockStart": {"start": {}}}
            yield {"contentBlockDelta": {"delta": {"text": turn}}}
            yield {"contentBlockStop": {}}
        else:
            for name, given in turn:
                use = {"name": name, "toolUseId": f"use-{next(self._ids)}"}
                yield {"contentBlockStart": {"start": {"toolUse": use}}}
                yield {"contentBlockDelta": {"delta": {"toolUse": {"input": json.dumps(given)}}}}
                yield {"contentBlockStop": {}}
        yield {"messageStop": {"stopReason": "end_turn" if isinstance(turn, str) else "tool_use"}}
