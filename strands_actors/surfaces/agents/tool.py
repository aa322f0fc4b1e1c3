"""Make a robot usable as a tool of strands-agents, without importing that package.

``strands.Agent(tools=[robot])`` accepts only instances of ``AgentTool``, a class of strands-agents. A
subclass of ``AgentTool`` would import strands-agents and its dependencies into every script with a robot.
Instead ``StrandsTool`` has the same members, and registers as a virtual subclass when ``isinstance`` checks
it. A program that makes this check has already imported strands-agents.
"""

from __future__ import annotations

import sys
from abc import abstractmethod
from collections.abc import AsyncIterator, Mapping
from typing import Any

from strands_actors.caller.handle.envelopes import Answer
from strands_actors.contract.driver import Driver

from .calls import tool_spec

AGENT_TOOL = "strands.types.tools"
"""Where strands-agents keeps ``AgentTool``."""


class StrandsTool:
    """The members of ``AgentTool`` of strands-agents. A subclass describes the tool, and carries out calls."""

    tool_type = "robot"
    _is_dynamic = False

    @property  # type: ignore[misc]  # read-only, as far as anybody has a reason to write
    def __class__(self) -> type[StrandsTool]:
        """Register the object's class with ``AgentTool``, and return this class. ``isinstance`` asks for
        ``__class__`` when the real type does not match."""
        agent_tool = getattr(sys.modules.get(AGENT_TOOL), "AgentTool", None)
        if agent_tool is not None:
            agent_tool.register(type(self))
        return type(self)

    @property
    @abstractmethod
    def tool_name(self) -> str: ...

    @property
    @abstractmethod
    def tool_spec(self) -> dict[str, Any]:
        """Return the name, the description and the inputs of the tool."""

    @abstractmethod
    async def use_tool(self, tool_input: object, by: str) -> Answer:
        """Carry out a tool's input, from an asyncio loop.

        Args:
            tool_input: The input as the caller sent it.
            by: The name of the caller, which the operator sees in a request for approval.
        """

    async def stream(
        self, tool_use: Mapping[str, Any], invocation_state: Mapping[str, Any] | None = None, **_: Any
    ) -> AsyncIterator[dict[str, Any]]:
        """Yield one tool result, ``{toolUseId, status, content}``. The event loop is not blocked meanwhile."""
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
        return {"Name": self.tool_name, "Type": self.tool_type}


class RobotTool(StrandsTool):
    """A robot as a tool. A subclass provides the driver, and carries out calls."""

    @property
    @abstractmethod
    def driver(self) -> Driver: ...

    @property
    def tool_spec(self) -> dict[str, Any]:
        """Return the name, the description and the inputs that the driver declares."""
        return tool_spec(self.tool_name, self.driver)

    def get_display_properties(self) -> dict[str, str]:
        return {**super().get_display_properties(), "Robot": self.driver.robot}
