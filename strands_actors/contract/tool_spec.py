"""Describe a robot as a tool for strands-agents and MCP, from the declarations of its driver. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .agent_verbs import verbs_of
from .driver import Driver


def tool_spec(tool_name: str, driver: Driver) -> dict[str, Any]:
    """Return the specification of the tool. The tool's input ``action`` selects the verb."""
    verbs = verbs_of(driver)
    properties: dict[str, Any] = {
        "action": {
            "type": "string",
            "enum": [verb.name for verb in verbs],
            "description": " ".join(f"{verb.name}: {verb.description}" for verb in verbs),
        }
    }
    for verb in verbs:
        for name, schema in verb.inputs.items():
            properties[name] = _with_axes(schema, driver)
    return {
        "name": tool_name,
        "description": (
            f"The robot {driver.robot}: {', '.join(driver.axes)}, in {driver.unit}. "
            "What it must not do it refuses, and says what it would accept."
        ),
        "inputSchema": {"json": {"type": "object", "properties": properties, "required": ["action"]}},
    }


def _with_axes(schema: Mapping[str, Any], driver: Driver) -> dict[str, Any]:
    """Add the robot's axes to the schema of an input that is an object with one number for each axis."""
    if schema["type"] != "object":
        return dict(schema)
    return {
        **schema,
        "properties": {axis: {"type": "number"} for axis in driver.axes},
        "additionalProperties": False,
    }
