"""Find the function that computes the pose of an arm's tool from the positions of its joints."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from strands_actors.contract.arm_model import TABLE_BUILDER
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import load
from strands_actors.drivers import TOOL_POSE

Pose = tuple[tuple[float, ...], tuple[float, ...]]
"""Position in metres, and orientation as w, x, y, z, in the frame of the base."""

PoseOf = Callable[[Mapping[str, float]], Pose | None]
"""Returns the pose for positions of joints in radians; None if a joint is missing."""


def pose_function(driver: Driver) -> PoseOf | None:
    """Return the function for a robot. None for one without a tool, or with a model that has no rows of links."""
    model = driver.arm_model({})
    if model is None or model.builder != TABLE_BUILDER or model.site:
        return None
    function: PoseOf = load(TOOL_POSE)(model)
    return function
