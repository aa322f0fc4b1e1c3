"""Compute figures of episodes from their numbers. No I/O."""

from __future__ import annotations

import hashlib
from collections import deque

import msgspec
import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

POINTS = 60
"""Points of a curve on the page."""
MOVES = 0.005
"""Least step of a joint that counts as motion, as a share of its range in the dataset."""


class Motion(msgspec.Struct, frozen=True):
    """The motion of one episode.

    Attributes:
        low, high: Smallest and largest command of each joint.
        speed: Largest step of a command from one frame to the next, for each joint, in units per second.
        jerk: Root mean square of the third difference of the commands, for each joint, in units per second cubed.
        begin: The first measured position of each joint.
        repeated: Greatest number of frames in a row with exactly the same reading, while the command changed.
        fingerprint: Equal for episodes with equal commands and readings.
        curves: The commands of each joint, thinned out.
        moving: True for each frame at which a joint has moved since the frame before.
    """

    low: Numbers
    high: Numbers
    speed: Numbers
    jerk: Numbers
    begin: Numbers
    repeated: int
    fingerprint: str
    curves: Numbers
    moving: NDArray[np.bool_]


@np.errstate(invalid="ignore", over="ignore")  # A foreign dataset may have infinite numbers.
def motion_of(action: Numbers, state: Numbers, fps: float, spread: Numbers) -> Motion:
    """Return the figures of an episode's motion.

    Args:
        action: The commands, with one row for each frame and one column for each joint.
        state: The readings, in the same form. It may have other columns.
        fps: Frames per second.
        spread: The range of each column of ``state`` in the whole dataset.
    """
    steps = np.diff(action, axis=0)
    third = np.diff(action, n=3, axis=0) * fps**3
    joints = action.shape[1]
    none = np.zeros(joints)
    same_reading = (np.diff(state, axis=0) == 0).all(1) if state.shape[1] else np.zeros(len(steps), bool)
    moved = (np.abs(np.diff(state, axis=0)) > MOVES * spread).any(1)
    chosen = np.unique(np.linspace(0, len(action) - 1, POINTS).round().astype(int))
    return Motion(
        action.min(0),
        action.max(0),
        np.abs(steps).max(0) * fps if len(steps) else none,
        np.sqrt((third**2).mean(0)) if len(third) else none,
        state[0],
        longest_run(same_reading & (steps != 0).any(1)),
        hashlib.sha256(np.ascontiguousarray(action).tobytes() + np.ascontiguousarray(state).tobytes()).hexdigest(),
        action[chosen].T,
        np.concatenate([[False], moved]),
    )


def longest_run(flags: NDArray[np.bool_]) -> int:
    """Return the greatest number of true values in a row."""
    ends = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return int((ends[1::2] - ends[::2]).max(initial=0))


class Pictures:
    """Counts, picture by picture, the figures of one camera in one episode."""

    def __init__(self) -> None:
        self.brightness = 0.0  # Mean level of all pictures, 0 to 255.
        self.still = 0  # Greatest number of equal pictures in a row while the robot moved.
        self._count = self._run = 0
        self._before: deque[NDArray[np.uint8]] = deque(maxlen=2)

    def add(self, picture: NDArray[np.uint8], is_moving: bool) -> None:
        # A codec may encode equal pictures in turn in two ways, as key frames and others.
        is_equal = any(np.array_equal(picture, before) for before in self._before)
        self._run = self._run + is_moving if is_equal else 0
        self.still = max(self.still, self._run)
        self._before.append(picture)
        self._count += 1
        self.brightness += (float(picture[::4, ::4].mean()) - self.brightness) / self._count
