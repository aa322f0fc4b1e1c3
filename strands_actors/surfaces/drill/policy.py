"""The policy of a drill. It commands every axis to its first observed position."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


class Still:
    """Send setpoints at the control rate, without motion."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._axes = axes
        self._here: dict[str, float] = {}

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        if not self._here:
            self._here = {axis: observation[axis] for axis in self._axes}
        return dict(self._here)
