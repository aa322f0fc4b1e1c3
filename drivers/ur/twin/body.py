"""The arm as a simulation: as long as no program runs on its controller, targets come through the
simulation control."""

from __future__ import annotations

from collections.abc import Sequence

from strands_actors.drivers.common.jointed_body import JointedBody
from strands_actors.drivers.common.simulation_control.body import Hand
from strands_actors.drivers.common.simulation_control.protocol import TIMESTEP_S

from .controller import Controller
from .motion import Hold, Servo


class URBody(JointedBody):
    """The controller keeps its arm energised whoever moves it: nothing here makes it limp."""

    def __init__(self, controller: Controller) -> None:
        super().__init__(controller.plant, lambda: None)  # the controller's own ticks
        self._controller = controller

    @property
    def _hand(self) -> Hand:
        if self._controller.busy:
            return Hand.WIRE
        return Hand.SIM if self._controller.led else Hand.NONE

    @property
    def hands(self) -> Sequence[Hand]:
        return [self._hand] * len(self.axes)

    def take(self, on: bool) -> None:
        if self._hand is (Hand.NONE if on else Hand.SIM):
            self._controller.move(Hold())
            self._controller.led = on

    def aim(self, values: Sequence[float]) -> None:
        if self._hand is Hand.SIM:
            self._controller.move(Servo(values))

    def hold(self) -> None:
        if self._hand is Hand.SIM:
            self._controller.move(Hold())

    def step(self, steps: int) -> None:
        self._controller.motion.advance(self._plant, steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
