"""Read the table of a robot's links: one row of text per moving link. Pure, without MuJoCo, so that a process of a
real robot may read it.

    body parent joint axis xyz rot lo,hi effort velocity kg com geom

``-`` leaves a column at its default. Units: metres, radians, newton metres, radians per second, kilograms.

``joint``   ``-``: the link is welded to its parent
``axis``    ``x``, ``y`` or ``z``; ``-`` in front reverses it, ``s`` makes it a slide: ``-y``, ``sz``
``xyz``     the link's origin in its parent
``rot``     ``0``, or ``r,p,y`` in degrees about the parent's fixed axes (URDF), or ``q:w,x,y,z``
``effort``  ``-``: a passive joint
``com``     the mass is a point there; without it the mass fills the shape
``geom``    ``cR@x,y,z`` capsule from the origin to a point (default: the first child), ``bX,Y,Z@x,y,z`` box
            of half sizes about a point, ``sR`` sphere, ``yR,H`` cylinder of half height H
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from strands_actors.contract import rotations


class Row(NamedTuple):
    """One link of a robot model: a row of the table, parsed."""

    body: str
    parent: str
    joint: str | None
    axis: tuple[float, float, float]
    slide: bool
    xyz: tuple[float, ...]
    quat: tuple[float, ...]
    limits: tuple[float, float] | None
    effort: float | None
    velocity: float | None
    kg: float
    com: tuple[float, ...] | None
    geom: str | None


def with_limits(links: str, limits_of: Callable[[str], str]) -> str:
    """Add the columns range, effort and velocity to rows that lack them.

    A robot's table gives these values with its joints, so its rows need not repeat them.

    Args:
        links: Rows without these three columns.
        limits_of: Return the three columns of a joint, by its key.
    """
    rows = []
    for line in links.splitlines():
        if line.strip():
            body, parent, key, axis, xyz, rot, kg, com, geom = line.split()
            rows.append(f"{body} {parent} {key} {axis} {xyz} {rot} {limits_of(key)} {kg} {com} {geom}")
    return "\n".join(rows)


def numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))


def quaternion(text: str) -> tuple[float, ...]:
    """Return the quaternion w, x, y, z for the text of a ``rot`` column."""
    if text in ("0", "-"):
        return (1.0, 0.0, 0.0, 0.0)
    if text.startswith("q:"):
        return numbers(text[2:])
    roll, pitch, yaw = map(math.radians, numbers(text))
    return rotations.quaternion(roll, pitch, yaw)


def parse_row(line: str) -> Row:
    """Parse one line of the table.

    Raises:
        ValueError: A column is missing or is not a number. The exception's text has the line.
    """
    columns = line.split()
    if len(columns) != 12:
        raise ValueError(f"a model row must have 12 columns, not {len(columns)}: {line}")
    cells: list[str | None] = [None if column == "-" else column for column in columns]
    body, parent, joint, axis, xyz, rot, limits, effort, velocity, kg, com, geom = cells
    sign = -1.0 if axis and "-" in axis else 1.0
    letter = axis[-1] if axis else "z"
    if body is None or parent is None or letter not in "xyz":
        raise ValueError(f"a model row needs a body, a parent and an axis of x, y or z: {line}")
    ends = numbers(limits) if limits else None
    return Row(
        body=body,
        parent=parent,
        joint=joint,
        axis=(sign * (letter == "x"), sign * (letter == "y"), sign * (letter == "z")),
        slide=bool(axis and "s" in axis),
        xyz=numbers(xyz) if xyz else (0.0, 0.0, 0.0),
        quat=quaternion(rot or "0"),
        limits=(ends[0], ends[1]) if ends else None,
        effort=float(effort) if effort else None,
        velocity=float(velocity) if velocity else None,
        kg=float(kg) if kg else 0.01,
        com=numbers(com) if com else None,
        geom=geom,
    )


def parse_rows(text: str) -> list[Row]:
    return [parse_row(line) for line in text.splitlines() if line.strip()]
