"""An arm and its controller as a simulation. The simulation control may move the arm while nothing on
the wire does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from .body import TIMESTEP_S, Hand
from .jointed_body import JointedBody
from .physics import Plant


class ControlledBody(JointedBody, ABC):
    """An arm that never goes limp: its controller keeps it energised, or its brakes hold it.

    A subclass says whether the wire or the simulation moves the arm, and passes on the targets of the
    simulation.
    """

    @property
    @abstractmethod
    def driven(self) -> bool:
        """True if the wire moves the arm."""

    @property
    @abstractmethod
    def led(self) -> bool:
        """True if the simulation moves the arm while the wire does not."""

    @abstractmethod
    def lead(self, on: bool) -> None:
        """Give the arm to the simulation, or take it back. The arm keeps its position."""

    @abstractmethod
    def aim_controller(self, values: Sequence[float]) -> None:
        """Send the controller a target in radians, in axis order."""

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
    """A twin's controller that has its own ticks and that the simulation can lead."""

    plant: Plant

    @property
    def led(self) -> bool: ...
    def lead(self, on: bool) -> None: ...
    def aim(self, goal: Sequence[float]) -> None: ...
    def hold(self) -> None: ...
    def advance(self, elapsed_s: float) -> None: ...
    def wake_up(self) -> None: ...


class LedBody(ControlledBody):
    """An arm that the simulation may move while no client moves it on the wire."""

    def __init__(self, controller: LedController, is_driven: Callable[[], bool]) -> None:
        """Wrap a controller.

        Args:
            controller: The twin's controller. It passes time by its own ticks.
            is_driven: Return True if the wire moves the arm.
        """
        super().__init__(controller.plant, lambda: None)
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
