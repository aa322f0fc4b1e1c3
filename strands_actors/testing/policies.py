"""A policy that fails on command."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from strands_actors.policies.registry import Sine
from strands_actors.supervisors.introspection import fall


class Faulty(Sine):
    """A ``Sine`` that fails when the file ``trigger`` appears.

    The file's content is the fault: exception, exit or spin. The time of the fault goes to ``<trigger>.t``
    (CLOCK_MONOTONIC nanoseconds).

    Args:
        axes: The axes of the robot.
        trigger: The path of the file.
        amplitude: The amplitude of the motion, in the driver's units.
        hz: The frequency of the motion.
        joint: The joint that moves. Empty if all joints move.
        others: The positions of the other joints, for a robot that needs all joints in each action.
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
        """Return the next action of ``Sine``, with the other joints. Fail if the file ``trigger`` exists."""
        if self._trigger.exists():
            how = self._trigger.read_text()
            Path(f"{self._trigger}.t").write_text(str(time.monotonic_ns()))
            fall(how)
        return {**self._others, **super().step(observation)}
