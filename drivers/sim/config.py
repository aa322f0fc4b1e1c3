"""The facts about a simulated robot that its wire and its stop channel need."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from strands_actors.drivers.common.simulation_control import protocol as p


class SimConfig(msgspec.Struct, frozen=True):
    control: str  # path of the simulation control
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    units: tuple[tuple[float, float], ...]  # per axis (zero, scale): value = zero + scale * model
    energised: frozenset[str]  # safe states in which the robot stays ready
    rows: int = 1  # numbers per axis of a target; only the twin interprets those after the first row

    def position(self, sample: p.Sample) -> tuple[float, ...]:
        """Return the positions of a sample in the driver's units."""
        return tuple(zero + scale * value for value, (zero, scale) in zip(sample.position, self.units, strict=True))

    def model(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return a target in the model's units. Numbers after the rows (a gripper's speed) are dropped,
        since the model has no use for them."""
        count = len(self.axes)
        first = tuple((value - zero) / scale for value, (zero, scale) in zip(values, self.units, strict=False))
        return (*first, *values[count : count * self.rows])
