"""Policies by name. Each is built in a process of its own, from ``module:factory`` and plain
options.

Another package adds one by the entry point group ``strands_actors.policies``, a script by
``register_policy``.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from msgspec import structs

from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import place_of

from . import waves


class Provider(NamedTuple):
    """How a policy is built: ``where(axes=..., **options)`` in a process of its own."""

    where: str  # module:factory
    needs: str = ""  # a package that must be there; the extra that brings it has the same name
    takes_address: bool = True  # options host and port, from policy_host and policy_port
    takes_units: bool = False  # options unit and travel, as the driver has them
    takes_cameras: bool = False  # options robot and cameras: the name it runs by, and those it has
    takes_axes: bool = True  # option axes; else they are told by set_robot_state_keys alone


PROVIDERS = {
    "mock": Provider("strands_actors.policies.mock:Mock", takes_address=False),
    "sine": Provider("strands_actors.policies.registry:Sine", takes_address=False),
    "remote": Provider("strands_actors.policies.remote:Remote"),
    "lerobot_local": Provider(
        "strands_actors.policies.lerobot:LerobotLocal",
        needs="lerobot",
        takes_address=False,
        takes_units=True,
        takes_cameras=True,
    ),
}

ENDPOINT_PORT = 8765
"""Of an endpoint without one, as the servers of strands-robots have it."""

SINE_AMPLITUDE = 15.0
SINE_CALLS_HZ = 25.0
"""So often at most a sine is asked for actions: it has as many as are executed meanwhile."""

DEFAULT_PROVIDER = "lerobot_local"
"""As on the drivers page, and for a reason: who forgets to name a policy gets a refusal, not a
moving arm."""


Loader = Callable[[], type[Any]]

_registered: dict[str, Loader] = {}
_aliases: dict[str, str] = {}


def register_policy(name: str, loader: Loader, aliases: Iterable[str] = (), *, overwrite: bool = False) -> None:
    """Make a policy known by name, for this process. ``loader`` returns its class, when it is
    needed; ``aliases`` are other names of it. Raise ``ValueError`` for a name that is taken (unless
    ``overwrite``), ``TypeError`` for what is no name or no function."""
    names = (name, *aliases)
    if wrong := [one for one in names if not isinstance(one, str) or not one.strip() or ":" in one or "/" in one]:
        raise TypeError(f"register_policy: the name is {wrong[0]!r}. give text without : and /")
    if isinstance(loader, type) or not callable(loader):
        raise TypeError(f"register_policy: the loader is {loader!r}. give a function that returns the class")
    taken = [one for one in names if one in list_providers() or one in _aliases]
    if taken and not overwrite:
        raise ValueError(f"register_policy: {', '.join(taken)} is known already. pass overwrite=True to replace it")
    _aliases.pop(name, None)
    _registered[name] = loader
    _aliases.update(dict.fromkeys(aliases, name))


def registered_class(name: str) -> type[Any] | None:
    """Return the class that ``register_policy`` was told under this name. Raise ``ValueError`` when
    its loader returns none."""
    loader = _registered.get(_aliases.get(name, name))
    if loader is None:
        return None
    found = loader()
    if not isinstance(found, type):
        raise ValueError(f"policy {name!r}: its loader returned {found!r}. it has to return the class")
    return found


def list_providers() -> dict[str, Provider]:
    """By name; those of other packages and of this script too."""
    from importlib.metadata import entry_points  # 9 ms, for who names a policy

    points = entry_points(group="strands_actors.policies")
    known = {point.name: Provider(point.value) for point in points} | PROVIDERS
    return known | dict.fromkeys(_registered, Provider("", takes_address=False, takes_axes=False))


def find_provider(name: str) -> Provider:
    """Raise ``ValueError`` with those there are, for a name that is none."""
    known = list_providers()
    chosen = _aliases.get(name, name) if isinstance(name, str) else name
    if chosen in _registered:
        found = registered_class(chosen)
        assert found is not None
        return known[chosen]._replace(where=place_of(found))
    provider = Provider(name) if ":" in str(name) else known.get(name)
    if provider is None:
        raise ValueError(f"policy_provider is {name!r}. use one of {', '.join(sorted({*known, *_aliases}))}")
    if provider.needs and importlib.util.find_spec(provider.needs) is None:
        others = ", ".join(sorted(name for name, other in known.items() if not other.needs))
        raise ValueError(
            f"policy_provider {name!r} needs {provider.needs}: pip install 'strands-actors[{provider.needs}]'. "
            f"without it there are {others}"
        )
    return provider


def choose_provider(
    name: str, host: str, port: int | None, options: dict[str, Any]
) -> tuple[Provider, dict[str, Any]]:
    """Return a provider that another process can build, and its options. A name in the form
    ``module:factory`` is taken as it is. Raise ``ValueError`` with what would be accepted."""
    if isinstance(name, str) and name.lower().startswith("ws://"):
        host, at, path = parse_endpoint(name)
        return PROVIDERS["remote"], {**options, "host": host, "port": at, "path": path}
    provider = find_provider(name)
    module, _, place = provider.where.partition(":")
    if module == "__main__" or "<locals>" in place:
        raise ValueError(
            f"policy_provider {name!r} is {place}, which stands in the script itself, and start_task runs a policy "
            "in a process of its own. move it to a module, or use run_policy(create_policy(...))"
        )
    if port is None:
        return provider, options
    if isinstance(port, bool) or not isinstance(port, int) or not 0 < port < 65536:
        raise ValueError(f"policy_port is {port!r}. give a whole number from 1 to 65535")
    if not provider.takes_address:
        raise ValueError(f"policy_provider {name!r} takes no policy_port. policy_provider='remote' does")
    return provider, {**options, "host": host, "port": port}


def parse_endpoint(endpoint: str) -> tuple[str, int, str]:
    """Return host, port and path of ``ws://host:port/path``. Raise ``ValueError``."""
    try:
        parts = urlsplit(endpoint)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or parts.scheme != "ws":
        raise ValueError(f"remote: the endpoint is {endpoint!r}. give ws://host:port")
    return host, port or ENDPOINT_PORT, parts.path or "/"


def robot_facts(provider: Provider, driver: Driver, robot: str = "", cameras: Sequence[str] = ()) -> dict[str, Any]:
    """Return what a policy is told of the robot, as options. ``robot``: the name it runs by."""
    facts: dict[str, Any] = {"axes": list(driver.axes)} if provider.takes_axes else {}
    if provider.takes_units:
        facts |= {"unit": driver.unit, "travel": driver.travel()}
    if provider.takes_cameras:
        facts |= {"robot": robot, "cameras": list(cameras)}
    return facts


class Sine:
    """A slow sine on every axis, eased into from where the axis was first seen. It begins as ``mock``
    does: it is smaller where an axis is too slow for it or has not enough room.

    ``amplitude`` and ``center`` in the driver's units; one that is given is kept. ``spread``: how far
    each axis is ahead of the one before, in turns.
    """

    def __init__(
        self,
        axes: Sequence[str],
        amplitude: float | None = None,
        hz: float = 0.25,
        only: Sequence[str] = (),
        spread: float = 0.0,
        center: Mapping[str, float] | None = None,
        ease_s: float = waves.EASE_S,
    ) -> None:
        self._axes = list(only) or list(axes)
        self._is_asked = amplitude is not None
        self._amplitude = SINE_AMPLITUDE if amplitude is None else amplitude
        self._hz = hz
        self._spread = spread
        self._center = dict(center or {})
        self._ease_s = ease_s
        self._table: Mapping[str, Axis] = {}
        self._dt_s = 0.02
        self._chunk = 1
        self._steps = 0
        self._swings: dict[str, waves.Swing] = {}

    def set_control_frequency(self, hz: float) -> None:
        """Be told the rate at which its actions are executed."""
        self._dt_s, self._chunk = 1.0 / hz, math.ceil(hz / SINE_CALLS_HZ)

    def set_robot_axes(self, axes: Sequence[Axis]) -> None:
        """Be told what the robot's axes can do."""
        self._table = {axis.key: axis for axis in axes}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        """Return the next actions, one a control period."""
        return [self.step(observation) for _ in range(self._chunk)]

    def step(self, observation: Mapping[str, float]) -> dict[str, float]:
        """Return the next action."""
        if not self._swings:
            self._swings = {axis: self._fit(axis, observation) for axis in self._axes if axis in observation}
        t_s = self._steps * self._dt_s
        self._steps += 1
        wave = [math.sin(math.tau * (self._hz * t_s + j * self._spread)) for j in range(len(self._swings))]
        rows = zip(self._swings.items(), wave, strict=True)
        return {axis: swing.at(t_s, one, self._ease_s) for (axis, swing), one in rows}

    def _fit(self, axis: str, observation: Mapping[str, float]) -> waves.Swing:
        here, given = observation[axis], self._center.get(axis)
        if axis not in self._table:
            return waves.Swing(here, here if given is None else given, self._amplitude, self._hz)
        swing = waves.fit(self._table[axis], here, self._amplitude, self._hz, self._is_asked, self._ease_s)
        return swing if given is None else structs.replace(swing, center=given)
