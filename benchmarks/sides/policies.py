"""Policies that several questions use. Each chunk of actions lasts 50 ms and raises the elbow a little per step."""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import Any

CHUNK_S = 0.05
STEP_RAD = 1e-5
"""A whole chunk of such steps is within a UR's step gate at 1 kHz, because the reference takes only the first
action of each chunk."""
COMPUTE_S = 0.03
ELBOW = "elbow_joint"


class Still:
    """A policy that answers at once."""

    def __init__(self, hz: float = 125.0, **_: Any) -> None:
        self._size = max(2, round(hz * CHUNK_S))
        self._steps = 0

    def get_actions_sync(
        self, observation: Mapping[str, Any], instruction: str = "", **_: Any
    ) -> list[dict[str, float]]:
        self.compute()
        first, self._steps = self._steps, self._steps + self._size
        return [{ELBOW: (first + index) * STEP_RAD % 1.0} for index in range(self._size)]

    def compute(self) -> None:
        pass


class Busy(Still):
    """A policy that computes 30 ms in Python for 50 ms of actions."""

    def compute(self) -> None:
        until_s = time.perf_counter() + COMPUTE_S
        while time.perf_counter() < until_s:
            pass
