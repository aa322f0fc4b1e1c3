"""Simulate the arm: while no program runs on its controller, targets come through the simulation control."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Hand
from strands_actors.drivers.common.physics.controlled_body import ControlledBody

from .controller import Controller
from .motion import Hold, Servo


class URBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: None)  # the controller's own ticks advance the physics
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.busy

    @property
    def led(self) -> bool:
        return self._controller.led

    def lead(self, on: bool) -> None:
        self._controller.move(Hold())
        self._controller.led = on

    def aim_controller(self, values: Sequence[float]) -> None:
        self._controller.move(Servo(values))

    def hold(self) -> None:
        if self.hand is Hand.SIM:
            self._controller.move(Hold())

    def step(self, steps: int) -> None:
        self._controller.motion.advance(self._plant, steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
