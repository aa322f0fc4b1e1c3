"""The common part of the solvers other than MuJoCo. They may be slower than real time, and they have no servo with
an internal state."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from .lean_mujoco import mujoco

BUDGET_S = 0.1
"""Longest time of computing in one call. A simulation that is slower than its time runs late, but still
answers."""

_FEW = 5


class Paced:
    """Base of a solver that may be slower than real time."""

    def __init__(self) -> None:
        self._steps_per_s = float(_FEW) / BUDGET_S

    @property
    def max_steps(self) -> int:
        """Number of time steps that can be computed within ``BUDGET_S``, at the speed of the last measured
        call."""
        return max(1, int(self._steps_per_s * BUDGET_S))

    def _took(self, steps: int, began_s: float) -> None:
        self._steps_per_s = steps / max(time.monotonic() - began_s, 1e-6)


def without_dynamics(spec: Any, servos: Iterable[int]) -> Any:
    """Return a copy of the spec. In it the given servos have no internal state and no speed limit."""
    plain = spec.copy()
    for servo in (plain.actuators[int(index)] for index in servos):
        servo.dyntype = mujoco.mjtDyn.mjDYN_NONE
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.dynprm = np.zeros_like(servo.dynprm)
    return plain
