"""The arm behind the twin as a simulation, while no client commands it."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.jointed_body import JointedBody
from strands_actors.drivers.common.simulation_control.body import Hand

from .controller import Controller


class KukaBody(JointedBody):
    """The controller keeps its arm energised whoever moves it: nothing here makes it limp."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: controller.plant.catch_up(controller.now_s()))
        self._controller = controller

    @property
    def _hand(self) -> Hand:
        if self._controller.is_commanded:
            return Hand.WIRE
        return Hand.SIM if self._controller.simulated else Hand.NONE

    @property
    def hands(self) -> Sequence[Hand]:
        return [self._hand] * len(self.axes)

    def take(self, on: bool) -> None:
        if self._hand is (Hand.NONE if on else Hand.SIM):
            self._controller.stand()
            self._controller.simulated = on

    def aim(self, values: Sequence[float]) -> None:
        if self._hand is Hand.SIM:
            self._controller.aim(values)

    def hold(self) -> None:
        if self._hand is Hand.SIM:
            self._controller.stand()

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
