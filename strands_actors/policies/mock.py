"""The policy ``mock``: slow waves that need no model, for a first try and for tests."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import Axis

from . import waves
from .base import Action, Policy

AMPLITUDE = 0.5


class MockPolicy(Policy):
    """The mock policy of strands-robots' drivers page: a sine on each axis.

    It returns chunks of 8 actions. In this description axes are numbered from 0 as ``j``. Axis j swings around its
    first position with amplitude 0.5 in the driver's units, frequency 0.3 + 0.15 j Hz, and phase j pi/3.

    When a robot runs the policy, it sets its axes and control rate. The wave then begins slowly, and its amplitude
    is smaller if an axis is too slow or has too little room. If the policy is called without a robot, the actions
    are 0.02 s apart, and the wave has its full amplitude from the beginning.

    Args:
        amplitude: Amplitude in the robot's units. If it is given, it is never reduced, and the robot may refuse the
            actions.
        seed: No effect, since the policy is not random.
    """

    CHUNK = 8
    DT_S = 0.02

    reads_instruction = False

    def __init__(self, amplitude: float | None = None, seed: int | None = None) -> None:
        self._is_requested = amplitude is not None
        amplitude = AMPLITUDE if amplitude is None else amplitude
        if isinstance(amplitude, bool) or not isinstance(amplitude, int | float) or not 0 <= amplitude < math.inf:
            raise ValueError(f"mock: amplitude is {amplitude!r}. Give a number, at least 0, in the robot's units")
        self._amplitude = float(amplitude)
        self._step = 0
        self._center: dict[str, float] = {}
        self._swings: dict[str, waves.Swing] = {}
        self._table: Sequence[Axis] = ()
        self._dt_s = self.DT_S

    @property
    def provider_name(self) -> str:
        """The name of the policy, ``mock``."""
        return "mock"

    @property
    def requires_images(self) -> bool:
        """False, since the policy uses only positions."""
        return False

    @property
    def execution_horizon(self) -> int:
        """The number of actions of a chunk, ``CHUNK``."""
        return self.CHUNK

    def reset(self, seed: int | None = None) -> None:
        """Start the wave again, around the next observed positions."""
        self._step = 0
        self._center, self._swings = {}, {}

    def set_control_frequency(self, hz: float) -> None:
        """Set the rate at which the actions are executed."""
        self._dt_s = 1.0 / hz

    def set_robot_axes(self, axes: Sequence[Axis]) -> None:
        """Set range and speed of the robot's axes, which limit the amplitude."""
        self._table = axes

    async def get_actions(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next ``CHUNK`` actions. The arguments are those of ``get_actions_sync``."""
        return self.get_actions_sync(observation_dict, instruction)

    def get_actions_sync(self, observation_dict: Mapping[str, Any], instruction: str, **more: Any) -> list[Action]:
        """Return the next ``CHUNK`` actions.

        The first call, and the first after ``reset``, takes the observed positions as the beginning of the waves.
        Later calls do not read ``observation_dict``.
        """
        if not self._center:
            self._center = {axis: observation_dict[axis] for axis in self.robot_state_keys or observation_dict}
            hz = [_hz(j) for j in range(len(self._table))]
            self._swings = waves.swings(self._table, self._center, self._amplitude, hz, self._is_requested)
        actions = []
        for _ in range(self.CHUNK):
            t_s = self._step * self._dt_s
            self._step += 1
            moving = self._swings or self._center
            actions.append(
                {axis: self._target(j, axis, t_s) for j, axis in enumerate(self._center) if axis in moving}
            )
        return actions

    def _target(self, j: int, axis: str, t_s: float) -> float:
        phase = j * math.pi / 3
        wave = math.sin(math.tau * _hz(j) * t_s + phase)
        if axis in self._swings:
            return self._swings[axis].target(t_s, wave)
        return self._center[axis] + self._amplitude * (wave - math.sin(phase))


def _hz(j: int) -> float:
    """Return the frequency of axis number j, in Hz."""
    return 0.3 + 0.15 * j


class Mock(MockPolicy):
    """``MockPolicy`` in the form that ``start_task`` needs: it gets the axes as an argument."""

    def __init__(self, axes: Sequence[str], amplitude: float | None = None, seed: int | None = None) -> None:
        super().__init__(amplitude, seed)
        self.set_robot_state_keys(axes)
