"""The tools of arms that an operator can jog: the arm's model turns the tool's speed into joint targets."""

from __future__ import annotations

import math
from collections.abc import Mapping

import trio

from strands_actors.caller.poses.tool_targets import ToolTargets

from .types import driver_of

Units = Mapping[str, tuple[float, float]]


class Tools:
    """The tools by type of robot. Each is built once, which takes some tenths of a second."""

    def __init__(self) -> None:
        self._tools: dict[str, tuple[ToolTargets, Units] | None] = {}
        self._building = trio.Lock()

    async def get(self, robot_type: str, units: Units) -> ToolTargets | None:
        """Return the tool of a robot.

        Args:
            robot_type: Type of the robot.
            units: (zero, scale) by axis, as the robot publishes them.

        Returns:
            None if there is no model of an arm of this type here, or if this robot has other units than the model.
        """
        async with self._building:
            if robot_type not in self._tools:
                self._tools[robot_type] = await trio.to_thread.run_sync(_build, robot_type)
        built = self._tools[robot_type]
        if built is None:
            return None
        tool, own = built
        same = all(key in units and _are_close(units[key], own[key]) for key in tool.joints)
        return tool if same else None


def _build(robot_type: str) -> tuple[ToolTargets, Units] | None:
    driver = driver_of(robot_type)
    if driver is None or driver.arm_model({}) is None:
        return None
    return ToolTargets(driver), dict(zip(driver.axes, driver.model_units(), strict=True))


def _are_close(one: tuple[float, float], other: tuple[float, float]) -> bool:
    return all(math.isclose(a, b, abs_tol=1e-6) for a, b in zip(one, other, strict=True))
