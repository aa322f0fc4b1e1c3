"""Who steps a model: MuJoCo itself, Newton's solver on Warp, or Isaac Sim. One for all bodies of a
process: a twin's process is told once, before it makes its body."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterable
from typing import Any, Protocol

import numpy as np

from .lean_mujoco import mujoco

NEWTON, ISAAC = "newton", "isaac"

BUDGET_S = 0.1
"""Of computing at a time: a simulation that is slower than the time it simulates runs late, and
stays answerable."""

_FEW = 5

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


class Paced:
    """One that may be slower than the time it simulates."""

    def __init__(self) -> None:
        self._steps_per_s = float(_FEW) / BUDGET_S

    @property
    def at_most(self) -> int:
        """Steps that are worth asking for at once."""
        return max(1, int(self._steps_per_s * BUDGET_S))

    def _took(self, steps: int, began_s: float) -> None:
        self._steps_per_s = steps / max(time.monotonic() - began_s, 1e-6)


def without_dynamics(spec: Any, servos: Iterable[int]) -> Any:
    """Return a copy of the spec, these servos plain ones: without a state and its limit of speed."""
    plain = spec.copy()
    for servo in (plain.actuators[int(at)] for at in servos):
        servo.dyntype = mujoco.mjtDyn.mjDYN_NONE
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.dynprm = np.zeros_like(servo.dynprm)
    return plain


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
