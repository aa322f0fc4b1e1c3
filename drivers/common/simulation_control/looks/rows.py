"""Read a table of looks: one row of text for each part.

    bodies material shape place...

``bodies``    names of bodies that get the part, with commas. ``~`` before a name mirrors the part at y = 0: a right
              leg has the parts of a left leg
``material``  a name in ``materials``
``shape``     ``rod``, ``can``, ``box`` or ``ball``
``place``     of a rod or can: two or more stations ``x,y,z:half`` or ``x,y,z:half,half,power``. A station without
              sizes has those of the station before it. The half sizes are in the order of the axes that are not the
              rod's; one half size makes a circle. ``power`` 2 is an ellipse, 6 almost a rectangle
              of a box: middle, half sizes, and the radius of its edges: ``0,0,.1 .05,.03,.02 .01``
              of a ball: middle, and one radius or three half sizes

All lengths are metres in the body's frame. A rod is smooth and has round ends. A can is straight between stations,
and its edges have the radius of a last word ``r.004``; without this word they are a little rounded. A rod may also
have this word. Lines that begin with # are comments.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from .materials import MATERIALS
from .outlines import Outline, Station, ball, box, mirrored, rod

EDGE = 0.2
"""Radius of a can's edges, as a share of its smallest half size."""


class Part(NamedTuple):
    """One part of one body."""

    body: str
    material: str
    outline: Outline


def parts(text: str) -> Iterator[Part]:
    """Yield the parts of a table of looks.

    Raises:
        ValueError: A row is wrong. The exception's text has the row.
    """
    for line in text.splitlines():
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            bodies, material, shape, *place = words
            if material not in MATERIALS:
                raise ValueError(f"there is no material {material}")
            outline = _outline(shape, place)
        except ValueError as wrong:
            raise ValueError(f"a row of looks is wrong ({wrong}): {line.strip()}") from None
        for body in bodies.split(","):
            yield Part(body.removeprefix("~"), material, mirrored(outline) if body.startswith("~") else outline)


def _outline(shape: str, place: list[str]) -> Outline:
    match shape:
        case "rod" | "can":
            rounding = float(place.pop()[1:]) if place[-1].startswith("r") else None
            stations = list(_stations(place))
            if rounding is None and shape == "can":
                rounding = EDGE * min(min(station.half) for station in stations)
            return rod(stations, rounding, smooth=shape == "rod")
        case "box":
            middle, half, rounding_text = place
            return box(_numbers(middle), _numbers(half), float(rounding_text))
        case "ball":
            middle, half = place
            sizes = _numbers(half)
            return ball(_numbers(middle), sizes if len(sizes) == 3 else sizes * 3)
    raise ValueError(f"there is no shape {shape}")


def _stations(words: list[str]) -> Iterator[Station]:
    sizes: tuple[float, ...] = ()
    for word in words:
        point, _, text = word.partition(":")
        sizes = _numbers(text) if text else sizes
        x, y, z = _numbers(point)
        match sizes:
            case (radius,):
                yield Station((x, y, z), (radius, radius))
            case (first, second):
                yield Station((x, y, z), (first, second))
            case (first, second, power):
                yield Station((x, y, z), (first, second), power)
            case _:
                raise ValueError(f"a station has 1 to 3 sizes: {word}")


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(part) for part in text.split(","))
