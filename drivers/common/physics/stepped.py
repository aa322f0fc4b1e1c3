"""Simulate the motion of robots without forces, in small steps, as their clock goes on."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any

from .body import TIMESTEP_S, Commander, Felt

LONGEST_S = 0.25
"""Longest time that is simulated at once after a pause. The rest of a longer pause is skipped."""

_LEAST_S = 1e-9
"""The rounding error of a sum of steps is no step: a speed over it would be noise."""


def towards(now: float, goal: float, most: float) -> float:
    """Return the value that is nearest to ``goal`` and at most ``most`` away from ``now``."""
    return now + max(-most, min(most, goal - now))


class Stepped(ABC):
    """A mechanism that is advanced in steps. ``time_s`` is its own time, in seconds."""

    STEP_S = 0.01
    """Longest step."""

    def __init__(self, now_s: Callable[[], float]) -> None:
        self.now_s = now_s
        self._updated_s = now_s()
        self.time_s = 0.0

    def pass_time(self) -> None:
        """Advance the simulation to the present time."""
        now_s = self.now_s()
        passed_s, self._updated_s = now_s - self._updated_s, now_s
        self.run(min(passed_s, LONGEST_S))

    def run(self, seconds: float) -> None:
        """Advance the simulation by ``seconds``."""
        while seconds > _LEAST_S:
            step_s = min(seconds, self.STEP_S)
            seconds -= step_s
            self.time_s += step_s
            self._step(step_s)

    @abstractmethod
    def _step(self, step_s: float) -> None:
        """Advance everything but ``time_s``."""


class PlanarBase(Stepped):
    """A base that moves in the plane, as its ``commander`` demands."""

    x_m = y_m = yaw_rad = 0.0
    commander = Commander.NONE

    def __init__(self, watchdog_s: float, now_s: Callable[[], float]) -> None:
        """Make a base at its start.

        Args:
            watchdog_s: A command of the wire expires after so many seconds without another one. 0: never.
            now_s: The clock.
        """
        super().__init__(now_s)
        self._watchdog_s = watchdog_s
        self._commanded_s = now_s()

    @property
    def is_overdue(self) -> bool:
        """True if the watchdog has expired."""
        return self.commander is Commander.WIRE and 0 < self._watchdog_s < self.now_s() - self._commanded_s

    def _roll(self, vx_m_s: float, vy_m_s: float, wz_rad_s: float, step_s: float) -> None:
        """Move by a twist in the base's own frame."""
        self.yaw_rad += wz_rad_s * step_s
        ahead, across = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        self.x_m += (vx_m_s * ahead - vy_m_s * across) * step_s
        self.y_m += (vx_m_s * across + vy_m_s * ahead) * step_s


class DrawnBody(ABC):
    """The body of such a robot, as a simulation uses it. Its model in MuJoCo only draws it."""

    axes: tuple[str, ...] = ()

    def __init__(self, table: Mapping[str, Any], mechanism: Stepped) -> None:
        self._table = table
        self.__mechanism = mechanism
        self.pass_time = mechanism.pass_time

    @cached_property
    def spec(self) -> Any:
        # Import MuJoCo only here, since a robot that is not drawn does not need it.
        from .model_rows import build

        return build(self._table)

    @property
    @abstractmethod
    def commanders(self) -> Sequence[Commander]:
        """The controller of each axis."""

    def _felt(self, position: Sequence[float], velocity: Sequence[float] = ()) -> Felt:
        """Return readings without efforts."""
        still = (0.0,) * len(self.axes)
        return Felt(self.__mechanism.time_s, position, velocity or still, still, self.commanders)

    def step(self, steps: int) -> None:
        self.__mechanism.run(steps * TIMESTEP_S)


__all__ = ["LONGEST_S", "DrawnBody", "PlanarBase", "Stepped", "towards"]
