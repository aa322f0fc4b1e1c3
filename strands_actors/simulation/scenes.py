"""A scene and success functions for ``strands-actors eval``, to use or to copy.

A scene function gets the simulation and random numbers of the episode's seed. What it draws differs from episode to
episode, and is the same whenever the episode is repeated.
"""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import TYPE_CHECKING

from .episodes import Moment

if TYPE_CHECKING:
    from strands_actors.caller.handle.sim_robot import SimRobot

CUBE = "cube"
CAMERA = "scene"
"""Name of the camera that ``cube`` adds, for ``--camera NAME:view=scene``."""
REACH_M = (0.27, 0.34)
LIFTED_M = 0.04
PUSHED_M = 0.03
START_SHARE = 0.05


def cube(sim: SimRobot, draw: random.Random) -> Mapping[str, float]:
    """Put a cube in front of the arm, and vary the cube, the light, a camera and the start pose.

    The cube has edges of 3 to 5 cm. The camera ``scene`` looks at it from a place that varies by up to 5 cm.

    Args:
        sim: The simulation.
        draw: Random numbers.

    Returns:
        The start pose: each joint near where it is, within a twentieth of its range.
    """
    angle, reach = draw.uniform(-0.5, 0.5), draw.uniform(*REACH_M)
    size, yaw = draw.uniform(0.03, 0.05), draw.uniform(0.0, math.pi / 2)
    place = (reach * math.cos(angle), reach * math.sin(angle), size / 2)
    sim.add_object(
        CUBE,
        position=place,
        orientation=(math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)),
        size=(size, size, size),
        color=[draw.uniform(0.2, 1.0) for _ in range(3)],
        mass=0.05,
    )
    sim.set_light(draw.uniform(0.6, 1.4), draw.uniform(-180.0, 180.0), draw.uniform(35.0, 80.0))
    eye = [value + draw.uniform(-0.05, 0.05) for value in (0.5, 0.35, 0.4)]
    sim.add_camera(CAMERA, position=eye, target=place, fov=draw.uniform(50.0, 60.0))
    start = {}
    for axis in sim.driver.table:
        now, (low, high) = sim.get_observation()[axis.key], axis.limits
        if math.isfinite(high - low):
            away = START_SHARE * (high - low) * draw.uniform(-1.0, 1.0)
            start[axis.key] = min(max(now + away, low), high)
    return start


def cube_lifted(moment: Moment) -> bool:
    """Return True if the cube is 4 cm higher than at the start."""
    return moment.objects[CUBE][2] > moment.start[CUBE][2] + LIFTED_M


def cube_pushed(moment: Moment) -> bool:
    """Return True if the cube is 3 cm away from its start."""
    return math.dist(moment.objects[CUBE][:2], moment.start[CUBE][:2]) > PUSHED_M


__all__ = ["cube", "cube_lifted", "cube_pushed"]
