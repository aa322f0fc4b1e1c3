"""The settings of a simulated robot that its wire and its stop channel share."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from strands_actors.drivers.common.simulation_control import protocol as p


class SimConfig(msgspec.Struct, frozen=True):
    control: str  # path of the socket for requests to the simulation (the simulation control)
    axes: tuple[str, ...]
    ids: tuple[int, ...]
    # For each axis (zero, scale): value in the driver's units = zero + scale * value in the model's units.
    units: tuple[tuple[float, float], ...]
    energised: frozenset[str]  # names of the safe states in which the motors keep their torque
    rows: int = 1  # numbers per axis in a target; only the first of them is converted by ``units``

    def position(self, sample: p.Sample) -> tuple[float, ...]:
        """Return the positions of a simulation sample in the units of the robot's driver."""
        return tuple(zero + scale * value for value, (zero, scale) in zip(sample.position, self.units, strict=True))

    def model(self, values: Sequence[float]) -> tuple[float, ...]:
        """Convert a target of the robot's driver to the units of the simulated model. Only the first ``rows``
        numbers of each axis are used. The model does not need the others, such as a gripper's speed."""
        count = len(self.axes)
        first = tuple((value - zero) / scale for value, (zero, scale) in zip(values, self.units, strict=False))
        return (*first, *values[count : count * self.rows])
