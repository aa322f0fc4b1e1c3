"""Let a policy give poses of the tool, with the keys ``ee.*``. Runs in the worker thread of the policy."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from strands_actors.contract.pose_keys import PREFIX
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.loading import load_driver

from . import refusals

if TYPE_CHECKING:
    from .tool_targets import ToolTargets

Action = dict[str, Any]
Infer = Callable[[dict[str, float], str], Sequence[Action]]


class NoTool(Exception):
    """An action has a pose that the arm cannot follow. The text has the reason and the remedy."""


def with_tool(infer: Infer, description: dict[str, Any], reads_pose: bool) -> Infer:
    """Return a policy's function whose actions have joint targets in place of poses of the tool.

    Args:
        infer: Returns actions from the position by axis and the instruction.
        description: The driver of the robot (``supervisors/loading``).
        reads_pose: True adds the keys of the pose to the observation.

    Raises:
        NoTool: An action has a pose that the arm cannot follow, or the robot has no model of an arm.
    """
    tool: ToolTargets | None = None

    def made() -> ToolTargets:
        nonlocal tool
        if tool is None:
            # MuJoCo and numpy are imported only here, since most policies give no poses.
            from .tool_targets import ToolTargets

            driver = load_driver(description)
            if driver.arm_model({}) is None:
                raise NoTool(refusals.no_arm("", driver.robot).text)
            tool = ToolTargets(driver)
        return tool

    def converted(observation: dict[str, float], instruction: str) -> Sequence[Action]:
        if reads_pose:
            observation.update(made().pose(observation))
        actions, before = [], dict(observation)
        for action in infer(observation, instruction):
            if any(key.startswith(PREFIX) for key in action):
                targets = made().targets(action, before)
                if isinstance(targets, Refused):
                    raise NoTool(targets.text)
                action = targets
            before.update({key.removesuffix(".pos"): value for key, value in action.items()})
            actions.append(action)
        return actions

    return converted


__all__ = ["NoTool", "with_tool"]
