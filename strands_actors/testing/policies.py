"""A policy that breaks when told to, in the named way."""

from __future__ import annotations

import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from strands_actors.policies import Sine


class Faulty(Sine):
    """A ``Sine`` until the file ``trigger`` appears; then its content happens: exception, exit or spin.
    The time it happened goes to ``<trigger>.t`` (CLOCK_MONOTONIC nanoseconds)."""

    def __init__(self, axes: Sequence[str], trigger: str, amplitude: float = 10.0, hz: float = 0.5) -> None:
        super().__init__(axes, amplitude, hz)
        self._trigger = Path(trigger)

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        if self._trigger.exists():
            how = self._trigger.read_text()
            Path(f"{self._trigger}.t").write_text(str(time.monotonic_ns()))
            if how == "exception":
                raise RuntimeError("a fault was asked for")
            if how == "exit":
                sys.exit(3)
            while how == "spin":
                pass
        return super().step(observation)
