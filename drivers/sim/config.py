"""What the wire and the stop channel of a simulated robot know of it."""

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
    rows: int = 1  # numbers per axis of a target; those after the first row are the twin's business

    def position(self, sample: p.Sample) -> tuple[float, ...]:
        """Return what a sample says, in the driver's units."""
        return tuple(zero + scale * value for value, (zero, scale) in zip(sample.position, self.units, strict=True))

    def model(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return a target in the model's units. What follows the rows (a gripper's speed) has no
        meaning here."""
        count = len(self.axes)
        first = tuple((value - zero) / scale for value, (zero, scale) in zip(values, self.units, strict=False))
        return (*first, *values[count : count * self.rows])
