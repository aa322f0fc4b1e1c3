"""Describe the contents and the defects of a dataset. Nothing is changed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import msgspec

from .check import check
from .episode import Episode, Marks
from .index import Index
from .info import VERSION, Feature
from .layout import ACTION, CAMERA, STAGING, is_own_name
from .repair import Unfinished, require_dataset, unfinished_in


class ShownEpisode(msgspec.Struct, frozen=True):
    episode: int
    task: str
    frames: int
    seconds: float
    gaps: int
    late: dict[str, int]
    repaired: bool
    began: str
    marks: str  # its defects in words; empty if there are no defects
    damaged: str = ""  # why it cannot be used; then `frames` counts the readable ones


class Shown(msgspec.Struct, frozen=True):
    dataset: str
    robot_type: str
    fps: int | float
    joints: list[str]
    cameras: dict[str, str]  # size and codec
    total_episodes: int
    total_frames: int
    bytes: int
    episodes: list[ShownEpisode]
    good: list[int]  # episodes without defects: train on these, --dataset.episodes
    uncounted: list[str]  # files that LeRobot would read although they are not counted; `repair` puts them aside
    strange: list[str]  # the same with other names than ours; they are never touched
    unfinished: list[Unfinished]
    version: str = VERSION
    damaged: list[int] = []  # episodes that cannot be used
    faults: list[str] = []  # defects of the whole dataset


def show(root: Path) -> Shown:
    """Open every file of the counted episodes, and describe the dataset.

    Raises:
        DatasetError: It has no usable ``info.json``.
    """
    require_dataset(root)
    index = Index(root)
    found = check(index)
    info = index.info
    fps = info.fps if info else 0.0
    uncounted = [path.relative_to(root) for path in index.uncounted()]
    rows = {one.index: one for one in index.episodes}
    episodes = []
    for number in sorted(rows.keys() | found.damaged.keys()):
        one = rows.get(number, Episode(number, "", 0, Marks()))
        frames = found.frames.get(number, 0)
        episodes.append(
            ShownEpisode(
                number,
                one.task,
                frames,
                round(frames / fps, 3) if fps else 0.0,
                one.marks.gaps,
                one.marks.stale,
                one.marks.repaired,
                one.marks.began,
                one.marks.told,
                found.damaged.get(number, ""),
            )
        )
    action = info.features.get(ACTION) if info else None
    return Shown(
        str(root),
        (info.robot_type if info else None) or "",
        as_shown(fps),
        action.flat_names if action else [],
        {key.removeprefix(CAMERA): _camera(info.features[key]) for key in info.videos} if info else {},
        len(episodes),
        sum(one.frames for one in episodes),
        _bytes(root),
        episodes,
        [one.episode for one in episodes if not one.marks and not one.damaged],
        [str(path) for path in uncounted if is_own_name(path)],
        [str(path) for path in uncounted if not is_own_name(path)],
        unfinished_in(root),
        info.codebase_version if info else VERSION,
        sorted(found.damaged),
        found.faults,
    )


def as_shown(number: float) -> int | float:
    """Return a whole number as an int, and any other unchanged."""
    return int(number) if number == int(number) else number


def _camera(feature: Feature) -> str:
    height, width = feature.height_width
    return f"{width}x{height} {feature.codec}"


def _bytes(root: Path) -> int:
    """Return the size of all files. A file may vanish meanwhile (a recorder runs), and a link may be
    broken."""
    total = 0
    for folder, below, names in os.walk(root):
        below[:] = [name for name in below if name != STAGING.name]
        for name in names:
            with contextlib.suppress(OSError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total
