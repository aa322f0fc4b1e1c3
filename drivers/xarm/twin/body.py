"""The arm as a simulation: while nobody has it on the wire, the simulation may move it."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.controlled_body import ControlledBody
from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.common.simulation_control.protocol import TIMESTEP_S

from .controller import Controller


class XArmBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: None)  # the controller's own ticks
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.runs

    @property
    def led(self) -> bool:
        return self._controller.led

    def lead(self, on: bool) -> None:
        self._controller.lead(on)

    def aim_controller(self, values: Sequence[float]) -> None:
        self._controller.aim(values)

    def hold(self) -> None:
        if self.hand is Hand.SIM:
            self._controller.hold()

    def step(self, steps: int) -> None:
        self._controller.advance(steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
