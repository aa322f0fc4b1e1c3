"""Move the twin's arm as a simulation while no motion runs on its controller. Targets then come through the
simulation control."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.controlled_body import ControlledBody

from .controller import TICK_S, Controller


class FrankaBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: None)  # The controller's ticks advance the time.
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.motion is not None

    @property
    def led(self) -> bool:
        return self._controller.led

    def lead(self, on: bool) -> None:
        self._controller.lead(self._plant.position_rad)
        self._controller.led = on

    def aim_controller(self, values: Sequence[float]) -> None:
        self._controller.lead(values)

    def step(self, steps: int) -> None:
        for _ in range(round(steps * TIMESTEP_S / TICK_S)):
            self._controller.tick()

    def reset(self) -> None:
        super().reset()
        self._controller.reset()
