"""An arm behind its controller as a simulation: targets come through the simulation control as long
as nothing on the wire moves it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from .jointed_body import JointedBody
from .simulation_control.body import Hand


class ControlledBody(JointedBody, ABC):
    """The controller keeps its arm energised, or its brakes hold it, whoever moves it: nothing here
    makes it limp."""

    @property
    @abstractmethod
    def driven(self) -> bool:
        """Return whether the wire moves the arm."""

    @property
    @abstractmethod
    def led(self) -> bool:
        """Return whether the simulation moves it while the wire does not."""

    @abstractmethod
    def lead(self, on: bool) -> None:
        """Give the arm to the simulation, or take it away. It stays where it is."""

    @abstractmethod
    def aim_controller(self, values: Sequence[float]) -> None:
        """Tell the controller where to move the arm, radians in axis order."""

    @property
    def hand(self) -> Hand:
        if self.driven:
            return Hand.WIRE
        return Hand.SIM if self.led else Hand.NONE

    @property
    def hands(self) -> Sequence[Hand]:
        return [self.hand] * len(self.axes)

    def take(self, on: bool) -> None:
        if self.hand is (Hand.NONE if on else Hand.SIM):
            self.lead(on)

    def aim(self, values: Sequence[float]) -> None:
        if self.hand is Hand.SIM:
            self.aim_controller(values)
