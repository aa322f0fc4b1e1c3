"""The body of a simulated arm that has a controller. While a command in the robot's protocol moves the arm, the
simulation cannot move it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Protocol

from .body import TIMESTEP_S, Commander
from .jointed_body import JointedBody
from .physics import Plant


class ControlledBody(JointedBody, ABC):
    """An arm that never goes limp: its controller keeps it energised, or its brakes hold it.

    A subclass decides whether commands in the robot's protocol or the simulation move the arm. It sends the
    simulation's targets to the controller.
    """

    @property
    @abstractmethod
    def driven(self) -> bool:
        """True if commands in the robot's protocol move the arm."""

    @property
    @abstractmethod
    def simulation_moves(self) -> bool:
        """True if the simulation moves the arm."""

    @abstractmethod
    def let_simulation_move(self, on: bool) -> None:
        """Let the simulation move the arm; with ``on=False`` forbid it again. The arm keeps its position."""

    @abstractmethod
    def set_controller_targets(self, values: Sequence[float]) -> None:
        """Send the arm's controller a target in radians, in axis order."""

    @property
    def commander(self) -> Commander:
        if self.driven:
            return Commander.WIRE
        return Commander.SIM if self.simulation_moves else Commander.NONE

    @property
    def commanders(self) -> Sequence[Commander]:
        return [self.commander] * len(self.axes)

    def energise(self, on: bool) -> None:
        if self.commander is (Commander.NONE if on else Commander.SIM):
            self.let_simulation_move(on)

    def set_targets(self, values: Sequence[float]) -> None:
        if self.commander is Commander.SIM:
            self.set_controller_targets(values)


class SharedController(Protocol):
    """The simulated controller of an arm that has a control cycle and that accepts targets from the simulation."""

    plant: Plant

    @property
    def simulation_moves(self) -> bool: ...
    def let_simulation_move(self, on: bool) -> None: ...
    def set_targets(self, goal: Sequence[float]) -> None: ...
    def hold(self) -> None: ...
    def advance(self, elapsed_s: float) -> None: ...
    def wake_up(self) -> None: ...


class SharedBody(ControlledBody):
    """The body of an arm that the simulation can move, but not while a client moves it in the robot's protocol."""

    def __init__(self, controller: SharedController, is_driven: Callable[[], bool]) -> None:
        """Wrap a controller.

        Args:
            controller: The simulated controller. Its control cycle advances the time.
            is_driven: Return True if commands in the robot's protocol move the arm.
        """
        super().__init__(controller.plant, lambda: None)
        self._controller = controller
        self._is_driven = is_driven

    @property
    def driven(self) -> bool:
        return self._is_driven()

    @property
    def simulation_moves(self) -> bool:
        return self._controller.simulation_moves

    def let_simulation_move(self, on: bool) -> None:
        self._controller.let_simulation_move(on)

    def set_controller_targets(self, values: Sequence[float]) -> None:
        self._controller.set_targets(values)

    def hold(self) -> None:
        if self.commander is Commander.SIM:
            self._controller.hold()

    def step(self, steps: int) -> None:
        self._controller.advance(steps * TIMESTEP_S)
        super().step(steps)

    def reset(self) -> None:
        super().reset()
        self._controller.wake_up()
