"""Policies by name. Each is built in a process of its own, from ``module:factory`` and plain
options.

Another package adds one by the entry point group ``strands_actors.policies``.
"""

from __future__ import annotations

import importlib.util
import math
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.contract.driver import Driver


class Provider(NamedTuple):
    """How a policy is built: ``where(axes=..., **options)`` in a process of its own."""

    where: str  # module:factory
    needs: str = ""  # a package that must be there; the extra that brings it has the same name
    takes_address: bool = True  # options host and port, from policy_host and policy_port
    takes_units: bool = False  # options unit and travel, as the driver has them


PROVIDERS = {
    "mock": Provider("strands_actors.policies.registry:Mock", takes_address=False),
    "sine": Provider("strands_actors.policies.registry:Sine", takes_address=False),
    "remote": Provider("strands_actors.policies.remote:Remote"),
    "lerobot_local": Provider(
        "strands_actors.policies.lerobot:LerobotLocal", needs="lerobot", takes_address=False, takes_units=True
    ),
}

DEFAULT_PROVIDER = "lerobot_local"
"""As on the drivers page, and for a reason: who forgets to name a policy gets a refusal, not a
moving arm."""


def list_providers() -> dict[str, Provider]:
    """By name; those of other packages too."""
    from importlib.metadata import entry_points  # 9 ms, for who names a policy

    points = entry_points(group="strands_actors.policies")
    return {point.name: Provider(point.value) for point in points} | PROVIDERS


def choose_provider(name: str, host: str, port: int | None, options: dict[str, Any]) -> tuple[str, dict[str, Any]]:
    """``module:factory`` of a provider, and its options. A name in that form is taken as it is.
    Raise ``ValueError`` with what would be accepted."""
    known = list_providers()
    provider = Provider(name) if ":" in str(name) else known.get(name)
    if provider is None:
        raise ValueError(f"policy_provider is {name!r}. use one of {', '.join(sorted(known))}")
    if provider.needs and importlib.util.find_spec(provider.needs) is None:
        others = ", ".join(sorted(name for name, other in known.items() if not other.needs))
        raise ValueError(
            f"policy_provider {name!r} needs {provider.needs}: pip install 'strands-actors[{provider.needs}]'. "
            f"without it there are {others}"
        )
    if port is None:
        return provider.where, options
    if isinstance(port, bool) or not isinstance(port, int) or not 0 < port < 65536:
        raise ValueError(f"policy_port is {port!r}. give a whole number from 1 to 65535")
    if not provider.takes_address:
        raise ValueError(f"policy_provider {name!r} takes no policy_port. policy_provider='remote' does")
    return provider.where, {**options, "host": host, "port": port}


def robot_facts(where: str, driver: Driver) -> dict[str, Any]:
    """What the policy at ``where`` is told of the robot, as options."""
    facts: dict[str, Any] = {"axes": list(driver.axes)}
    if any(provider.where == where and provider.takes_units for provider in PROVIDERS.values()):
        facts |= {"unit": driver.unit, "travel": driver.travel()}
    return facts


class Mock:
    """The drivers page's mock: chunks of 8 actions 0.02 s apart, amplitude 0.5 in the driver's
    units around where each axis was first seen, f_j = 0.3 + 0.15 j Hz, phase j pi/3."""

    CHUNK = 8
    DT_S = 0.02

    provider_name = "mock"
    requires_images = False
    reads_instruction = False
    execution_horizon = CHUNK

    def __init__(self, axes: Sequence[str], amplitude: float = 0.5) -> None:
        self._axes = axes
        self._amplitude = amplitude
        self._step = 0
        self._center: dict[str, float] = {}

    def set_robot_state_keys(self, keys: Sequence[str]) -> None:
        self._axes = keys

    def reset(self, seed: int | None = None) -> None:
        """Begin anew, around where the axes are then. There is nothing random in it."""
        self._step = 0
        self._center = {}

    def get_actions_sync(
        self, observation: Mapping[str, float], instruction: str, **more: Any
    ) -> list[dict[str, float]]:
        if not self._center:
            self._center = {axis: observation[axis] for axis in self._axes}
        actions = []
        for _ in range(self.CHUNK):
            t_s = self._step * self.DT_S
            self._step += 1
            actions.append({axis: self._at(j, axis, t_s) for j, axis in enumerate(self._axes)})
        return actions

    def _at(self, j: int, axis: str, t_s: float) -> float:
        phase = j * math.pi / 3
        wave = math.sin(2 * math.pi * (0.3 + 0.15 * j) * t_s + phase) - math.sin(phase)
        return self._center[axis] + self._amplitude * wave


class Sine:
    """A slow sine on every axis, eased into from where the axis was first seen. One action a call.

    ``amplitude`` and ``center`` in the driver's units; the center of an axis that is not named is
    where it was first seen. ``spread``: how far each axis is ahead of the one before, in turns.
    """

    def __init__(
        self,
        axes: Sequence[str],
        amplitude: float = 15.0,
        hz: float = 0.25,
        only: Sequence[str] = (),
        spread: float = 0.0,
        center: Mapping[str, float] | None = None,
        ease_s: float = 1.0,
    ) -> None:
        self._axes = list(only) or list(axes)
        self._amplitude = amplitude
        self._hz = hz
        self._spread = spread
        self._center = dict(center or {})
        self._ease_s = ease_s
        self._start: dict[str, float] = {}
        self._began_s = 0.0

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        now_s = time.monotonic()
        if not self._start:
            self._start = {axis: observation[axis] for axis in self._axes}
            self._began_s = now_s
        passed_s = now_s - self._began_s
        share = min(1.0, passed_s / self._ease_s)
        ease = share * share * (3 - 2 * share)
        action = {}
        for j, (axis, start) in enumerate(self._start.items()):
            wave = self._amplitude * _sine(self._hz * passed_s + j * self._spread)
            action[axis] = start + ease * (self._center.get(axis, start) + wave - start)
        return action


def _sine(turns: float) -> float:
    return math.sin(2 * math.pi * turns)
