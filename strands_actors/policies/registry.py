"""The list of policies by name. A policy process builds one from ``module:factory`` and plain options.

Another package adds a policy by the entry point group ``strands_actors.policies``, a script by
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
    """How a policy is built: ``where(axes=..., **options)`` in a separate process."""

    where: str  # module:factory
    needs: str = ""  # a package that must be installed; the extra for it has the same name
    takes_address: bool = True  # it has options host and port, from policy_host and policy_port
    takes_units: bool = False  # it has options unit and travel, from the driver
    takes_cameras: bool = False  # it has options robot (its name) and cameras (names)
    takes_axes: bool = True  # it has an option axes; otherwise only set_robot_state_keys sets them


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
"""Default port of an endpoint, as of the servers of strands-robots."""

SINE_AMPLITUDE = 15.0
SINE_CALLS_HZ = 25.0
"""Highest rate at which chunks of a sine are requested. A chunk has the actions of one such period."""

DEFAULT_PROVIDER = "lerobot_local"
"""The default of strands-robots' drivers page. If the user forgets the name of a policy, the result is a
refusal, and not a moving arm."""


Loader = Callable[[], type[Any]]

_registered: dict[str, Loader] = {}
_aliases: dict[str, str] = {}


def register_policy(name: str, loader: Loader, aliases: Iterable[str] = (), *, overwrite: bool = False) -> None:
    """Register a policy under a name, in this process.

    Args:
        name: Name of the policy, without ``:`` and ``/``.
        loader: Function that returns the class of the policy. It is called when the class is needed.
        aliases: Other names of the policy.
        overwrite: True replaces a policy of the same name.

    Raises:
        ValueError: A name is in use, and ``overwrite`` is false.
        TypeError: A name is not such a text, or ``loader`` is not a function.

    Example:
        register_policy("hold", lambda: Hold)
        arm.start_task(policy_provider="hold")
    """
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
    """Return the class that was registered under this name; None for any other name.

    Raises:
        ValueError: Its loader does not return a class.
    """
    loader = _registered.get(_aliases.get(name, name))
    if loader is None:
        return None
    loaded = loader()
    if not isinstance(loaded, type):
        raise ValueError(f"policy {name!r}: its loader returned {loaded!r}. it has to return the class")
    return loaded


def list_providers() -> dict[str, Provider]:
    """Return all policies by name: built-in, of other packages, and registered by this script."""
    from importlib.metadata import entry_points  # Its import costs 9 ms, and only named policies need it.

    points = entry_points(group="strands_actors.policies")
    providers = {point.name: Provider(point.value) for point in points} | PROVIDERS
    return providers | dict.fromkeys(_registered, Provider("", takes_address=False, takes_axes=False))


def find_provider(name: str) -> Provider:
    """Return a policy by its name, or for ``module:factory``.

    Raises:
        ValueError: The name is unknown, or a package that it needs is missing. The text has the known names.
    """
    providers = list_providers()
    chosen = _aliases.get(name, name) if isinstance(name, str) else name
    if chosen in _registered:
        registered = registered_class(chosen)
        assert registered is not None
        return providers[chosen]._replace(where=place_of(registered))
    provider = Provider(name) if ":" in str(name) else providers.get(name)
    if provider is None:
        raise ValueError(f"policy_provider is {name!r}. use one of {', '.join(sorted({*providers, *_aliases}))}")
    if provider.needs and importlib.util.find_spec(provider.needs) is None:
        others = ", ".join(sorted(name for name, other in providers.items() if not other.needs))
        raise ValueError(
            f"policy_provider {name!r} needs {provider.needs}: pip install 'strands-actors[{provider.needs}]'. "
            f"without it there are {others}"
        )
    return provider


def choose_provider(
    name: str, host: str, port: int | None, options: dict[str, Any]
) -> tuple[Provider, dict[str, Any]]:
    """Return a policy that another process can build, and its options.

    Args:
        name: Name of the policy, ``module:factory``, or ``ws://host:port/path`` for a server.
        host: Host of a server.
        port: Port of a server; None if the policy needs no server.
        options: Keyword arguments of the policy.

    Raises:
        ValueError: The name or the port is wrong, or another process cannot import the policy. The text has
            the accepted values.
    """
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
    """Return the facts of a robot as options of a policy.

    Args:
        provider: The policy, which declares the facts that it takes.
        driver: The robot's driver.
        robot: The name by which the robot runs.
        cameras: Names of its cameras.
    """
    facts: dict[str, Any] = {"axes": list(driver.axes)} if provider.takes_axes else {}
    if provider.takes_units:
        facts |= {"unit": driver.unit, "travel": driver.travel()}
    if provider.takes_cameras:
        facts |= {"robot": robot, "cameras": list(cameras)}
    return facts


class Sine:
    """The policy ``sine``: a slow sine on each axis, eased in from the first observed position.

    As with ``mock``, the amplitude is smaller if an axis is too slow or has too little room.

    Args:
        axes: Names of the robot's axes.
        amplitude: Amplitude in the driver's units. It is then never reduced. None: 15, or less.
        hz: Frequency.
        only: Names of the axes that move; empty for all axes.
        spread: Phase from one axis to the next, in turns.
        center: Center by axis, in the driver's units. Other axes swing around their first position.
        ease_s: Time in which the sine is eased in, in seconds.
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
        """Set the rate at which the actions are executed."""
        self._dt_s, self._chunk = 1.0 / hz, math.ceil(hz / SINE_CALLS_HZ)

    def set_robot_axes(self, axes: Sequence[Axis]) -> None:
        """Set range and speed of the robot's axes."""
        self._table = {axis.key: axis for axis in axes}

    def get_actions_sync(self, observation: Mapping[str, float], instruction: str) -> list[dict[str, float]]:
        """Return the next actions, one per control period."""
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
