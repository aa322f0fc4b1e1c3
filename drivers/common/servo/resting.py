"""The options of a servo arm for the end of a program: its safe state, and the pose in which it rests.

A rest pose is a JSON file ``{joint: value}`` in lerobot's folder of calibrations, beside the folders of robots and
of leaders. ``strands-actors rest`` writes it. Only the process of the user's script reads it.
"""

from __future__ import annotations

import enum
import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from strands_actors.contract.axis import finite
from strands_actors.contract.driver import Reason
from strands_actors.contract.safe_state import SafeState
from strands_actors.drivers.common.kit import calibration as lerobot

from .axes import Axis
from .calibrating import Person
from .setup import Setup

RESTS = "rest"
"""Folder of the rest poses."""

LOWER_S = 2.8
LOWERINGS_S = (0.5, 10.0)
"""Shortest and longest time for a lowering."""
CONFIRM_S = 2.0
"""Time to confirm that the torque is off, after a lowering, with a margin."""


class OnExit(enum.StrEnum):
    """What an arm does when it is stopped without hurry."""

    LOWER = "lower"
    LIMP = "limp"
    HOLD = "hold"

    @property
    def safe_state(self) -> SafeState:
        return _SAFE_STATES[self]


_SAFE_STATES = {OnExit.LOWER: SafeState.LOWERED, OnExit.LIMP: SafeState.LIMP, OnExit.HOLD: SafeState.HOLD}

USUAL = OnExit.LOWER
"""What an arm does that can be lowered. Any other robot is limp."""

WITHOUT_HURRY = (Reason.STOP, Reason.CLEANUP, Reason.CALLER)
"""The reasons of a stop that ``on_exit`` decides about. After all others the torque is switched off at once,
because something is broken or a person is in danger."""


def on_exit_of(robot: str, value: object, lowers: bool) -> OnExit:
    """Return the option ``on_exit``.

    Args:
        robot: The robot's name.
        value: The option; None for the usual one.
        lowers: True if the robot is an arm that can be lowered.

    Raises:
        ValueError: The value is not accepted.
    """
    accepted = [OnExit.LOWER, OnExit.LIMP, OnExit.HOLD] if lowers else [OnExit.LIMP, OnExit.HOLD]
    if value is None:
        return USUAL if lowers else OnExit.LIMP
    if not isinstance(value, str) or value not in accepted:
        raise ValueError(f"{robot}: on_exit is {value!r}. Use one of {', '.join(accepted)}")
    return OnExit(value)


def rest_file(types: Iterable[str], robot_id: str) -> Path:
    """Return the path of the rest pose of one robot. Raise ``ValueError`` if the id cannot be the name of a
    file."""
    lerobot.require_id(robot_id)
    return lerobot.folder() / RESTS / next(iter(types)) / f"{robot_id}.json"


def rest_of(robot: str, value: object, joints: Iterable[str], taught: Path | None) -> dict[str, float] | None:
    """Return the option ``rest`` as a value for each joint; None without a rest pose.

    Args:
        robot: The robot's name.
        value: The option: a pose, the path of a file, or None for the taught pose.
        joints: The names of all joints.
        taught: The file of the taught pose; None if the robot has no id.

    Raises:
        ValueError: The pose cannot be read, or does not name every joint with a number.
    """
    if isinstance(value, Mapping):
        return _pose(robot, value, joints, "rest")
    if isinstance(value, str | Path):
        return read(robot, Path(value).expanduser(), joints)
    if value is not None:
        raise ValueError(f"{robot}: rest is {value!r}. Give a pose (a value for each joint), a path or None")
    return None if taught is None or not taught.is_file() else read(robot, taught, joints)


def read(robot: str, path: Path, joints: Iterable[str]) -> dict[str, float]:
    """Return the rest pose in a file. Raise ``ValueError`` if it cannot be read, or does not name every joint."""
    try:
        content = json.loads(lerobot.text_of(path))
    except (OSError, ValueError, RecursionError) as failure:
        raise ValueError(
            f"{robot}: the rest pose {path} cannot be read ({failure}). Teach it again: "
            f"`strands-actors rest {robot} --teach`"
        ) from None
    return _pose(robot, content, joints, f"the rest pose {path}")


def _pose(robot: str, content: object, joints: Iterable[str], label: str) -> dict[str, float]:
    names = tuple(joints)
    if not isinstance(content, Mapping):
        raise ValueError(f"{robot}: {label} is {content!r}. Give a value for each joint: {', '.join(names)}")
    values = {str(key).removesuffix(".pos"): finite(value) for key, value in content.items()}
    for key in values:
        if key not in names:
            raise ValueError(f"{robot}: {label} names {key!r}, which is no joint. It has {', '.join(names)}")
    pose: dict[str, float] = {}
    for name in names:
        number = values.get(name)
        if number is None:
            raise ValueError(f"{robot}: {label} has no number for {name}. Give one for each of {', '.join(names)}")
        pose[name] = number
    return pose


def rest_counts(robot: str, pose: Mapping[str, float], axes: Iterable[Axis]) -> dict[int, int]:
    """Return the goal of each servo in the rest pose, in counts by id.

    Raises:
        ValueError: A joint cannot go there.
    """
    counts = {}
    for axis in axes:
        low, high = axis.limits
        if not low <= pose[axis.key] <= high:
            raise ValueError(
                f"{robot}: rest has {pose[axis.key]:g} {axis.unit} for {axis.key}, which goes from {low:.1f} to "
                f"{high:.1f}. Give a pose inside the range"
            )
        counts[axis.id] = axis.count(pose[axis.key])
    return counts


async def teach(setup: Setup[Any], person: Person) -> dict[str, float]:
    """Switch the torque off, let a person lay the arm down, and return the pose, a value for each joint.

    Raises:
        WireDown: A servo does not answer.
    """
    await setup.open()
    await person.ready("lay the arm down by hand as it should rest")
    positions = await setup.positions()
    pose = {}
    for axis in setup.axes:
        low, high = axis.limits
        # A joint may rest a little beyond its calibrated range, and no goal may be there.
        pose[axis.key] = round(min(max(axis.value(positions[axis.key]), low), high), 2)
    return pose
