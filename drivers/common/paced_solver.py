"""What solvers beside MuJoCo share: they may be slower than the time that they simulate, and know no
servo with a state of its own. Twins only."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import Any

import numpy as np

from .lean_mujoco import mujoco

BUDGET_S = 0.1
"""Of computing at a time: a simulation that is slower than the time it simulates runs late, and
stays answerable."""

_FEW = 5


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
