"""Find episodes that may harm a training, from the figures of all episodes. No I/O.

An outlier is an episode with a figure that is far from the median of all episodes: more than ``FAR`` times the
usual distance from it. The usual distance is the median one, and at least a share of the median, so that a dataset
of nearly equal episodes has no outliers.
"""

from __future__ import annotations

import enum
import math
from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence

import msgspec
import numpy as np

from .figures import Numbers

FEWEST = 5
"""With fewer episodes, no outliers are searched."""
FAR = 5.0
LEAST_SHARE = 0.05
MAD = 1.4826
"""The median distance times this number is the standard deviation of a normal distribution."""


class Kind(enum.StrEnum):
    DAMAGED = "damaged"
    GAPS = "gaps"
    LATE = "late"
    SAME_MOTION = "same motion"
    SAME_PICTURES = "same pictures"
    STILL = "still pictures"
    REPEATED = "repeated readings"
    MARK = "mark"
    LENGTH = "length"
    LOW = "smallest command"
    HIGH = "largest command"
    SPEED = "speed"
    JERK = "jerk"
    BEGIN = "start position"
    BRIGHTNESS = "brightness"
    UNUSED = "unused joint"


class Finding(msgspec.Struct, frozen=True):
    """One finding.

    Attributes:
        kind: The kind of the finding.
        episode: The episode. -1 for the whole dataset.
        name: The joint, camera or source that it is about. Empty for the whole episode.
        value: The figure, or a count, or the number of the other episode. None for a kind without a value.
        usual: The median of the figure over all episodes. None for a kind without one.
        text: A text from a file, such as a mark or the reason of a damage.
    """

    kind: Kind
    episode: int
    name: str = ""
    value: float | None = None
    usual: float | None = None
    text: str = ""


def outliers(values: Mapping[int, float], least: float) -> dict[int, float]:
    """Return the median for each episode with a value far from it.

    Args:
        values: A figure of each episode, by the episode's number.
        least: Least usual distance from the median.
    """
    if len(values) < FEWEST:
        return {}
    numbers = np.array([value for value in values.values() if math.isfinite(value)])
    median = float(np.median(numbers)) if len(numbers) else math.nan
    usual = max(MAD * float(np.median(np.abs(numbers - median))), least, 1e-9) if len(numbers) else least
    return {episode: median for episode, value in values.items() if not abs(value - median) <= FAR * usual}


def find_outliers(kind: Kind, values: Mapping[int, float], least: float = 0.0, name: str = "") -> list[Finding]:
    """Return a finding for each outlier. ``least`` is the least usual distance. 0 means a share of the median."""
    finite = [abs(value) for value in values.values() if math.isfinite(value)]
    least = least or LEAST_SHARE * (float(np.median(finite)) if finite else 0.0)
    return [
        Finding(kind, episode, name, round(values[episode], 6), round(median, 6))
        for episode, median in outliers(values, least).items()
    ]


def find_by_joint(
    kind: Kind, values: Mapping[int, Numbers], names: Sequence[str], least: Sequence[float]
) -> list[Finding]:
    """Return a finding for each outlier in a figure that each joint has."""
    findings = []
    for joint, name in enumerate(names):
        by_episode = {episode: float(each[joint]) for episode, each in values.items()}
        findings += find_outliers(kind, by_episode, least[joint], name)
    return findings


def find_equal(kind: Kind, values: Mapping[int, Hashable], name: str = "") -> list[Finding]:
    """Return a finding for each episode with the same value as an earlier one, which the finding names."""
    by_value: dict[Hashable, list[int]] = defaultdict(list)
    for episode, value in sorted(values.items()):
        by_value[value].append(episode)
    return [
        Finding(kind, other, name, float(episodes[0])) for episodes in by_value.values() for other in episodes[1:]
    ]


def find_counts(kind: Kind, counts: Mapping[int, int], name: str = "", least: float = 1) -> list[Finding]:
    """Return a finding for each episode with a count of ``least`` or more."""
    return [Finding(kind, episode, name, float(count)) for episode, count in counts.items() if count >= least]
