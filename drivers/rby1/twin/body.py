"""The robot as a simulation: while nobody has it on the wire, the simulation may move it."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.jointed_body import JointedBody
from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.common.simulation_control.protocol import TIMESTEP_S

from .controller import Controller


class RBY1Body(JointedBody):
    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: None)  # the controller's own ticks
        self._controller = controller

    @property
    def _hand(self) -> Hand:
        if self._controller.runs:
            return Hand.WIRE
        return Hand.SIM if self._controller.led else Hand.NONE

    @property
    def hands(self) -> Sequence[Hand]:
        return [self._hand] * len(self.axes)

    def take(self, on: bool) -> None:
        if self._hand is (Hand.NONE if on else Hand.SIM):
            self._controller.lead(on)

    def aim(self, values: Sequence[float]) -> None:
        if self._hand is Hand.SIM:
            self._controller.aim(values)

    def hold(self) -> None:
        if self._hand is Hand.SIM:
            self._controller.hold()

    def step(self, steps: int) -> None:
        self._controller.advance(steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
