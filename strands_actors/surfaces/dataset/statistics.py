"""Figures of an episode, and of all: what training normalises with. As LeRobot computes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
LEVELS = 256
PIXELS = 150
"""Of the smaller side of a picture, that figures are taken of: as many as LeRobot takes."""

Figures = dict[str, Any]
"""min, max, mean, std, count and the quantiles, as nested lists."""


@np.errstate(invalid="ignore", over="ignore")  # of an infinity: its figures are no numbers
def of_column(values: NDArray[Any]) -> Figures:
    """``values``: a row a frame."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    found = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    found |= {name: np.quantile(rows, at, axis=0) for name, at in QUANTILES.items()}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(rows)]}


class PictureFigures:
    """Of the pictures of one camera, as they come: how often each level of each colour was
    seen."""

    def __init__(self) -> None:
        self.seen: NDArray[np.int64] = np.zeros((3, LEVELS), dtype=np.int64)
        self.pictures = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        step = max(1, min(picture.shape[:2]) // PIXELS)
        few = picture[::step, ::step]
        for colour in range(3):
            self.seen[colour] += np.bincount(few[..., colour].ravel(), minlength=LEVELS)
        self.pictures += 1

    def take(self, seen: list[list[int]], pictures: int) -> None:
        """What was counted before."""
        self.seen[:] = seen
        self.pictures = pictures

    def figures(self) -> Figures:
        """Levels from 0 to 1, one row a colour."""
        levels = np.arange(LEVELS) / (LEVELS - 1)
        share = self.seen / self.seen.sum(1, keepdims=True)
        mean = share @ levels
        std = np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0))
        there = self.seen > 0
        below = share.cumsum(1)
        found = {
            "min": levels[there.argmax(1)],
            "max": levels[LEVELS - 1 - there[:, ::-1].argmax(1)],
            "mean": mean,
            "std": std,
        }
        found |= {name: levels[(below >= at - 1e-12).argmax(1)] for name, at in QUANTILES.items()}
        return {name: value.reshape(3, 1, 1).tolist() for name, value in found.items()} | {"count": [self.pictures]}


def aggregate(episodes: Sequence[Mapping[str, Figures]]) -> dict[str, Figures]:
    """Merge the figures of several episodes: exact but for the quantiles, which are weighted means.

    A feature that an episode lacks, or has in another shape, is left out.
    """
    found = {}
    for feature in episodes[0] if episodes else ():
        parts = [episode[feature] for episode in episodes if feature in episode]
        if len(parts) == len(episodes) and len({np.shape(part["mean"]) for part in parts}) == 1:
            found[feature] = _merge(parts)
    return found


@np.errstate(invalid="ignore", over="ignore")
def _merge(parts: Sequence[Figures]) -> Figures:
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)
    names = set.intersection(*(set(part) for part in parts))
    stacked = {name: np.array([part[name] for part in parts], dtype=np.float64) for name in names}
    weights = (counts / counts.sum()).reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (stacked["mean"] * weights).sum(0)
    spread = ((stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2) * weights).sum(0)
    found = {"min": stacked["min"].min(0), "max": stacked["max"].max(0), "mean": mean, "std": np.sqrt(spread)}
    found |= {name: (stacked[name] * weights).sum(0) for name in QUANTILES if name in stacked}
    return {name: value.tolist() for name, value in found.items()} | {"count": [int(counts.sum())]}
