"""Move a robot along an episode of a dataset, as it was told when that was recorded.

What is replayed is ``action``, at the dataset's rate. A dataset of ours says its units; one of
LeRobot's does not, so whoever replays it does: the robot's own, or ``normalized``, its arms' default
(-100 to 100 over a joint's calibrated range, the gripper 0 to 100). A number in the wrong unit is a
motion that nobody meant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import msgspec
import numpy as np
import pyarrow.compute as pc

from strands_actors.contract.driver import Driver
from strands_actors.contract.shown import shown
from strands_actors.policies.lerobot import Scale
from strands_actors.surfaces.recording.given import path_of

from .errors import DatasetError
from .index import Index
from .layout import ACTION
from .tables import integers, read_table, refuse_damage

NORMALIZED = "normalized"
SUFFIXES = (".pos", ".vel")


class Movable(Protocol):
    """A robot's handle in a script."""

    @property
    def driver(self) -> Driver: ...
    def move_along(self, rows: Sequence[Mapping[str, Any]], hz: float, wait: bool = True) -> dict[str, Any]: ...


class Played(msgspec.Struct, frozen=True):
    """What an episode tells a robot. ``units``: of each joint; empty: the dataset does not say."""

    joints: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[float, ...], ...]
    hz: float
    task: str


def replay_episode(
    robot: Movable, root: str | Path, episode: int = 0, *, units: str = "", wait: bool = True
) -> dict[str, Any]:
    """Move a robot along an episode: to its first action as ``move_to`` does, then as it was recorded.

    Args:
        robot: Its handle.
        root: The folder of the dataset.
        episode: Its number, from 0.
        units: Of the numbers, where the dataset does not say them: the robot's own, or ``normalized``.
        wait: Return when the motion is over. False: return at once.

    Returns:
        What ``move_along`` answers.

    Raises:
        DatasetError: The episode cannot be read, or is not in units of this robot.
    """
    played = read_episode(path_of("replay_episode", "root", root, DatasetError), episode)
    return robot.move_along(rows_for(robot.driver, played, units), played.hz, wait)


def read_episode(root: Path, episode: int) -> Played:
    """Read what an episode tells a robot. Raise ``DatasetError``."""
    index = Index(root)
    if index.info is None:
        raise DatasetError(f"{root}: there is no dataset")
    feature = index.info.features.get(ACTION)
    if feature is None or not feature.flat_names:
        raise DatasetError(f"{root}: it has no {ACTION} with the names of joints")
    row = index.rows.get(episode) if isinstance(episode, int) else None
    if row is None:
        lost = index.lost.get(episode)
        known = f"0 to {max(index.rows)}" if index.rows else "none"
        raise DatasetError(f"{root}: there is no episode {shown(episode)} ({lost or f'there are {known}'})")
    pictures = [key for key, each in index.info.features.items() if each.dtype == "image"]
    table = read_table(root / row.data, without=pictures)
    with refuse_damage(root / row.data):
        table = table.filter(pc.equal(table["episode_index"], row.number)).combine_chunks()
        order = integers(table, "frame_index") if "frame_index" in table.column_names else np.arange(table.num_rows)
        values = np.array(table[ACTION].to_pylist(), dtype=np.float64)
    if values.shape != (row.frames, len(feature.flat_names)) or not (order == np.arange(row.frames)).all():
        raise DatasetError(
            f"{root}: episode {row.number} is damaged. `strands-actors dataset show {root}` says what is wrong"
        )
    joints = tuple(_joint(name) for name in feature.flat_names)
    rows = tuple(tuple(each) for each in values.tolist())
    return Played(joints, tuple(feature.flat_units), rows, float(index.info.fps), ", ".join(row.tasks))


def rows_for(driver: Driver, played: Played, units: str = "") -> list[dict[str, float]]:
    """Return the rows in the units of a robot. Raise ``DatasetError``."""
    strange = [joint for joint in played.joints if joint not in driver.axes]
    if strange:
        raise DatasetError(f"{driver.robot} has no joint {strange[0]}: the episode is of another robot")
    scale = None
    if played.units:
        _require_units(driver, played, units)
    else:
        scale = _scale(driver, played.joints, units)
    rows = played.rows if scale is None else [scale.from_lerobot(row) for row in played.rows]
    return [dict(zip(played.joints, row, strict=True)) for row in rows]


def _require_units(driver: Driver, played: Played, units: str) -> None:
    own = {axis.key: axis.unit for axis in driver.table}
    for joint, unit in zip(played.joints, played.units, strict=False):
        if unit != own.get(joint, unit):
            raise DatasetError(f"{joint} is recorded in {unit}, and {driver.robot} has {own[joint]}")
    if units and units not in (_own(driver), *played.units):
        raise DatasetError(
            f"units is {shown(units)}, and the dataset says {', '.join(dict.fromkeys(played.units))}"
        )


def _scale(driver: Driver, joints: Sequence[str], units: str) -> Scale | None:
    """None: the numbers are the robot's."""
    own = _own(driver)
    if units and units == own:
        return None
    if units != NORMALIZED:
        known = " or ".join(repr(each) for each in (own, NORMALIZED) if each)
        raise DatasetError(
            f"units is {shown(units)}, and the dataset does not say in which units it is. give units={known}"
        )
    travel = driver.travel()
    if missing := [joint for joint in joints if joint not in travel]:
        raise DatasetError(
            f"units={NORMALIZED!r} is a share of each joint's calibrated range, and there is none of "
            f"{', '.join(missing)}. give the robot calibration=, the file of the arm that recorded"
        )
    return Scale(joints, travel)


def _own(driver: Driver) -> str:
    """Return the robot's unit in one word, as policies are told it."""
    return driver.unit.partition(" ")[0].strip(",")


def _joint(name: str) -> str:
    suffix = next((each for each in SUFFIXES if name.endswith(each)), "")
    return name.removesuffix(suffix)


__all__ = ["Played", "read_episode", "replay_episode", "rows_for"]
