"""Choose the solver that steps a model: MuJoCo itself, Newton's solver on Warp, or Isaac Sim. The choice
holds for all bodies of a process. A twin's process makes it once, before it makes its body."""

from __future__ import annotations

import sys
from typing import Any, Protocol

from .lean_mujoco import mujoco

NEWTON, ISAAC = "newton", "isaac"

_chosen = ""


class Solver(Protocol):
    """Steps one model."""

    @property
    def at_most(self) -> int:
        """Most steps that should be requested in one call to catch up with time."""
        ...

    def step(self, model: Any, data: Any, steps: int) -> None: ...


class MujocoSolver:
    at_most = sys.maxsize

    def step(self, model: Any, data: Any, steps: int) -> None:
        mujoco.mj_step(model, data, steps)


def choose(backend: str) -> None:
    """Choose ``newton``, ``isaac``, or with any other text MuJoCo itself."""
    global _chosen
    _chosen = backend


def new_solver(spec: Any, model: Any, data: Any) -> Solver:
    """Return the solver for a model that was just compiled from its spec."""
    if _chosen == NEWTON:
        from .newton_solver import NewtonSolver  # imports Warp, so only if it was chosen

        return NewtonSolver(spec, model, data)
    if _chosen == ISAAC:
        from .isaac_solver import IsaacSolver

        return IsaacSolver(spec, model, data)
    return MujocoSolver()
