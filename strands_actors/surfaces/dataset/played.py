"""Move a robot along an episode of a dataset.

The robot gets the episode's ``action`` at the dataset's rate. Datasets of this package state their units.
Datasets of LeRobot state no units, so the caller must give them: the robot's units, or ``normalized``
(``policies.scale``). There is no default, because numbers in a wrong unit would move the robot to wrong
positions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import shown
from strands_actors.policies.scale import NORMALIZED, Scale, unit_word
from strands_actors.surfaces.recording.arguments import path_of

from .errors import DatasetError
from .index import Index
from .layout import ACTION
from .rows import frames_of
from .tables import integers, refuse_damage


class Movable(Protocol):
    """The members of a robot handle that a replay of an episode needs."""

    @property
    def driver(self) -> Driver: ...
    def move_along(self, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool = True) -> dict[str, Any]: ...


class Played(msgspec.Struct, frozen=True):
    """The commands of an episode.

    Attributes:
        joints: The joints' names in the driver.
        units: The unit of each joint. Empty if the dataset states no units.
        rows: One target per joint for each frame.
        hz: Frames per second.
        task: The task of the episode.
        robot_type: The robot, as in ``info.json``. Empty if it is not stated.
    """

    joints: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]
    hz: float
    task: str
    robot_type: str = ""


def replay_episode(
    robot: Movable, root: str | Path, episode: int = 0, *, units: str = "", wait: bool = True
) -> dict[str, Any]:
    """Move a robot along a recorded episode. The robot first moves to the first action, as with ``move_to``.

    Args:
        robot: The robot's handle.
        root: The folder of the dataset.
        episode: The number of the episode, from 0.
        units: The unit of the dataset's numbers, if the dataset does not state it. Give the robot's unit, or
            ``normalized``.
        wait: True to return when the motion has ended, False to return at once.

    Returns:
        The result of ``move_along``.

    Raises:
        DatasetError: The episode cannot be read, or its units are missing or not those of this robot.
    """
    played = read_episode(path_of("replay_episode", "root", root, DatasetError), episode)
    return robot.move_along(rows_for(robot.driver, played, units), played.hz, wait)


def read_episode(root: Path, episode: int) -> Played:
    """Read the commands of an episode.

    Raises:
        DatasetError: The episode does not exist, or it cannot be read.
    """
    index = Index(root)
    if index.info is None:
        raise DatasetError(f"{root} is not a dataset. Give the folder of a dataset")
    feature = index.info.features.get(ACTION)
    if feature is None or not feature.flat_names:
        raise DatasetError(f"{root} has no {ACTION} with names of joints, so it cannot be played")
    row = index.rows.get(episode) if isinstance(episode, int) else None
    if row is None:
        lost = index.lost.get(episode)
        numbers = f"0 to {max(index.rows)}" if index.rows else "none"
        raise DatasetError(f"{root}: there is no episode {shown(episode)} ({lost or f'there are {numbers}'})")
    pictures = [key for key, each in index.info.features.items() if each.dtype == "image"]
    table = frames_of(root, row, without=pictures)
    with refuse_damage(root / row.data):
        order = integers(table, "frame_index") if "frame_index" in table.column_names else np.arange(table.num_rows)
        values = np.array(table[ACTION].to_pylist(), dtype=np.float64)
    if values.shape != (row.frames, len(feature.flat_names)) or not (order == np.arange(row.frames)).all():
        raise DatasetError(
            f"{root}: episode {row.number} is damaged. See the damage with `strands-actors dataset show {root}`"
        )
    joints = tuple(_joint(name) for name in feature.flat_names)
    rows = tuple(tuple(each) for each in values.tolist())
    units = tuple(feature.flat_units)
    if len(units) != len(joints):
        units = ()
    return Played(joints, units, rows, float(index.info.fps), ", ".join(row.tasks), index.info.robot_type or "")


def rows_for(driver: Driver, played: Played, units: str = "") -> list[dict[str, float]]:
    """Return the episode's targets in the units of a robot.

    Args:
        driver: The robot's driver.
        played: The episode.
        units: The unit of the dataset's numbers, if the dataset does not state it.

    Raises:
        DatasetError: The episode is of another robot, or its units are missing or wrong.
    """
    strange = [joint for joint in played.joints if joint not in driver.axes]
    if strange:
        raise DatasetError(f"{driver.robot} has no joint {strange[0]}. Use the robot of this episode")
    scale = None
    if played.units:
        _require_units(driver, played, units)
    else:
        scale = _scale(driver, played.joints, units)
    rows = played.rows if scale is None else [scale.from_lerobot(row) for row in played.rows]
    return [dict(zip(played.joints, row, strict=True)) for row in rows]


def _require_units(driver: Driver, played: Played, units: str) -> None:
    own = {axis.key: axis.unit for axis in driver.table}
    for joint, unit in zip(played.joints, played.units, strict=True):
        if unit != own.get(joint, unit):
            raise DatasetError(f"{joint} was recorded in {unit}, but {driver.robot} uses {own[joint]}")
    if units and units not in (unit_word(driver.unit), *played.units):
        raise DatasetError(
            f"units is {shown(units)}, "
            f"but the dataset has {', '.join(dict.fromkeys(played.units))}. Leave units out"
        )


def _scale(driver: Driver, joints: Sequence[str], units: str) -> Scale | None:
    """Return the scale from normalized numbers to the robot's unit. None if the numbers have this unit already."""
    own = unit_word(driver.unit)
    if units and units == own:
        return None
    if units != NORMALIZED:
        accepted = " or ".join(repr(each) for each in (own, NORMALIZED) if each)
        raise DatasetError(f"units is {shown(units)}, and the dataset states no units. Give units={accepted}")
    try:
        return Scale(joints, driver.travel())
    except ValueError as missing:
        raise DatasetError(str(missing)) from None


def _joint(name: str) -> str:
    """Return the name of a joint in the driver, from its name in the dataset."""
    return name.removesuffix(".pos").removesuffix(".vel")


__all__ = ["Played", "read_episode", "replay_episode", "rows_for"]
