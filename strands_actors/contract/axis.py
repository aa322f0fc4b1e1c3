"""Describe a robot's axes as data. An axis is one number of an action, with its unit, range and speed.

A driver declares parts, and each part has axes. Names, parsing, range and speed gates, the JSON of
``send_action``, tool schemas and dataset features are all derived from this table.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.kernel.messages import Refused

from . import refusals
from .shown import SHOWN, shown


class AxisMode(enum.StrEnum):
    """The meaning of an axis' number: a position or a speed."""

    POSITION = "position"  # the value is a position; an axis that an action does not name keeps its target
    VELOCITY = "velocity"  # the value is a speed; an axis that an action does not name gets its rest value


class PartKind(enum.StrEnum):
    """The kind of a group of axes, with the names that Viam and LeRobot use."""

    ARM = "arm"
    GRIPPER = "gripper"
    BASE = "base"
    HEAD = "head"
    TORSO = "torso"
    LEGS = "legs"
    DRONE = "drone"


class Axis(msgspec.Struct, frozen=True, kw_only=True):
    """One number of an action.

    Attributes:
        key: The name of the axis.
        unit: The unit of the value, of the range, and of the speed (per second).
        low: Lowest value.
        high: Highest value.
        speed: Largest change of the value in a second; infinite if there is no limit.
        mode: Whether the value is a position or a speed.
        rest: The value that a velocity axis gets when an action does not name it.
        sign: The number on the wire is ``sign`` times the value.
        id: Number of the motor, joint or register in the robot's protocol.
        optional: True if some robots of this type lack the axis. Its position is NaN there.
    """

    key: str
    unit: str
    low: float
    high: float
    speed: float = math.inf
    mode: AxisMode = AxisMode.POSITION
    rest: float = 0.0
    sign: float = 1.0
    id: int = 0
    optional: bool = False

    @property
    def label(self) -> str:
        """The name of the axis and the number of its motor, to show to people."""
        return f"{self.key} (id {self.id})"

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest value, in the unit of the axis."""
        return self.low, self.high


class Part(msgspec.Struct, frozen=True):
    """A group of axes. ``name`` distinguishes two parts of one kind (left, right)."""

    kind: PartKind
    axes: tuple[Axis, ...]
    name: str = ""


def axes_of(parts: Sequence[Part]) -> tuple[Axis, ...]:
    """Return the axes of all parts, in order.

    Raises:
        ValueError: Two axes have the same key.
    """
    axes = tuple(axis for part in parts for axis in part.axes)
    keys = [axis.key for axis in axes]
    if twice := sorted({key for key in keys if keys.count(key) > 1}):
        raise ValueError(f"two axes are called {', '.join(twice)}. Give each axis another key")
    return axes


def first_target(axes: Sequence[Axis], measured: Sequence[float]) -> tuple[float, ...]:
    """Return the first target of a robot whose motors were just energised.

    The target of a position axis is its measured position, so that the robot does not jump. Velocity axes get their
    rest value.

    Args:
        axes: The axes.
        measured: The measured value of each axis, in the same order.
    """
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
    """Return the target of every axis, and the indices of the axes that the action names.

    The keys ``x`` and ``x.pos`` name the same axis. An action must not contain both.

    Args:
        action: Values by key.
        robot: The robot's name, for refusals.
        axes: The axes.
        index: The index of each key in ``axes``.
        target: The present target. A position axis that the action does not name keeps it.
    """
    keys = ", ".join(index)
    if not action:
        return refusals.empty_action(keys)
    values = list(target)
    for i, axis in enumerate(axes):
        if axis.mode is AxisMode.VELOCITY:
            values[i] = axis.rest
    named: list[int] = []
    for key, value in action.items():
        axis_index = index.get(key.removesuffix(".pos")) if isinstance(key, str) else None
        if axis_index is None:
            text = str(key)[:SHOWN] or "''"
            return refusals.unknown_joint(text, robot, keys)
        name = axes[axis_index].key
        if axis_index in named:
            return refusals.both_spellings(name)
        number = finite(value)
        if number is None:
            return refusals.not_finite(name, shown(value, SHOWN), _not_a_number(value))
        values[axis_index] = number
        named.append(axis_index)
    return tuple(values), tuple(named)


def _not_a_number(value: object) -> str:
    """Describe a value that is not a number, for the text of a refusal.

    A text that looks like a number is called a text.
    """
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
    """Return the value as a finite float; None if it is a text, a bool, infinite, NaN or too large."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) else None
