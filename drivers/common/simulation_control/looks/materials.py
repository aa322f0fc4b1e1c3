"""Colours and finishes of a robot's parts, by name."""

from __future__ import annotations

from typing import NamedTuple


class Material(NamedTuple):
    """The colour (red, green, blue, from 0 to 1) of a part and how it shines. ``alpha`` below 1 is transparent."""

    red: float
    green: float
    blue: float
    specular: float = 0.3
    shininess: float = 0.4
    alpha: float = 1.0


MATERIALS: dict[str, Material] = {
    "white": Material(0.93, 0.93, 0.92),
    "pearl": Material(0.82, 0.83, 0.85),
    "silver": Material(0.70, 0.72, 0.75, 0.6, 0.6),
    "steel": Material(0.52, 0.55, 0.59, 0.7, 0.7),
    "grey": Material(0.42, 0.44, 0.47),
    "graphite": Material(0.20, 0.22, 0.25, 0.35, 0.5),
    "black": Material(0.085, 0.09, 0.10, 0.45, 0.5),
    "rubber": Material(0.07, 0.07, 0.075, 0.1, 0.1),
    "screen": Material(0.03, 0.04, 0.06, 0.9, 0.9),
    "orange": Material(0.97, 0.45, 0.09),
    "amber": Material(0.98, 0.68, 0.10),
    "yellow": Material(0.98, 0.78, 0.08),
    "red": Material(0.80, 0.13, 0.12),
    "blue": Material(0.16, 0.42, 0.78),
    "sky": Material(0.45, 0.68, 0.88),
    "teal": Material(0.10, 0.55, 0.56),
    "green": Material(0.25, 0.62, 0.32),
    "board": Material(0.06, 0.22, 0.16, 0.5, 0.6),
    "brass": Material(0.80, 0.62, 0.28, 0.8, 0.7),
    "lamp": Material(0.62, 0.90, 1.0, 0.9, 0.9),
    "blade": Material(0.10, 0.10, 0.11, 0.3, 0.4, 0.85),
    "cord": Material(0.14, 0.14, 0.15, 0.1, 0.2),
}
"""Every material that a table of looks may name."""
