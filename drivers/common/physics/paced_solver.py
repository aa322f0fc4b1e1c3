"""The common part of the solvers besides MuJoCo. They may run slower than the time that they simulate, and
have no servo with a state. Only for twins."""

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
    """A solver that may be slower than the time it simulates."""

    def __init__(self) -> None:
        self._steps_per_s = float(_FEW) / BUDGET_S

    @property
    def at_most(self) -> int:
        """The number of steps that fit into ``BUDGET_S``."""
        return max(1, int(self._steps_per_s * BUDGET_S))

    def _took(self, steps: int, began_s: float) -> None:
        self._steps_per_s = steps / max(time.monotonic() - began_s, 1e-6)


def without_dynamics(spec: Any, servos: Iterable[int]) -> Any:
    """Return a copy of the spec in which these servos are plain ones, without a state and a limit of
    speed."""
    plain = spec.copy()
    for servo in (plain.actuators[int(at)] for at in servos):
        servo.dyntype = mujoco.mjtDyn.mjDYN_NONE
        servo.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        servo.dynprm = np.zeros_like(servo.dynprm)
    return plain
