"""Compute the pose of the flange from the joints, and the joints from a pose and the position of the elbow.

The seven joints of the arm are one more than a pose needs. Together with the position of joint 3, which FCI calls
the elbow, a pose has one solution near the present joints. The matrices are 4 x 4, in m, in the frame of the arm's
base.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from strands_actors.drivers.franka.arms import FLANGE_M, LINKS

ELBOW = 2
"""Index of the joint whose position is the elbow."""
TURNS = 20
"""Most steps towards a solution. From one millisecond of a path to the next it takes two or three."""
CLOSE = 1e-10
"""Largest difference between a pose and its solution, in m and rad."""
FAR = 0.5
"""A pose that is further away than this (m, rad) is not the next one of a path."""
SINGULAR = 0.02
"""Below this smallest singular value of the Jacobian, with a row for the elbow, the pose counts as singular: the
joints would have to be 50 times as fast as the end effector [assumed]."""


def matrix(column_major: Sequence[float]) -> Any:
    """Return the matrix with these 16 numbers, which FCI sends column by column."""
    return np.array(column_major, float).reshape(4, 4).T


def numbers(pose: Any) -> list[float]:
    """Return the 16 numbers of a matrix, column by column."""
    row: list[float] = pose.T.ravel().tolist()
    return row


def rotation_vector(rotation: Any) -> Any:
    """Return axis times angle (rad) of a rotation that is smaller than half a turn."""
    skew = 0.5 * np.array(
        (
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        )
    )
    sine = math.sqrt(float(skew @ skew))
    if sine < 1e-9:
        return skew
    return skew * (math.atan2(sine, 0.5 * (float(np.trace(rotation)) - 1.0)) / sine)


def rotation_of(vector: Any) -> Any:
    """Return the rotation by a vector: its axis times its angle (rad)."""
    angle = math.sqrt(float(vector @ vector))
    x, y, z = vector.tolist()
    skew = np.array(((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0)))
    if angle < 1e-9:
        return np.eye(3) + skew
    return np.eye(3) + math.sin(angle) / angle * skew + (1.0 - math.cos(angle)) / angle**2 * (skew @ skew)


_LINKS = [(*place, degrees) for place, degrees in LINKS]


Vector = tuple[float, float, float]


class _Chain(NamedTuple):
    """The axes and origins of the joints, and the flange: its place and its axes."""

    axes: list[Vector]
    origins: list[Vector]
    place: Vector
    x: Vector
    y: Vector
    z: Vector


def _chain(joints: Sequence[float]) -> _Chain:
    """Go along the links.

    It is computed three times in a millisecond, so it uses floats: numpy takes three times as long for such small
    matrices.
    """
    px = py = pz = 0.0
    x0, x1, x2, y0, y1, y2, z0, z1, z2 = 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0
    axes: list[Vector] = []
    origins: list[Vector] = []
    for (lx, ly, lz, roll), rad in zip(_LINKS, joints, strict=True):
        px += x0 * lx + y0 * ly + z0 * lz
        py += x1 * lx + y1 * ly + z1 * lz
        pz += x2 * lx + y2 * ly + z2 * lz
        if roll > 0:  # A quarter turn about x.
            y0, y1, y2, z0, z1, z2 = z0, z1, z2, -y0, -y1, -y2
        elif roll < 0:
            y0, y1, y2, z0, z1, z2 = -z0, -z1, -z2, y0, y1, y2
        c, s = math.cos(rad), math.sin(rad)
        x0, x1, x2, y0, y1, y2 = (
            c * x0 + s * y0,
            c * x1 + s * y1,
            c * x2 + s * y2,
            c * y0 - s * x0,
            c * y1 - s * x1,
            c * y2 - s * x2,
        )
        axes.append((z0, z1, z2))
        origins.append((px, py, pz))
    place = px + z0 * FLANGE_M, py + z1 * FLANGE_M, pz + z2 * FLANGE_M
    return _Chain(axes, origins, place, (x0, x1, x2), (y0, y1, y2), (z0, z1, z2))


def pose(joints: Sequence[float]) -> Any:
    """Return the pose of the flange at these joint positions (rad)."""
    chain = _chain(joints)
    return np.array((*zip(chain.x, chain.y, chain.z, chain.place, strict=True), (0.0, 0.0, 0.0, 1.0)))


def jacobian(joints: Sequence[float]) -> Any:
    """Return how the flange moves with the joints, as 6 x 7: its velocity, then its angular velocity."""
    return _jacobian(_chain(joints))[:6]


def _jacobian(chain: _Chain) -> Any:
    """Return the Jacobian, with a row for the elbow."""
    px, py, pz = chain.place
    columns = [
        (
            z1 * (pz - o2) - z2 * (py - o1),
            z2 * (px - o0) - z0 * (pz - o2),
            z0 * (py - o1) - z1 * (px - o0),
            z0,
            z1,
            z2,
            float(joint == ELBOW),
        )
        for joint, ((z0, z1, z2), (o0, o1, o2)) in enumerate(zip(chain.axes, chain.origins, strict=True))
    ]
    return np.array(columns).T


def is_singular(joints: Sequence[float]) -> bool:
    """Return whether the flange cannot move in some direction at these joint positions, with the elbow held."""
    return bool(np.linalg.svd(_jacobian(_chain(joints)), compute_uv=False)[-1] < SINGULAR)


def solve(flange: Any, elbow_rad: float, near: Sequence[float]) -> tuple[float, ...] | None:
    """Return the joint positions (rad) near ``near`` for a pose of the flange.

    Args:
        flange: The pose.
        elbow_rad: The position of joint 3.
        near: Joint positions a millisecond before.

    Returns:
        The joint positions, which may be beyond their ranges. None if the arm does not reach the pose from there.
    """
    place = flange[:3, 3].tolist()
    goal_x, goal_y, goal_z = flange[:3, :3].T.tolist()
    chain = _chain(near)
    try:
        # The joints move little in a millisecond, so that the inverse at their start serves for all steps.
        inverse = np.linalg.inv(_jacobian(chain))
    except np.linalg.LinAlgError:
        return None
    joints = tuple(near)
    for _ in range(TURNS):
        turn = [
            0.5 * sum(parts)
            for parts in zip(_cross(chain.x, goal_x), _cross(chain.y, goal_y), _cross(chain.z, goal_z), strict=True)
        ]
        error = [*(there - here for there, here in zip(place, chain.place, strict=True)), *turn]
        error.append(elbow_rad - joints[ELBOW])
        largest = max(map(abs, error))
        if largest < CLOSE:
            return joints
        if not largest < FAR:  # Also for a NaN.
            return None
        joints = tuple(rad + step for rad, step in zip(joints, (inverse @ error).tolist(), strict=True))
        chain = _chain(joints)
    return None


def _cross(a: Sequence[float], b: Sequence[float]) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
