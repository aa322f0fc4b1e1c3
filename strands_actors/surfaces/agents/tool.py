"""A robot as a strands-agents tool, without importing that package.

``strands.Agent(tools=[robot])`` keeps what is an instance of its ``AgentTool`` and drops everything
else. To inherit from that class would import the package, and all it brings, into every script with
a robot. Instead ``RobotTool`` supplies what ``AgentTool`` supplies, and registers with it when it
is asked what it is: whoever can ask has loaded it.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import AsyncIterator, Mapping
from typing import Any

from strands_actors.caller.envelopes import Answer
from strands_actors.contract.driver import Driver

from .calls import tool_spec

AGENT_TOOL = "strands.types.tools"
"""Where strands-agents keeps ``AgentTool``."""


class RobotTool:
    """The members of ``AgentTool``. A subclass says what its driver is and performs."""

    tool_type = "robot"
    _is_dynamic = False

    @property  # type: ignore[misc]  # read-only, as far as anybody has a reason to write
    def __class__(self) -> type[RobotTool]:
        """Return what ``isinstance`` asks for when the real type does not answer."""
        agent_tool = getattr(sys.modules.get(AGENT_TOOL), "AgentTool", None)
        if agent_tool is not None:
            agent_tool.register(type(self))
        return type(self)

    @property
    @abstractmethod
    def tool_name(self) -> str: ...

    @property
    @abstractmethod
    def driver(self) -> Driver: ...

    @abstractmethod
    async def use_tool(self, given: object, by: str) -> Answer:
        """Do what a tool's input asks for, from an asyncio loop. ``by``: who asks, for the
        operator."""

    @property
    def tool_spec(self) -> dict[str, Any]:
        """Name, description and the inputs its driver declares."""
        return tool_spec(self.tool_name, self.driver)

    async def stream(
        self, tool_use: Mapping[str, Any], invocation_state: Mapping[str, Any] | None = None, **_: Any
    ) -> AsyncIterator[dict[str, Any]]:
        """One tool result, ``{toolUseId, status, content}``. The actors do the work: the loop is
        never blocked."""
        answer = await self.use_tool(tool_use.get("input"), "agent")
        yield {"toolUseId": tool_use.get("toolUseId", ""), **answer}

    @property
    def supports_hot_reload(self) -> bool:
        return False

    @property
    def is_dynamic(self) -> bool:
        return self._is_dynamic

    def mark_dynamic(self) -> None:
        self._is_dynamic = True

    def get_display_properties(self) -> dict[str, str]:
        return {"Name": self.tool_name, "Type": self.tool_type, "Robot": self.driver.robot}
