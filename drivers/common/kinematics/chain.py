"""Compute where the links of an arm are, from the angles of its joints. Pure Python, so that the process that
commands a real arm needs no library for it. One call takes some 200 us.

The points of an arm are the far ends of its links. The last one is the tip of its tool. Heights are above the plane
on which the arm stands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from .link_rows import Row, numbers, parse_rows

Vector = tuple[float, float, float]
Matrix = tuple[Vector, Vector, Vector]

G_M_S2 = 9.81

_UNTURNED: Matrix = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


class _Link(NamedTuple):
    parent: int  # index of the link that carries this one; -1 for the base
    offset: Vector
    turn: Matrix
    joint: int | None  # index of the joint that turns the link; None if it is fixed
    axis: Vector
    end: Vector  # the far end of the link, in the link's own frame
    kg: float
    com: Vector  # the centre of the link's mass, in the link's own frame


class Chain:
    """The links of an arm.

    Args:
        table: The robot's table, with ``model_rows`` and perhaps ``base``.
        joints: The names of the joints, in the order of the angles.
    """

    def __init__(self, table: Mapping[str, Any], joints: Sequence[str]) -> None:
        rows = parse_rows(table["model_rows"])
        index = self._index = {row.body: number for number, row in enumerate(rows)}
        self._base = _vector(numbers(table.get("base", {}).get("xyz", "0,0,0")))
        self._links = tuple(
            _Link(
                parent=index.get(row.parent, -1),
                offset=_vector(row.xyz),
                turn=matrix(row.quat),
                joint=joints.index(row.joint) if row.joint in joints else None,
                axis=row.axis,
                end=_end(row, rows),
                kg=row.kg,
                com=_vector(row.com or (0.0, 0.0, 0.0)),
            )
            for row in rows
        )

    def points(self, rad: Sequence[float]) -> list[Vector]:
        """Return the far end of each link, in metres, from the base to the tool.

        Args:
            rad: The angle of each joint, in radians.
        """
        frames = zip(self._links, self._frames(rad), strict=True)
        return [add(place, turned(turn, link.end)) for link, (place, turn) in frames]

    def frame(self, body: str, rad: Sequence[float]) -> tuple[Vector, Matrix]:
        """Return position (metres) and orientation of a link.

        Args:
            body: The name of the link.
            rad: The angle of each joint, in radians.

        Raises:
            KeyError: The arm has no such link.
        """
        return self._frames(rad)[self._index[body]]

    def gravity_nm(self, rad: Sequence[float]) -> list[float]:
        """Return the torque of each joint that carries the arm against gravity, in Nm. Every joint must turn.

        Args:
            rad: The angle of each joint, in radians.
        """
        frames = self._frames(rad)
        masses = [link.kg for link in self._links]
        # The sum of mass times place, over a link and all that it carries. A link comes after its parent.
        moments = [
            _scaled(link.kg, add(place, turned(turn, link.com)))
            for link, (place, turn) in zip(self._links, frames, strict=True)
        ]
        torques = [0.0] * len(rad)
        for number in reversed(range(len(self._links))):
            link, (place, turn), mass = self._links[number], frames[number], masses[number]
            if link.joint is not None:
                x, y, _ = turned(turn, link.axis)
                torques[link.joint] = G_M_S2 * (
                    x * (moments[number][1] - mass * place[1]) - y * (moments[number][0] - mass * place[0])
                )
            if link.parent >= 0:
                masses[link.parent] += mass
                moments[link.parent] = add(moments[link.parent], moments[number])
        return torques

    def _frames(self, rad: Sequence[float]) -> list[tuple[Vector, Matrix]]:
        frames: list[tuple[Vector, Matrix]] = []
        for link in self._links:
            origin, turn = frames[link.parent] if link.parent >= 0 else (self._base, _UNTURNED)
            place = add(origin, turned(turn, link.offset))
            turn = product(turn, link.turn)
            if link.joint is not None:
                turn = product(turn, _about(link.axis, rad[link.joint]))
            frames.append((place, turn))
        return frames


def _end(row: Row, rows: Sequence[Row]) -> Vector:
    """Return the far end of a link in its own frame: the end of its shape, or the joint of the next link."""
    children = [child.xyz for child in rows if child.parent == row.body]
    shape, _, place = (row.geom or "s0")[1:].partition("@")
    point = numbers(place) if place else children[0] if children else (0.0, 0.0, 0.0)
    if row.geom is None or row.geom[0] != "b":
        return _vector(point)
    # The far face of a box, seen from the joint.
    sizes = numbers(shape)
    longest = max(range(3), key=lambda axis: abs(point[axis]))
    end = list(point)
    end[longest] += math.copysign(sizes[longest], point[longest])
    return _vector(end)


def _vector(values: Sequence[float]) -> Vector:
    x, y, z = values
    return x, y, z


def add(first: Vector, second: Vector) -> Vector:
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def _scaled(factor: float, vector: Vector) -> Vector:
    return factor * vector[0], factor * vector[1], factor * vector[2]


def turned(turn: Matrix, vector: Vector) -> Vector:
    x, y, z = vector
    (a, b, c), (d, e, f), (g, h, i) = turn
    return a * x + b * y + c * z, d * x + e * y + f * z, g * x + h * y + i * z


def product(first: Matrix, second: Matrix) -> Matrix:
    columns = tuple(zip(*second, strict=True))
    rows = [tuple(a * x + b * y + c * z for x, y, z in columns) for a, b, c in first]
    return _vector(rows[0]), _vector(rows[1]), _vector(rows[2])


def matrix(quat: Sequence[float]) -> Matrix:
    """Return the rotation of a quaternion w, x, y, z, of any length."""
    length = math.sqrt(sum(value * value for value in quat))
    w, x, y, z = (value / length for value in quat)
    return (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )


def _about(axis: Vector, rad: float) -> Matrix:
    """Return the rotation about an axis of length 1."""
    half = rad / 2
    x, y, z = (math.sin(half) * value for value in axis)
    return matrix((math.cos(half), x, y, z))
