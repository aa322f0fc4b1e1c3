"""The policy of a drill. It commands every axis to stay at the position that it had at the beginning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence


class Still:
    """A policy that returns the first observed position of every axis again and again."""

    def __init__(self, axes: Sequence[str]) -> None:
        self._axes = axes
        self._first_position: dict[str, float] = {}

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        if not self._first_position:
            self._first_position = {axis: observation[axis] for axis in self._axes}
        return dict(self._first_position)
