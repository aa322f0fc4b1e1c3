"""A policy that breaks when told to, in the named way."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from strands_actors.policies.registry import Sine
from strands_actors.supervisors.introspection import fall


class Faulty(Sine):
    """A ``Sine`` until the file ``trigger`` appears; then its content happens: exception, exit or
    spin. The time it happened goes to ``<trigger>.t`` (CLOCK_MONOTONIC nanoseconds).

    Args:
        joint: which one moves; empty: all.
        others: where the others stay, for a robot that is always told of all.
    """

    def __init__(
        self,
        axes: Sequence[str],
        trigger: str,
        amplitude: float = 10.0,
        hz: float = 0.5,
        joint: str = "",
        others: Mapping[str, float] | None = None,
    ) -> None:
        super().__init__(axes, amplitude, hz, only=[joint] if joint else [])
        self._trigger = Path(trigger)
        self._others = dict(others or {})

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        if self._trigger.exists():
            how = self._trigger.read_text()
            Path(f"{self._trigger}.t").write_text(str(time.monotonic_ns()))
            fall(how)
        return {**self._others, **super().step(observation)}
