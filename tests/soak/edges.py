"""A policy that moves joints of an arm to their limits and back, with the largest allowed steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

STEPS = 20.0
"""Number of steps from one limit to the other."""


class Edges:
    """The policy. It is given the limits of each axis, and the largest step of a setpoint."""

    def __init__(
        self, axes: Sequence[str], low: Sequence[float], high: Sequence[float], step: Sequence[float]
    ) -> None:
        self._rows = {axis: row for axis, *row in zip(axes, low, high, step, strict=True)}
        self._target: dict[str, float] = {}
        self._up = True

    def step(self, observation: Mapping[str, float]) -> list[dict[str, float]]:
        """Return the next setpoint: one step of each joint towards its current limit."""
        if not self._target:
            self._target = {axis: observation[axis] for axis in self._rows}
        limits = {axis: high if self._up else low for axis, (low, high, _) in self._rows.items()}
        for axis, (_, _, step) in self._rows.items():
            left = limits[axis] - self._target[axis]
            self._target[axis] += max(-step, min(step, left))
        if all(abs(limits[axis] - value) < 1e-9 for axis, value in self._target.items()):
            self._up = not self._up
        return [dict(self._target)]
