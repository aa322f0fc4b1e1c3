"""Choose the solver that computes the physics: MuJoCo, Newton's solver on Warp, or Isaac Sim.

The process of a simulated robot chooses once, before it makes the robot's body. The choice holds for all bodies in
the process.
"""

from __future__ import annotations

import sys
from typing import Any, Protocol

from .lean_mujoco import mujoco

NEWTON, ISAAC = "newton", "isaac"

_chosen = ""


class Solver(Protocol):
    """A solver that advances one model in time."""

    @property
    def max_steps(self) -> int:
        """Largest number of steps that one call should compute to catch up with real time."""
        ...

    def step(self, model: Any, data: Any, steps: int) -> None: ...


class MujocoSolver:
    max_steps = sys.maxsize

    def step(self, model: Any, data: Any, steps: int) -> None:
        mujoco.mj_step(model, data, steps)


def choose(backend: str) -> None:
    """Choose the solver: ``newton`` or ``isaac``. Any other text chooses MuJoCo."""
    global _chosen
    _chosen = backend


def new_solver(spec: Any, model: Any, data: Any) -> Solver:
    """Return a solver for a model that was just compiled from ``spec``."""
    if _chosen == NEWTON:
        # This import loads Warp, so it is done only if Newton was chosen.
        from .newton_solver import NewtonSolver

        return NewtonSolver(spec, model, data)
    if _chosen == ISAAC:
        from .isaac_solver import IsaacSolver

        return IsaacSolver(spec, model, data)
    return MujocoSolver()
