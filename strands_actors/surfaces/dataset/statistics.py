"""Compute the statistics of episodes as LeRobot does. Training normalises with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
LEVELS = 256
PIXELS = 150
"""Pictures are subsampled for their figures: the smaller side keeps about so many pixels, as in LeRobot."""

Statistics = dict[str, Any]
"""min, max, mean, std, count and the quantiles, as nested lists."""


@np.errstate(invalid="ignore", over="ignore")  # Infinite values give NaN without a warning.
def of_column(values: NDArray[Any]) -> Statistics:
    """Return the statistics of a column. ``values`` has one row per frame."""
    rows = np.asarray(values, dtype=np.float64).reshape(len(values), -1)
    statistics = {"min": rows.min(0), "max": rows.max(0), "mean": rows.mean(0), "std": rows.std(0)}
    statistics |= {name: np.quantile(rows, quantile, axis=0) for name, quantile in QUANTILES.items()}
    return {name: value.tolist() for name, value in statistics.items()} | {"count": [len(rows)]}


class PictureStatistics:
    """Computes the statistics of one camera's pictures from a histogram of each colour. Pictures are added
    one by one."""

    def __init__(self) -> None:
        self.histogram: NDArray[np.int64] = np.zeros((3, LEVELS), dtype=np.int64)
        self.pictures = 0

    def add(self, picture: NDArray[np.uint8]) -> None:
        step = max(1, min(picture.shape[:2]) // PIXELS)
        few = picture[::step, ::step]
        for colour in range(3):
            self.histogram[colour] += np.bincount(few[..., colour].ravel(), minlength=LEVELS)
        self.pictures += 1

    def take(self, histogram: list[list[int]], pictures: int) -> None:
        """Replace the histogram by one that was counted before."""
        self.histogram[:] = histogram
        self.pictures = pictures

    def statistics(self) -> Statistics:
        """Return the statistics of the colour levels, scaled to 0 to 1, with one row per colour."""
        levels = np.arange(LEVELS) / (LEVELS - 1)
        share = self.histogram / self.histogram.sum(1, keepdims=True)
        mean = share @ levels
        std = np.sqrt(np.maximum(share @ levels**2 - mean**2, 0.0))
        present = self.histogram > 0
        below = share.cumsum(1)
        arrays = {
            "min": levels[present.argmax(1)],
            "max": levels[LEVELS - 1 - present[:, ::-1].argmax(1)],
            "mean": mean,
            "std": std,
        }
        arrays |= {name: levels[(below >= quantile - 1e-12).argmax(1)] for name, quantile in QUANTILES.items()}
        return {name: value.reshape(3, 1, 1).tolist() for name, value in arrays.items()} | {
            "count": [self.pictures]
        }


def aggregate(episodes: Sequence[Mapping[str, Statistics]]) -> dict[str, Statistics]:
    """Merge the statistics of several episodes.

    The results are exact, except for quantiles, which become weighted means. A feature is left out if an
    episode does not have it, or has it in another shape.
    """
    merged = {}
    for feature in episodes[0] if episodes else ():
        parts = [episode[feature] for episode in episodes if feature in episode]
        if len(parts) == len(episodes) and len({np.shape(part["mean"]) for part in parts}) == 1:
            merged[feature] = _merge(parts)
    return merged


@np.errstate(invalid="ignore", over="ignore")
def _merge(parts: Sequence[Statistics]) -> Statistics:
    counts = np.array([part["count"][0] for part in parts], dtype=np.float64)
    names = set.intersection(*(set(part) for part in parts))
    stacked = {name: np.array([part[name] for part in parts], dtype=np.float64) for name in names}
    weights = (counts / counts.sum()).reshape(-1, *[1] * (stacked["mean"].ndim - 1))
    mean = (stacked["mean"] * weights).sum(0)
    spread = ((stacked["std"] ** 2 + (stacked["mean"] - mean) ** 2) * weights).sum(0)
    merged = {"min": stacked["min"].min(0), "max": stacked["max"].max(0), "mean": mean, "std": np.sqrt(spread)}
    merged |= {name: (stacked[name] * weights).sum(0) for name in QUANTILES if name in stacked}
    return {name: value.tolist() for name, value in merged.items()} | {"count": [int(counts.sum())]}
