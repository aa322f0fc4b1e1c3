"""Make the surface of one part as triangles: the outline that a table of looks describes.

A surface is closed, and its triangles are counterclockwise when seen from outside.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

AROUND = 24
"""Corners of a cross-section."""

_ROUNDING = 4
"""Rings of a rounded end."""
_BETWEEN = 4
"""Rings between two stations of a smooth rod."""

Floats = NDArray[np.float64]


class Outline(NamedTuple):
    """A closed surface. ``points`` has a row for each corner, ``faces`` three indices for each triangle."""

    points: Floats
    faces: NDArray[np.int32]


class Station(NamedTuple):
    """A cross-section on the way of a rod.

    ``half`` has the two half sizes in metres, in the order of the axes that are not the rod's. ``power`` is 2 for
    an ellipse; with a greater number the section comes closer to a rectangle.
    """

    point: tuple[float, float, float]
    half: tuple[float, float]
    power: float = 2.0


def rod(stations: Sequence[Station], rounding: float | None = None, smooth: bool = True) -> Outline:
    """Return a surface through cross-sections, with rounded ends.

    Args:
        stations: Two or more cross-sections. The surface begins and ends exactly at the first and the last one.
        rounding: Radius of the rounded ends in metres. None: as large as possible.
        smooth: True bends the surface between the sections. False connects them by straight lines.
    """
    points = np.array([station.point for station in stations])
    shapes = np.array([[*station.half, station.power] for station in stations])
    if smooth and len(stations) > 2:
        points, shapes = _bent(points), _bent(shapes)
    tangents = _tangents(points)
    first, last = (_end(shapes[index], rounding, points) for index in (0, -1))
    rows = [
        *((points[0] + tangents[0] * (first - along), shapes[0] - [shrink, shrink, 0], tangents[0])
          for along, shrink in _quarter(first)[::-1]),
        *((point, shape, tangent)
          for point, shape, tangent in zip(points[1:-1], shapes[1:-1], tangents[1:-1], strict=True)),
        *((points[-1] - tangents[-1] * (last - along), shapes[-1] - [shrink, shrink, 0], tangents[-1])
          for along, shrink in _quarter(last)),
    ]  # fmt: skip
    side = _across(points, tangents)
    return _closed(np.array([_section(*row, *side) for row in rows]))


def box(middle: Sequence[float], half: Sequence[float], rounding: float) -> Outline:
    """Return a box with rounded edges.

    Args:
        middle: Its middle in metres.
        half: Its half sizes in metres.
        rounding: Radius of the edges in metres.
    """
    radius = min(rounding, *half)
    steps = np.linspace(0.0, np.pi / 2, _ROUNDING)
    ups = np.concatenate([steps - np.pi / 2, steps])
    ups_sign = np.repeat([-1.0, 1.0], _ROUNDING)
    turns = np.concatenate([steps + quarter * np.pi / 2 for quarter in range(4)])
    signs_x, signs_y = np.repeat([1.0, -1.0, -1.0, 1.0], _ROUNDING), np.repeat([1.0, 1.0, -1.0, -1.0], _ROUNDING)
    flat = np.asarray(half) - radius
    rings = [
        np.column_stack([
            radius * np.cos(up) * np.cos(turns) + signs_x * flat[0],
            radius * np.cos(up) * np.sin(turns) + signs_y * flat[1],
            np.full(len(turns), radius * np.sin(up) + sign * flat[2]),
        ])
        for up, sign in zip(ups, ups_sign, strict=True)
    ]  # fmt: skip
    return _closed(np.array(rings) + np.asarray(middle))


def ball(middle: Sequence[float], half: Sequence[float]) -> Outline:
    """Return an ellipsoid, by its middle and its half sizes in metres."""
    ups = np.linspace(-np.pi / 2, np.pi / 2, 2 * _ROUNDING + 5)[1:-1]
    turns = _turns()
    rings = [
        np.column_stack([np.cos(up) * np.cos(turns), np.cos(up) * np.sin(turns), np.full(AROUND, np.sin(up))])
        for up in ups
    ]
    return _closed(np.array(rings) * np.asarray(half) + np.asarray(middle), tips=(-half[2], half[2]))


def mirrored(outline: Outline) -> Outline:
    """Return the outline as a mirror shows it that stands at y = 0."""
    return Outline(outline.points * [1.0, -1.0, 1.0], outline.faces[:, ::-1].copy())


def joined(outlines: Sequence[Outline]) -> Outline:
    """Return several outlines as one."""
    starts = np.cumsum([0, *(len(outline.points) for outline in outlines[:-1])])
    faces = [outline.faces + start for outline, start in zip(outlines, starts, strict=True)]
    return Outline(np.concatenate([outline.points for outline in outlines]), np.concatenate(faces).astype(np.int32))


def _turns() -> Floats:
    turns: Floats = np.arange(AROUND, dtype=np.float64) * (2 * np.pi / AROUND)
    return turns


def _bent(rows: Floats) -> Floats:
    """Return more rows, on a curve through the given ones (Catmull-Rom)."""
    padded = np.concatenate([[2 * rows[0] - rows[1]], rows, [2 * rows[-1] - rows[-2]]])
    curve = [rows[0]]
    for index in range(len(rows) - 1):
        a, b, c, d = padded[index : index + 4]
        for part in np.linspace(0.0, 1.0, _BETWEEN + 1)[1:]:
            linear, square, cube = (c - a) * part, (2 * a - 5 * b + 4 * c - d) * part**2, (3 * b - a - 3 * c + d)
            curve.append((2 * b + linear + square + cube * part**3) / 2)
    return np.array(curve)


def _tangents(points: Floats) -> Floats:
    steps: Floats = np.diff(points, axis=0)
    steps /= np.linalg.norm(steps, axis=1)[:, None]
    along: Floats = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    return np.asarray(along / np.linalg.norm(along, axis=1)[:, None], np.float64)


def _end(shape: Floats, rounding: float | None, points: Floats) -> float:
    """Return the radius of a rounded end, which fits into the section and the rod."""
    length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
    # A section that shrinks to a line would leave triangles without area.
    most = min(float(shape[0]) * 0.98, float(shape[1]) * 0.98, length / 2)
    return most if rounding is None else min(rounding, most)


def _quarter(radius: float) -> list[tuple[float, float]]:
    """Return a quarter of a circle: steps outwards along the rod, and by how much the section shrinks there."""
    angles = np.linspace(0.0, np.pi / 2, _ROUNDING)
    return [(radius * float(np.sin(angle)), radius * (1 - float(np.cos(angle)))) for angle in angles]


def _section(point: Floats, shape: Floats, tangent: Floats, across: int, swapped: bool) -> Floats:
    """Return the corners of a cross-section, counterclockwise around the tangent.

    Args:
        point: Its middle.
        shape: Two half sizes and the power.
        tangent: Direction of the rod.
        across: Axis of the frame that one side of the section follows: 0, 1 or 2.
        swapped: True if this side has the second half size.
    """
    right = np.eye(3)[across] - tangent * tangent[across]
    right /= np.linalg.norm(right)
    up = np.cross(tangent, right)
    width, height, power = float(shape[0]), float(shape[1]), max(float(shape[2]), 1.0)
    if swapped:
        width, height = height, width
    cos, sin = np.cos(_turns()), np.sin(_turns())
    reach = (np.abs(cos) ** power + np.abs(sin) ** power) ** (-1 / power)
    corners: Floats = point + np.outer(cos * reach * width, right) + np.outer(sin * reach * height, up)
    return corners


def _across(points: Floats, tangents: Floats) -> tuple[int, bool]:
    """Return the axis of the frame that is nearest to perpendicular to the whole rod, and True if it is the second
    of the two axes that are not the rod's."""
    main = int(np.argmax(np.abs(points[-1] - points[0]).round(9)))
    others = [axis for axis in range(3) if axis != main]
    across = min(others, key=lambda axis: float(np.abs(tangents[:, axis]).max()))
    return across, across == others[1]


def _closed(rings: Floats, tips: tuple[float, float] | None = None) -> Outline:
    """Return the surface through rings of corners, closed at both ends by a fan of triangles."""
    count, around, _ = rings.shape
    ends = rings[0].mean(axis=0), rings[-1].mean(axis=0)
    if tips is not None:
        middle = rings.reshape(-1, 3).mean(axis=0)
        ends = middle + np.array([0.0, 0.0, tips[0]]), middle + np.array([0.0, 0.0, tips[1]])
    points = np.concatenate([rings.reshape(-1, 3), ends])
    first, last = count * around, count * around + 1
    here = np.arange(around)
    there = (here + 1) % around
    faces: list[Any] = []
    for ring in range(count - 1):
        a, b = ring * around + here, ring * around + there
        faces += [np.column_stack([a, b, b + around]), np.column_stack([a, b + around, a + around])]
    faces.append(np.column_stack([np.full(around, first), there, here]))
    top = (count - 1) * around
    faces.append(np.column_stack([np.full(around, last), top + here, top + there]))
    return _without_slivers(Outline(points, np.concatenate(faces).astype(np.int32)))


def _without_slivers(outline: Outline) -> Outline:
    """Return the outline with corners at the same place joined, and without triangles that have no area."""
    points, index = np.unique(outline.points.round(7), axis=0, return_inverse=True)
    faces = index.reshape(-1)[outline.faces]
    a, b, c = faces.T
    kept = faces[(a != b) & (b != c) & (c != a)]
    return Outline(points, kept.astype(np.int32))
