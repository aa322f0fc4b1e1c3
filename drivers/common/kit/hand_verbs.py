"""The verbs of an arm's hand for agents (``Driver.TOOL_VERBS``)."""

from __future__ import annotations

from strands_actors.contract.tool_verbs import ToolVerb

from .hand import AXIS, FULL

HAND_VERBS = (
    ToolVerb("open", "action", "Open the gripper all the way.", action={AXIS: FULL}),
    ToolVerb("close", "action", "Close the gripper, onto what is in it.", action={AXIS: 0.0}),
)

__all__ = ["HAND_VERBS"]
