"""Axes as data: what a robot can be told, in which unit, and how far and how fast.

Names, parsing, range and speed gates, the JSON of ``send_action``, tool schemas and dataset
features are all derived from this one table. A driver declares parts; each part has axes.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.kernel.messages import Refused
from strands_actors.kernel.refusals import Code

from .shown import shown

SHOWN = 40
"""Characters of a key or value that a refusal shows."""


class AxisMode(enum.StrEnum):
    """What the number of an axis means."""

    POSITION = "position"  # where to go; an axis that an action does not name keeps its target
    VELOCITY = "velocity"  # how fast to move; an axis that an action does not name rests


class PartKind(enum.StrEnum):
    """What a group of axes is, as Viam and LeRobot name components."""

    ARM = "arm"
    GRIPPER = "gripper"
    BASE = "base"
    HEAD = "head"
    TORSO = "torso"
    LEGS = "legs"
    DRONE = "drone"


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """One number of an action. ``low``, ``high`` and ``speed`` are in ``unit``; ``speed`` is what
    the axis may change in a second: its velocity, or of a velocity axis its acceleration; infinite:
    no limit."""

    key: str
    unit: str
    low: float
    high: float
    speed: float = math.inf
    mode: AxisMode = AxisMode.POSITION
    rest: float = 0.0  # of a velocity axis: what it does when nobody commands it
    sign: float = 1.0  # number on the wire = sign * value
    id: int = 0  # of its motor, joint or register on the wire
    optional: bool = False  # not every robot of this name has it; without it, it reads NaN

    @property
    def label(self) -> str:
        """Name the axis and its motor, for people."""
        return f"{self.key} (id {self.id})"

    @property
    def limits(self) -> tuple[float, float]:
        return self.low, self.high


class Part(msgspec.Struct, frozen=True):
    """A group of axes that belong together."""

    kind: PartKind
    axes: tuple[Axis, ...]
    name: str = ""  # where a robot has two of a kind: left, right


def axes_of(parts: Sequence[Part]) -> tuple[Axis, ...]:
    """Return the axes of all parts, in order. Raise ``ValueError`` when two have one key."""
    axes = tuple(axis for part in parts for axis in part.axes)
    keys = [axis.key for axis in axes]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise ValueError(f"axes: two are called {', '.join(twice)}")
    return axes


def first_target(axes: Sequence[Axis], measured: Sequence[float]) -> tuple[float, ...]:
    """Return the target from which a robot that was just armed goes on: the measured position, so
    that nothing jumps, and for velocity axes rest, so that nothing drives off."""
    return tuple(
        axis.rest if axis.mode is AxisMode.VELOCITY else value for axis, value in zip(axes, measured, strict=True)
    )


def parse_action(
    action: Mapping[str, object],
    robot: str,
    axes: Sequence[Axis],
    index: Mapping[str, int],
    target: Sequence[float],
) -> tuple[tuple[float, ...], tuple[int, ...]] | Refused:
    """Return the whole target and the indices of the axes that ``action`` names.

    ``x`` and ``x.pos`` name the same axis: not both at once. A position axis that is not named
    keeps its target, a velocity axis that is not named rests. ``index``: position of each key in
    ``axes``.
    """
    keys = ", ".join(index)
    if not action:
        return Refused(Code.EMPTY, "the action names no joint", f"use {keys}", "{}", keys)
    values = list(target)
    for at, axis in enumerate(axes):
        if axis.mode is AxisMode.VELOCITY:
            values[at] = axis.rest
    named: list[int] = []
    for key, value in action.items():
        found = index.get(key.removesuffix(".pos")) if isinstance(key, str) else None
        if found is None:
            said = str(key)[:SHOWN] or "''"
            return Refused(Code.UNKNOWN_JOINT, f"{said} is not a joint of {robot}", f"use {keys}", said, keys)
        name = axes[found].key
        if found in named:
            both = f"{name} and {name}.pos"
            return Refused(Code.BOTH_SPELLINGS, f"{both} are both given", "send one of them", both, name)
        number = finite(value)
        if number is None:
            why = f"{name} is {_not_a_number(value)}"
            return Refused(Code.NOT_FINITE, why, "send a finite number", shown(value, SHOWN), "a finite number")
        values[found] = number
        named.append(found)
    return tuple(values), tuple(named)


def _not_a_number(value: object) -> str:
    """Return what came in place of a number. A text that reads like one, or like nothing, is said to
    be a text; others speak for themselves, and may be what an object was written out as."""
    if value is None:
        return "None, as JSON also has what is infinite or not a number"
    if not isinstance(value, str):
        return shown(value, SHOWN)
    try:
        float(value or "0")
    except ValueError:
        return value[:SHOWN]
    return f"{shown(value, SHOWN)}, a text"


def finite(value: object) -> float | None:
    """Return ``value`` as a finite float, else None: text, a bool, infinite, not a number, too
    large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
