"""``mock``: a policy that needs nothing, for a first try and for tests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import Axis

from . import waves
from .base import Action, Policy

AMPLITUDE = 0.5


class MockPolicy(Policy):
    """The drivers page's mock: chunks of 8 actions, amplitude 0.5 in the driver's units around where
    each axis was first seen, f_j = 0.3 + 0.15 j Hz, phase j pi/3.

    In a rollout it is told the robot's axes and its control rate. The wave is then eased in, and
    smaller where an axis is too slow for it or has not enough room. Without these its actions are
    0.02 s apart and begin on the wave at once.

    Args:
        amplitude: In the robot's units. One that is given is kept, whatever the axes can do.
        seed: Changes nothing: there is nothing random in it.
    """

    CHUNK = 8
    DT_S = 0.02

    reads_instruction = False

    def __init__(self, amplitude: float | None = None, seed: int | None = None) -> None:
        self._is_asked = amplitude is not None
        amplitude = AMPLITUDE if amplitude is None else amplitude
        if isinstance(amplitude, bool) or not isinstance(amplitude, int | float) or not 0 <= amplitude < math.inf:
            raise ValueError(f"mock: amplitude is {amplitude!r}. give a number, at least 0, in the robot's units")
        self._amplitude = float(amplitude)
        self._step = 0
        self._center: dict[str, float] = {}
        self._swings: dict[str, waves.Swing] = {}
        self._table: Sequence[Axis] = ()
        self._dt_s = self.DT_S

    @property
    def provider_name(self) -> str:
        return "mock"

    @property
    def requires_images(self) -> bool:
        return False

    @property
    def execution_horizon(self) -> int:
        return self.CHUNK

    def reset(self, seed: int | None = None) -> None:
        """Begin anew, around where the axes are then."""
        self._step = 0
        self._center, self._swings = {}, {}

    def set_control_frequency(self, hz: float) -> None:
        """Be told the rate at which its actions are executed."""
        self._dt_s = 1.0 / hz

    def set_robot_axes(self, axes: Sequence[Axis]) -> None:
        """Be told what the robot's axes can do."""
        self._table = axes

    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        return self.get_actions_sync(observation_dict, instruction)

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        if not self._center:
            self._center = {axis: observation_dict[axis] for axis in self.robot_state_keys or observation_dict}
            hz = [_hz(j) for j in range(len(self._table))]
            self._swings = waves.swings(self._table, self._center, self._amplitude, hz, self._is_asked)
        actions = []
        for _ in range(self.CHUNK):
            t_s = self._step * self._dt_s
            self._step += 1
            known = self._swings or self._center
            actions.append({axis: self._at(j, axis, t_s) for j, axis in enumerate(self._center) if axis in known})
        return actions

    def _at(self, j: int, axis: str, t_s: float) -> float:
        phase = j * math.pi / 3
        wave = math.sin(math.tau * _hz(j) * t_s + phase)
        if axis in self._swings:
            return self._swings[axis].at(t_s, wave)
        return self._center[axis] + self._amplitude * (wave - math.sin(phase))


def _hz(j: int) -> float:
    """Return the frequency of the j-th axis."""
    return 0.3 + 0.15 * j


class Mock(MockPolicy):
    """The same, as a provider: its axes are told first."""

    def __init__(self, axes: Sequence[str], amplitude: float | None = None, seed: int | None = None) -> None:
        super().__init__(amplitude, seed)
        self.set_robot_state_keys(axes)
