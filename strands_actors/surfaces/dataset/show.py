"""Describe the contents and the defects of a dataset. Nothing is changed."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import msgspec

from .check import check
from .episode import Episode, Quality
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
    defects: str = msgspec.field(name="marks")  # The defects of the episode as text. Empty if there are no defects.
    damaged: str = ""  # Why the episode cannot be used. If so, `frames` is the number of readable frames.


class Shown(msgspec.Struct, frozen=True):
    dataset: str
    robot_type: str
    fps: int | float
    joints: list[str]
    cameras: dict[str, str]  # Size and codec of each camera's pictures, as text.
    total_episodes: int
    total_frames: int
    bytes: int
    episodes: list[ShownEpisode]
    good: list[int]  # Episodes without defects. Use them for training, with LeRobot's option --dataset.episodes.
    # Files of no episode that LeRobot would read nevertheless. `repair` moves them to .staging.
    stray_files: list[str] = msgspec.field(name="uncounted")
    strange: list[str]  # Files of no episode, with names of another form. `repair` does not move them.
    unfinished: list[Unfinished]
    version: str = VERSION
    damaged: list[int] = []  # Numbers of the episodes that cannot be used.
    faults: list[str] = []  # Defects that concern the whole dataset.


def show(root: Path) -> Shown:
    """Read every file of the dataset's episodes, and describe the dataset.

    Raises:
        DatasetError: The folder has no usable ``info.json``.
    """
    require_dataset(root)
    index = Index(root)
    result = check(index)
    info = index.info
    fps = info.fps if info else 0.0
    strays = [path.relative_to(root) for path in index.stray_files()]
    rows = {episode.index: episode for episode in index.episodes}
    episodes = []
    for number in sorted(rows.keys() | result.damaged.keys()):
        episode = rows.get(number, Episode(number, "", 0, Quality()))
        frames = result.frames.get(number, 0)
        episodes.append(
            ShownEpisode(
                number,
                episode.task,
                frames,
                round(frames / fps, 3) if fps else 0.0,
                episode.quality.gaps,
                episode.quality.stale,
                episode.quality.repaired,
                episode.quality.began,
                episode.quality.as_text,
                result.damaged.get(number, ""),
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
        sum(episode.frames for episode in episodes),
        _bytes(root),
        episodes,
        [episode.episode for episode in episodes if not episode.defects and not episode.damaged],
        [str(path) for path in strays if is_own_name(path)],
        [str(path) for path in strays if not is_own_name(path)],
        unfinished_in(root),
        info.codebase_version if info else VERSION,
        sorted(result.damaged),
        result.faults,
    )


def as_shown(number: float) -> int | float:
    """Return a whole number as an int, and another number unchanged."""
    return int(number) if number == int(number) else number


def _camera(feature: Feature) -> str:
    height, width = feature.height_width
    return f"{width}x{height} {feature.codec}"


def _bytes(root: Path) -> int:
    """Return the total size of all files outside the staging folder. Broken links, and files that a running
    recorder removes meanwhile, do not count."""
    total = 0
    for folder, below, names in os.walk(root):
        below[:] = [name for name in below if name != STAGING.name]
        for name in names:
            with contextlib.suppress(OSError):
                total += os.stat(os.path.join(folder, name)).st_size
    return total
