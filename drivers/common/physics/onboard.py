"""A controller on a simulated robot, which moves its joints while no program does.

Most robots with legs fall when their joints only keep their positions. A real one has a controller on board that
balances it while it holds. Such a controller gets the state of the robot once in each control period of the
simulated time, and returns the targets of its joints.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from .solver import Solver


class Controller(Protocol):
    """A controller on board. ``period`` is the number of time steps in one control period."""

    period: int

    def begin(self) -> None:
        """Forget everything from the last time that it was on."""
        ...

    def targets(self) -> Sequence[float]:
        """Return the targets of the joints for the present state, in radians or metres."""
        ...


class Onboard:
    """A solver that also runs a controller, at its rate in simulated time.

    Args:
        solver: The solver that computes the steps.
        controller: The controller.
        apply: Sets the targets of the joints.
    """

    def __init__(self, solver: Solver, controller: Controller, apply: Callable[[Sequence[float]], None]) -> None:
        self.solver = solver
        self._controller = controller
        self._apply = apply
        self._left = 0
        self._is_on = False

    def switch(self, on: bool) -> None:
        """Let the controller move the joints, or not."""
        if on and not self._is_on:
            self._controller.begin()
            self._left = 0
        self._is_on = on

    @property
    def max_steps(self) -> int:
        return self.solver.max_steps

    def step(self, model: Any, data: Any, steps: int) -> None:
        if not self._is_on:
            self.solver.step(model, data, steps)
            return
        while steps > 0:
            if self._left == 0:
                self._apply(self._controller.targets())
                self._left = self._controller.period
            now = min(steps, self._left)
            self.solver.step(model, data, now)
            self._left -= now
            steps -= now
