"""Let a simulation (another program on this computer) control the simulated arm while no FRI client does."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import Commander
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
    def simulation_moves(self) -> bool:
        return self._controller.simulated

    def let_simulation_move(self, on: bool) -> None:
        self._controller.stand()
        self._controller.simulated = on

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._controller.set_targets(values)

    def hold(self) -> None:
        if self.commander is Commander.SIM:
            self._controller.stand()

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
