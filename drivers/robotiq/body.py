"""Let a simulation (another program on this computer) move the fingers of the simulated gripper.

It may do so while no Modbus client has given the gripper a goal.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander, Felt

from .mechanism import Gripper
from .protocol import TOP

CLOSED_RAD = 0.8
"""Position of each of the model's four joints when the fingers meet [mujoco_menagerie/robotiq_2f85]."""


class GripperBody:
    axes = ("gripper",)

    def __init__(self, gripper: Gripper, table: Mapping[str, Any]) -> None:
        self._gripper = gripper
        self._table = table
        self.pass_time = gripper.pass_time

    @cached_property
    def spec(self) -> Any:
        # This imports MuJoCo. Only pictures of the gripper need it.
        from strands_actors.drivers.common.physics.model_rows import build

        return build(self._table)

    @property
    def _commander(self) -> Commander:
        if self._gripper.driven:
            return Commander.WIRE
        return Commander.NONE if self._gripper.simulation_target is None else Commander.SIM

    @property
    def _closed(self) -> float:
        """How far the fingers are closed: 0 for open, 1 for closed."""
        return self._gripper.position / TOP

    @property
    def commanders(self) -> Sequence[Commander]:
        return (self._commander,)

    def felt(self) -> Felt:
        return Felt(self._gripper.time_s, (self._closed,), (0.0,), (0.0,), self.commanders)

    def pose(self) -> Sequence[float]:
        return [self._closed * CLOSED_RAD] * 4

    def energise(self, on: bool) -> None:
        """Give the fingers to the simulation (``on``), or take them back: then the gear holds the fingers."""
        if self._commander is (Commander.NONE if on else Commander.SIM):
            self._gripper.simulation_target = self._gripper.position if on else None

    def set_targets(self, values: Sequence[float]) -> None:
        if self._commander is Commander.SIM:
            self._gripper.simulation_target = values[0] * TOP

    def hold(self) -> None:
        self.set_targets((self._closed,))

    def step(self, steps: int) -> None:
        self._gripper.advance_fast(steps * TIMESTEP_S)

    def reset(self) -> None:
        self._gripper.open_up()
