"""Compute the pose of an arm's tool from the positions of its joints. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping

from strands_actors.contract.arm_model import ArmModel

from .chain import Chain, Matrix, Vector, add, matrix, product, turned

Quaternion = tuple[float, float, float, float]
Pose = tuple[Vector, Quaternion]


def tool_pose(arm: ArmModel) -> Callable[[Mapping[str, float]], Pose | None]:
    """Return the function that computes the pose of the tool.

    The function takes the position of each joint in radians. It returns position in metres and orientation as w, x,
    y, z, in the frame of the base; None if a joint is missing.

    Args:
        arm: The model of the arm, with a table of rows and a link that carries the tool.
    """
    chain = Chain(arm.table, arm.joints)
    turn = matrix(arm.tool_quat)

    def pose(positions: Mapping[str, float]) -> Pose | None:
        if not all(joint in positions for joint in arm.joints):
            return None
        origin, orientation = chain.frame(arm.link, [positions[joint] for joint in arm.joints])
        return add(origin, turned(orientation, arm.tool_xyz)), quaternion_of(product(orientation, turn))

    return pose


def quaternion_of(rotation: Matrix) -> Quaternion:
    """Return the quaternion w, x, y, z of a rotation, with w at least 0."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    # The squares of the parts, times 4. The largest one is divided by, so that nothing is divided by zero.
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
    largest = max(range(4), key=squares.__getitem__)
    products = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )[largest]
    scale = math.copysign(0.5 / math.sqrt(squares[largest]), products[0] or 1.0)
    w, x, y, z = (value * scale for value in products)
    return w, x, y, z
