"""What is in a dataset, and what is wrong with it. Touches nothing."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import Any

import msgspec

from .dataset import Index
from .layout import STAGING, is_own_name
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
    marks: str  # all of these in words; empty: nothing is wrong


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
    good: list[int]  # with nothing wrong: what to train on, --dataset.episodes
    uncounted: list[str]  # what LeRobot would read though nothing counts it, and `repair` puts aside
    strange: list[str]  # the same, under names that are not ours: nobody touches it
    unfinished: list[Unfinished]


def show(root: Path) -> Shown:
    """Raise ``DatasetError`` when there is none, or it is damaged."""
    require_dataset(root)
    index = Index(root)
    info = index.info or {"fps": 0, "features": {}}
    fps = as_shown(info["fps"])
    uncounted = [path.relative_to(root) for path in index.uncounted()]
    episodes = [
        ShownEpisode(
            one.index,
            one.task,
            one.frames,
            round(one.frames / fps, 3) if fps else 0.0,
            one.marks.gaps,
            one.marks.stale,
            one.marks.repaired,
            one.marks.began,
            one.marks.told,
        )
        for one in index.episodes
    ]
    return Shown(
        str(root),
        info.get("robot_type") or "",
        fps,
        list(info["features"].get("action", {}).get("names") or []),
        {key.removeprefix("observation.images."): _camera(info["features"][key]) for key in index.videos},
        len(episodes),
        index.frames,
        _bytes(root),
        episodes,
        [one.episode for one in episodes if not one.marks],
        [str(path) for path in uncounted if is_own_name(path)],
        [str(path) for path in uncounted if not is_own_name(path)],
        unfinished_in(root),
    )


def as_shown(number: float) -> int | float:
    """Return a whole number as one."""
    return int(number) if number == int(number) else number


def _camera(feature: dict[str, Any]) -> str:
    size = dict(zip(feature.get("names") or ("height", "width", "channels"), feature["shape"], strict=False))
    height, width = size.get("height", feature["shape"][0]), size.get("width", feature["shape"][1])
    return f"{width}x{height} {(feature.get('info') or {}).get('video.codec', '')}"


def _bytes(root: Path) -> int:
    """Of all files. A recorder beside us may take some away."""
    total = 0
    for folder, below, names in os.walk(root):
        below[:] = [name for name in below if name != STAGING.name]
        for name in names:
            with contextlib.suppress(FileNotFoundError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total
