"""Move the twin's arm as a simulation while no client commands it."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import Hand
from strands_actors.drivers.common.physics.controlled_body import ControlledBody

from .controller import Controller


class KukaBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: controller.plant.catch_up(controller.now_s()))
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.is_commanded

    @property
    def led(self) -> bool:
        return self._controller.simulated

    def lead(self, on: bool) -> None:
        self._controller.stand()
        self._controller.simulated = on

    def aim_controller(self, values: Sequence[float]) -> None:
        self._controller.aim(values)

    def hold(self) -> None:
        if self.hand is Hand.SIM:
            self._controller.stand()

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
