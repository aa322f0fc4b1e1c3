"""Compute with poses in the form of UR controllers: a position in m, then a rotation vector in rad.

This module uses tuples of floats. The simulated controller computes 500 poses a second, and for vectors of three
numbers numpy would take twenty times as long.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

Vector = tuple[float, float, float]

ALMOST_ZERO = 1e-9


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def scaled(a: Vector, factor: float) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


def plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


class Frame(NamedTuple):
    """A coordinate frame: its origin and its three axes, all given in the base's frame."""

    place: Vector
    x: Vector
    y: Vector
    z: Vector

    def turned(self, v: Vector) -> Vector:
        """Convert a direction from this frame to the base's frame."""
        x, y, z = self.x, self.y, self.z
        return (
            x[0] * v[0] + y[0] * v[1] + z[0] * v[2],
            x[1] * v[0] + y[1] * v[1] + z[1] * v[2],
            x[2] * v[0] + y[2] * v[1] + z[2] * v[2],
        )

    def then(self, frame: Frame) -> Frame:
        """Convert ``frame`` from this frame to the base's frame."""
        return Frame(
            plus(self.place, self.turned(frame.place)),
            self.turned(frame.x),
            self.turned(frame.y),
            self.turned(frame.z),
        )

    def inverse(self) -> Frame:
        x, y, z, place = self.x, self.y, self.z, self.place
        return Frame(
            (-dot(x, place), -dot(y, place), -dot(z, place)),
            (x[0], y[0], z[0]),
            (x[1], y[1], z[1]),
            (x[2], y[2], z[2]),
        )

    def pose(self) -> tuple[float, ...]:
        """Return this frame as a pose: position in m, then rotation vector in rad."""
        return (*self.place, *rotation_vector(self.x, self.y, self.z))


ORIGIN = Frame((0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def frame_of(pose: Sequence[float]) -> Frame:
    """Convert a pose (position in m, rotation vector in rad) to a frame."""
    px, py, pz, rx, ry, rz = pose
    angle = math.sqrt(rx * rx + ry * ry + rz * rz)
    if angle < ALMOST_ZERO:
        return Frame((px, py, pz), ORIGIN.x, ORIGIN.y, ORIGIN.z)
    ux, uy, uz = rx / angle, ry / angle, rz / angle
    c, s = math.cos(angle), math.sin(angle)
    d = 1.0 - c
    return Frame(
        (px, py, pz),
        (c + ux * ux * d, uy * ux * d + uz * s, uz * ux * d - uy * s),
        (ux * uy * d - uz * s, c + uy * uy * d, uz * uy * d + ux * s),
        (ux * uz * d + uy * s, uy * uz * d - ux * s, c + uz * uz * d),
    )


def rotation_vector(x: Vector, y: Vector, z: Vector) -> Vector:
    """Return the rotation vector (rad) of a frame with these axes."""
    skew = (y[2] - z[1], z[0] - x[2], x[1] - y[0])  # A vector along the axis of rotation, 2 * sin(angle) long.
    sine2 = math.sqrt(dot(skew, skew))
    angle = math.atan2(sine2, x[0] + y[1] + z[2] - 1.0)
    if sine2 > 1e-6:
        return scaled(skew, angle / sine2)
    if angle < 1.0:
        return scaled(skew, 0.5)
    # The rotation is half a turn, so ``skew`` is zero. Its axis is then the longest column of R + 1.
    columns = ((x[0] + 1.0, x[1], x[2]), (y[0], y[1] + 1.0, y[2]), (z[0], z[1], z[2] + 1.0))
    longest = max(columns, key=lambda column: dot(column, column))
    return scaled(longest, angle / math.sqrt(dot(longest, longest)))


def between(start: Frame, goal: Frame) -> tuple[Vector, Vector]:
    """Return the motion from one frame to another: a translation (m) and a rotation vector (rad).

    Both are given along the axes of the base.
    """
    shift = plus(goal.place, scaled(start.place, -1.0))
    rotation = goal._replace(place=ORIGIN.place).then(start._replace(place=ORIGIN.place).inverse())
    return shift, rotation_vector(rotation.x, rotation.y, rotation.z)


def moved(start: Frame, shift: Vector, turn: Vector) -> Frame:
    """Return the frame ``start``, moved by ``shift`` (m) and turned about its origin by ``turn`` (rad)."""
    rotation = frame_of((0.0, 0.0, 0.0, *turn))
    return Frame(
        plus(start.place, shift), rotation.turned(start.x), rotation.turned(start.y), rotation.turned(start.z)
    )
