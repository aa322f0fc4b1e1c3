"""Place a camera so that a robot fills the picture."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from strands_actors.drivers.common.physics.lean_mujoco import mujoco

Floats = NDArray[np.float64]

LENS_DEG = 26.0
"""Vertical angle of view. A long lens keeps straight parts straight."""

_ROUNDS = 40


class Direction(NamedTuple):
    """The direction in which a camera looks: azimuth and elevation in degrees, as MuJoCo has them."""

    azimuth: float
    elevation: float


def visible_points(model: Any, data: Any) -> Floats:
    """Return points of everything that is drawn but the ground, in the pose of ``data``: corners of meshes, and
    the corners of the boxes around other shapes."""
    clouds = []
    for geom in range(model.ngeom):
        kind = model.geom_type[geom]
        drawn = model.geom_group[geom] < 3 and model.geom_rgba[geom, 3] > 0
        if not drawn or kind == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        if kind == mujoco.mjtGeom.mjGEOM_MESH:
            mesh = model.geom_dataid[geom]
            start = model.mesh_vertadr[mesh]
            points = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
        else:
            middle, half = np.split(model.geom_aabb[geom], 2)
            signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
            points = middle + signs * half
        clouds.append(data.geom_xpos[geom] + points @ data.geom_xmat[geom].reshape(3, 3).T)
    return np.concatenate(clouds)


def frame(points: Floats, direction: Direction, aspect: float, filled: float) -> Any:
    """Return an ``MjvCamera`` that has all points in its picture.

    Args:
        points: Rows of x, y, z in metres.
        direction: The direction in which the camera looks.
        aspect: Width of the picture divided by its height.
        filled: The share of the picture's width or height that the points take, from 0 to 1.
    """
    turn, rise = math.radians(direction.azimuth), math.radians(direction.elevation)
    forward = np.array([math.cos(rise) * math.cos(turn), math.cos(rise) * math.sin(turn), math.sin(rise)])
    right = np.array([math.sin(turn), -math.cos(turn), 0.0])
    up = np.cross(right, forward)
    tall = math.tan(math.radians(LENS_DEG) / 2)
    middle = points.mean(axis=0)
    distance = float(np.linalg.norm(points - middle, axis=1).max()) / tall
    for _ in range(_ROUNDS):
        depth = (points - middle) @ forward + distance
        across, along = (points - middle) @ right / depth, (points - middle) @ up / depth
        middle = middle + distance * (
            right * (across.max() + across.min()) / 2 + up * (along.max() + along.min()) / 2
        )
        share = max((across.max() - across.min()) / (2 * tall * aspect), (along.max() - along.min()) / (2 * tall))
        distance *= 1 + 0.8 * (share / filled - 1)
    eye = mujoco.MjvCamera()
    eye.type = mujoco.mjtCamera.mjCAMERA_FREE
    eye.lookat[:] = middle
    eye.distance = distance
    eye.azimuth, eye.elevation = direction
    return eye
