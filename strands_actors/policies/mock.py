"""``mock``: a policy that needs nothing, for a first try and for tests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from .base import Action, Policy


class MockPolicy(Policy):
    """The drivers page's mock: chunks of 8 actions 0.02 s apart, amplitude 0.5 in the driver's
    units around where each axis was first seen, f_j = 0.3 + 0.15 j Hz, phase j pi/3. ``seed``
    changes nothing: there is nothing random in it."""

    CHUNK = 8
    DT_S = 0.02

    reads_instruction = False

    def __init__(self, amplitude: float = 0.5, seed: int | None = None) -> None:
        if isinstance(amplitude, bool) or not isinstance(amplitude, int | float) or not 0 <= amplitude < math.inf:
            raise ValueError(f"mock: amplitude is {amplitude!r}. give a number, at least 0, in the robot's units")
        self._amplitude = float(amplitude)
        self._step = 0
        self._center: dict[str, float] = {}

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
        self._center = {}

    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        return self.get_actions_sync(observation_dict, instruction)

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        if not self._center:
            self._center = {axis: observation_dict[axis] for axis in self.robot_state_keys or observation_dict}
        actions = []
        for _ in range(self.CHUNK):
            t_s = self._step * self.DT_S
            self._step += 1
            actions.append({axis: self._at(j, axis, t_s) for j, axis in enumerate(self._center)})
        return actions

    def _at(self, j: int, axis: str, t_s: float) -> float:
        phase = j * math.pi / 3
        wave = math.sin(2 * math.pi * (0.3 + 0.15 * j) * t_s + phase) - math.sin(phase)
        return self._center[axis] + self._amplitude * wave


class Mock(MockPolicy):
    """The same, as a provider: its axes are told first."""

    def __init__(self, axes: Sequence[str], amplitude: float = 0.5, seed: int | None = None) -> None:
        super().__init__(amplitude, seed)
        self.set_robot_state_keys(axes)
