"""Find joint positions that put the tool of an arm at a pose, by damped least squares.

Each step is the least joint motion that removes the error, by the derivative of the tool's pose. The damping keeps
the steps short near singular positions. The caller chooses the unit of length, metres or millimetres.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

Matrix = Any
"""A numpy array."""

_LONGEST_RAD = 0.3
"""Longest step of a joint."""


class PoseSearch(NamedTuple):
    """The search for one arm.

    Attributes:
        low: The least position of each joint, in rad.
        high: The largest position of each joint.
        near: A solution may differ from the requested position by this much.
        near_rad: A solution may differ from the requested orientation by this much.
        length_of_rad: One rad of rotation weighs as much as this length, about half of the arm's reach.
        damping: Damping of the steps near singular positions, a length.
    """

    low: Matrix
    high: Matrix
    near: float
    near_rad: float
    length_of_rad: float
    damping: float

    def least_rates(self, jacobian: Matrix, twist: Matrix) -> Matrix:
        """Return the least joint motion for a motion of the tool.

        Args:
            jacobian: The derivative of the pose by the joint positions: three rows of lengths, three of rotations.
            twist: The motion of the tool: along the axes, then about them.
        """
        weights = np.array((1.0, 1.0, 1.0, *(self.length_of_rad,) * 3))
        weighted = jacobian * weights[:, None]
        square = weighted @ weighted.T + self.damping**2 * np.eye(6)
        return weighted.T @ np.linalg.solve(square, np.asarray(twist) * weights)

    def solve(
        self, look: Callable[[Matrix], tuple[Matrix, Matrix]], rad: Sequence[float], steps: int
    ) -> Matrix | None:
        """Return joint positions for a pose, in the joint ranges; None without a solution.

        Args:
            look: Returns the error of the pose at these joint positions, and the derivative there.
            rad: The joint positions where the search starts. If there are several solutions, the nearest counts.
            steps: Steps of the search at most.
        """
        joints: Matrix = np.clip(np.array(rad, dtype=float), self.low, self.high)
        for _ in range(steps):
            error, jacobian = look(joints)
            if np.linalg.norm(error[:3]) < self.near and np.linalg.norm(error[3:]) < self.near_rad:
                return joints
            step = self.least_rates(jacobian, error)
            longest = float(np.abs(step).max())
            joints = np.clip(joints + step * min(1.0, _LONGEST_RAD / max(longest, 1e-9)), self.low, self.high)
        return None
