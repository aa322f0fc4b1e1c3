"""Make the robot that a command starts, from the options --port, --twin, --id and --camera."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from strands_actors.caller.handle.factory import Robot
from strands_actors.caller.handle.real_robot import RealRobot

from .errors import Problem

TWIN = "twin"


class OneRobot(NamedTuple):
    """The robot that a command starts, and how to connect it.

    Attributes:
        robot: The robot's type.
        port: The port or address of a real robot. None for a simulated robot.
        twin: Use the real driver with a simulated robot.
        id: The robot's id, which is also the name of its calibration. None: its type.
        cameras: The settings of its cameras, as for ``Robot``; None for no cameras.
        scene: Further keywords of ``Robot`` for a simulation, such as ``urdf_path``.
    """

    robot: str
    port: str | None
    twin: bool
    id: str | None
    cameras: dict[str, dict[str, Any]] | None
    scene: Mapping[str, Any] = MappingProxyType({})

    def make(self, verb: str) -> RealRobot:
        """Return the robot, which is not connected yet.

        Args:
            verb: The command, for the text of an error.

        Raises:
            Problem: Both a port and the twin are given.
            ValueError: The robot is unknown, or an option is wrong. ``TypeError`` likewise.
        """
        robot, port, twin, robot_id, cameras, scene = self
        if port is not None and twin:
            raise Problem(f"{verb}: --port and --twin are both given. Choose one")
        if scene and (twin or port is not None):
            raise Problem(
                f"{verb}: --model, --keyframe and --onboard are for a simulation. Leave --port and --twin out"
            )
        if port is not None:
            return Robot(robot, mode="real", port=port, id=robot_id, cameras=cameras)
        if twin:
            return Robot(robot, mode="real", transport=TWIN, id=robot_id, cameras=cameras)
        return Robot(robot, id=robot_id, cameras=cameras, **scene)
