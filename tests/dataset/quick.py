"""Make episodes quickly: their camera has small pictures and a fast codec."""

from __future__ import annotations

from pathlib import Path

import msgspec

from strands_actors.surfaces.dataset.dataset import Dataset
from strands_actors.surfaces.dataset.layout import STAGING, CameraShape, Layout
from strands_actors.surfaces.dataset.staging import StagedEpisode

from .made import LAYOUT, begin, fill, row

UNITS = ("deg", "deg", "percent")
QUICK = msgspec.structs.replace(LAYOUT, cameras=(CameraShape("front", 16, 16),), codec="mpeg4", units=UNITS)


def begin_quick(dataset: Dataset, task: str = "put the cube down", layout: Layout = QUICK) -> StagedEpisode:
    return begin(dataset, task, layout)


def fill_quick(episode: StagedEpisode, frames: int, first: int = 0) -> None:
    fill(episode, [msgspec.structs.replace(row(first + number), age_ms=(4.0, 11.0)) for number in range(frames)])


def grown(
    root: Path, episodes: int = 1, frames: int = 6, task: str = "put the cube down", layout: Layout = QUICK
) -> Path:
    """Add episodes to a dataset, which differ."""
    dataset = Dataset(root)
    for _ in range(episodes):
        episode = begin_quick(dataset, task, layout)
        fill_quick(episode, frames, first=10 * len(dataset.episodes))
        episode.finish()
        dataset.commit(episode.folder)
    dataset.close()
    return root


def files_of(root: Path) -> dict[str, bytes]:
    """Return the contents of each file of a dataset, without unfinished episodes."""
    files = (path for path in root.rglob("*") if path.is_file() and STAGING.name not in path.parts)
    return {str(path.relative_to(root)): path.read_bytes() for path in files}
