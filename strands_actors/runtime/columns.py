"""Actions by column: how a stream's action travels that gives every axis the same few numbers.

A policy says ``{"left_hip": {"q": 0.1, "kp": 60.0}, ...}``. Five hundred times a second that is a dict an axis to
be made, and the same words each time. By column it is ``{"q": (0.1, ...), "kp": (60.0, ...)}``, one number an axis
in the order of the driver's axes: 60 % of the bytes, a fifth of the time to read. Only the tree speaks so, to
itself: who commands a robot names its axes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from operator import itemgetter
from typing import Any

Columns = Mapping[str, tuple[float, ...]]
"""By the name of a number: one for each axis."""

_DICTS, _FLOATS = {dict}, {float}


def by_column(action: Mapping[str, Any]) -> dict[str, tuple[float, ...]] | None:
    """An action whose values are dicts with the same names, and plain floats. None: it is another one."""
    values = tuple(action.values())
    if set(map(type, values)) != _DICTS:
        return None
    names = tuple(values[0])
    if not names or sum(map(len, values)) != len(names) * len(values):
        return None
    try:
        columns = {name: tuple(map(itemgetter(name), values)) for name in names}
    except KeyError:
        return None
    return columns if all(set(map(type, column)) == _FLOATS for column in columns.values()) else None


def by_axis(columns: Columns, axes: Sequence[str]) -> dict[str, Any]:
    """The action that was meant. Of columns that are not as long as there are axes the rest is left out."""
    rows = zip(*columns.values(), strict=False)
    return {axis: dict(zip(columns, row, strict=True)) for axis, row in zip(axes, rows, strict=False)}
