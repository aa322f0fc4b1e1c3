"""Let a simulation (another program on this computer) set the joint targets of the simulated arm.

It may do so while no program runs on the arm's controller.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import TIMESTEP_S, Commander
from strands_actors.drivers.common.physics.controlled_body import ControlledBody

from .controller import Controller
from .motion import Hold, Servo


class URBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        # Nothing to do between steps: each tick of the controller also advances the physics.
        super().__init__(controller.plant, lambda: None)
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.busy

    @property
    def simulation_moves(self) -> bool:
        return self._controller.simulation_moves

    def let_simulation_move(self, on: bool) -> None:
        self._controller.move(Hold())
        self._controller.simulation_moves = on

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._controller.move(Servo(values))

    def hold(self) -> None:
        if self.commander is Commander.SIM:
            self._controller.move(Hold())

    def step(self, steps: int) -> None:
        self._controller.motion.advance(self._plant, steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
