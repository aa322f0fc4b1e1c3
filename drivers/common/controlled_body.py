"""An arm behind its controller as a simulation: targets come through the simulation control as long
as nothing on the wire moves it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from .jointed_body import JointedBody
from .physics import Plant
from .simulation_control.body import Hand
from .simulation_control.protocol import TIMESTEP_S


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


class LedController(Protocol):
    """A twin's controller that has ticks of its own and can be led by the simulation."""

    plant: Plant

    @property
    def led(self) -> bool: ...
    def lead(self, on: bool) -> None: ...
    def aim(self, goal: Sequence[float]) -> None: ...
    def hold(self) -> None: ...
    def advance(self, elapsed_s: float) -> None: ...
    def wake_up(self) -> None: ...


class LedBody(ControlledBody):
    """While nobody has the robot on the wire, the simulation may move it."""

    def __init__(self, controller: LedController, is_driven: Callable[[], bool]) -> None:
        """``is_driven``: whether the wire moves the arm."""
        super().__init__(controller.plant, lambda: None)  # the controller's own ticks
        self._controller = controller
        self._is_driven = is_driven

    @property
    def driven(self) -> bool:
        return self._is_driven()

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
