"""Move the twin's gripper as a simulation while the wire gives it no goal. Targets then come through the
simulation control."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Felt, Hand

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
        from strands_actors.drivers.common.physics.model_rows import build  # MuJoCo, for the pictures only

        return build(self._table)

    @property
    def _hand(self) -> Hand:
        if self._gripper.driven:
            return Hand.WIRE
        return Hand.NONE if self._gripper.led_to is None else Hand.SIM

    @property
    def _closed(self) -> float:
        """The closed fraction, 0 to 1."""
        return self._gripper.position / TOP

    @property
    def hands(self) -> Sequence[Hand]:
        return (self._hand,)

    def felt(self) -> Felt:
        return Felt(self._gripper.time_s, (self._closed,), (0.0,), (0.0,), self.hands)

    def pose(self) -> Sequence[float]:
        return [self._closed * CLOSED_RAD] * 4

    def take(self, on: bool) -> None:
        """Begin or end leading the fingers. After the end they stay, because the gear cannot be pushed."""
        if self._hand is (Hand.NONE if on else Hand.SIM):
            self._gripper.led_to = self._gripper.position if on else None

    def aim(self, values: Sequence[float]) -> None:
        if self._hand is Hand.SIM:
            self._gripper.led_to = values[0] * TOP

    def hold(self) -> None:
        self.aim((self._closed,))

    def step(self, steps: int) -> None:
        self._gripper.hurry(steps * TIMESTEP_S)

    def reset(self) -> None:
        self._gripper.open_up()
