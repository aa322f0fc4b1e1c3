"""Let a simulation control the joints of the simulated arm while no FCI motion runs.

The simulation is another program on this computer. It sends its targets by the twin's control lines, not by FCI.
"""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.physics.controlled_body import ControlledBody

from .controller import TICK_S, Controller


class FrankaBody(ControlledBody):
    def __init__(self, controller: Controller) -> None:
        # Nothing to do between steps: each tick of the controller also advances the physics.
        super().__init__(controller.plant, lambda: None)
        self._controller = controller

    @property
    def driven(self) -> bool:
        return self._controller.motion is not None

    @property
    def simulation_moves(self) -> bool:
        return self._controller.simulation_moves

    def let_simulation_move(self, on: bool) -> None:
        self._controller.set_targets(self._plant.position_rad)
        self._controller.simulation_moves = on

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._controller.set_targets(values)

    def step(self, steps: int) -> None:
        for _ in range(round(steps * TIMESTEP_S / TICK_S)):
            self._controller.tick()

    def reset(self) -> None:
        super().reset()
        self._controller.reset()
