"""Who steps a model: MuJoCo itself, Newton's solver on Warp, or Isaac Sim. One for all bodies of a
process: a twin's process is told once, before it makes its body."""

from __future__ import annotations

import sys
from typing import Any, Protocol

from .lean_mujoco import mujoco

NEWTON, ISAAC = "newton", "isaac"

_chosen = ""


class Solver(Protocol):
    @property
    def at_most(self) -> int:
        """Steps that are worth asking for at once, when time is to be caught up with."""
        ...

    def step(self, model: Any, data: Any, steps: int) -> None: ...


class MujocoSolver:
    at_most = sys.maxsize

    def step(self, model: Any, data: Any, steps: int) -> None:
        mujoco.mj_step(model, data, steps)


def choose(backend: str) -> None:
    """``newton``, ``isaac``, or anything else for MuJoCo itself."""
    global _chosen
    _chosen = backend


def new_solver(spec: Any, model: Any, data: Any) -> Solver:
    """For a model that has just been compiled from its spec."""
    if _chosen == NEWTON:
        from .newton_solver import NewtonSolver  # with Warp, for who chose it

        return NewtonSolver(spec, model, data)
    if _chosen == ISAAC:
        from .isaac_solver import IsaacSolver

        return IsaacSolver(spec, model, data)
    return MujocoSolver()
