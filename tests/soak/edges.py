"""A policy that drives every joint of an arm into its limits and back, as fast as the gate lets it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

STEPS = 20.0
"""From one limit to the other."""


class Edges:
    """``low``, ``high``: of each axis; ``step``: what a setpoint may move it at most."""

    def __init__(
        self, axes: Sequence[str], low: Sequence[float], high: Sequence[float], step: Sequence[float]
    ) -> None:
        self._rows = {axis: row for axis, *row in zip(axes, low, high, step, strict=True)}
        self._target: dict[str, float] = {}
        self._up = True

    def step(self, observation: Mapping[str, float]) -> list[dict[str, float]]:
        """Return the next setpoint: a step towards the limit at which each joint is to stand."""
        if not self._target:
            self._target = {axis: observation[axis] for axis in self._rows}
        limits = {axis: high if self._up else low for axis, (low, high, _) in self._rows.items()}
        for axis, (_, _, step) in self._rows.items():
            left = limits[axis] - self._target[axis]
            self._target[axis] += max(-step, min(step, left))
        if all(abs(limits[axis] - value) < 1e-9 for axis, value in self._target.items()):
            self._up = not self._up
        return [dict(self._target)]
