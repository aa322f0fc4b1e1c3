"""The list of policies by name. The process of a policy makes the policy from ``module:factory`` and plain options.

Another package adds a policy by an entry point of the group ``strands_actors.policies``. A script adds one by
``register_policy``.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from msgspec import structs

from strands_actors.contract.axis import Axis
from strands_actors.contract.driver import Driver
from strands_actors.contract.loading import place_of

from . import waves


class Provider(NamedTuple):
    """The description of a policy that has a name.

    The process of the policy imports the class or function ``where``, and makes the policy by
    ``where(axes=..., **options)``.
    """

    where: str  # the policy's class or factory, as module:factory
    needs: str = ""  # package that must be installed
    extra: str = ""  # extra of this package that installs it
    takes_address: bool = True  # True if it has options host and port, which policy_host and policy_port set
    takes_units: bool = False  # True if it has options unit and travel, which the driver sets
    takes_cameras: bool = False  # True if it has options robot (its name) and cameras (their names)
    takes_axes: bool = True  # True if it has an option axes; otherwise it gets them by set_robot_state_keys


PROVIDERS = {
    "mock": Provider("strands_actors.policies.mock:Mock", takes_address=False),
    "sine": Provider("strands_actors.policies.registry:Sine", takes_address=False),
    "remote": Provider("strands_actors.policies.remote:Remote", takes_cameras=True),
    "groot": Provider("strands_actors.policies.groot_client:Groot", needs="zmq", extra="groot", takes_cameras=True),
    "lerobot_local": Provider(
        "strands_actors.policies.lerobot:LerobotLocal",
        needs="lerobot",
        extra="lerobot",
        takes_address=False,
        takes_units=True,
        takes_cameras=True,
    ),
    "onnx": Provider(
        "strands_actors.policies.onnx.policy:OnnxPolicy", needs="onnxruntime", extra="onnx", takes_address=False
    ),
}

ENDPOINT_PORT = 8765
"""Default port of an endpoint, as of the servers of strands-robots."""

SCHEMES = {"ws": "remote", "zmq": "groot"}
"""The policy for each kind of address: WebSocket, or ZeroMQ as servers of GR00T have it."""

DEFAULT_PORTS = {"ws": ENDPOINT_PORT, "zmq": 5555}

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
        TypeError: A name is empty or contains ``:`` or ``/``, or ``loader`` is not a function.

    Example:
        register_policy("hold", lambda: Hold)
        arm.start_task(policy_provider="hold")
    """
    names = (name, *aliases)
    if wrong := [
        each for each in names if not isinstance(each, str) or not each.strip() or ":" in each or "/" in each
    ]:
        raise TypeError(f"register_policy: the name is {wrong[0]!r}. Give text without : and /")
    if isinstance(loader, type) or not callable(loader):
        raise TypeError(f"register_policy: the loader is {loader!r}. Give a function that returns the class")
    in_use = [each for each in names if each in list_providers() or each in _aliases]
    if in_use and not overwrite:
        raise ValueError(
            f"register_policy: {', '.join(in_use)} is known already. Pass overwrite=True to replace it"
        )
    _aliases.pop(name, None)
    _registered[name] = loader
    _aliases.update(dict.fromkeys(aliases, name))


def registered_class(name: str) -> type[Any] | None:
    """Return the class that was registered under this name; None for any other name.

    Raises:
        ValueError: The registered loader does not return a class.
    """
    loader = _registered.get(_aliases.get(name, name))
    if loader is None:
        return None
    loaded = loader()
    if not isinstance(loaded, type):
        raise ValueError(f"policy {name!r}: its loader returned {loaded!r}. It has to return the class")
    return loaded


def list_providers() -> dict[str, Provider]:
    """Return all policies by name: built-in, of other packages, and registered by this script."""
    # Imported here, since the import takes 9 ms and only policies with a name need it.
    from importlib.metadata import entry_points

    points = entry_points(group="strands_actors.policies")
    providers = {point.name: Provider(point.value) for point in points} | PROVIDERS
    return providers | dict.fromkeys(_registered, Provider("", takes_address=False, takes_axes=False))


def is_alias(name: str) -> bool:
    """Return True if a name is another name of a registered policy."""
    return name in _aliases


def is_of_script(policy: type[Any]) -> bool:
    """Return True if only this process can make a policy, because the script itself defines its class."""
    return _is_of_script(policy.__module__, policy.__qualname__)


def _is_of_script(module: str, place: str) -> bool:
    return module == "__main__" or "<locals>" in place


def find_provider(name: str) -> Provider:
    """Return the description of a policy, by its name or by ``module:factory``.

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
        raise ValueError(f"policy_provider is {name!r}. Use one of {', '.join(sorted({*providers, *_aliases}))}")
    if provider.needs and importlib.util.find_spec(provider.needs) is None:
        others = ", ".join(sorted(name for name, entry in providers.items() if not entry.needs))
        raise ValueError(
            f"policy_provider {name!r} needs {provider.needs}: pip install 'strands-actors[{provider.extra}]'. "
            f"Policies that need no package are {others}"
        )
    return provider


def choose_provider(
    name: str, host: str, port: int | None, options: dict[str, Any]
) -> tuple[Provider, dict[str, Any]]:
    """Return the description of a policy that another process can make, and the options for it.

    Args:
        name: Name of the policy, ``module:factory``, or ``ws://host:port/path`` or
            ``zmq://host:port`` for a server.
        host: Host of a server.
        port: Port of a server; None if the policy needs no server.
        options: Keyword arguments of the policy.

    Raises:
        ValueError: The name or the port is wrong, or another process cannot import the policy. The text has
            the accepted values.
    """
    scheme, is_address, _ = name.partition("://") if isinstance(name, str) else ("", "", "")
    if is_address and scheme.lower() in SCHEMES:
        host, server_port, path = parse_endpoint(name)
        return find_provider(SCHEMES[scheme.lower()]), {**options, "host": host, "port": server_port, "path": path}
    provider = find_provider(name)
    module, _, place = provider.where.partition(":")
    if _is_of_script(module, place):
        raise ValueError(
            f"policy_provider {name!r} is {place}, which is defined in the script. start_task runs a policy in a "
            "separate process, which cannot import it. Move it to a module, or use run_policy(create_policy(...))"
        )
    if port is None:
        return provider, options
    if isinstance(port, bool) or not isinstance(port, int) or not 0 < port < 65536:
        raise ValueError(f"policy_port is {port!r}. Give a whole number from 1 to 65535")
    if not provider.takes_address:
        raise ValueError(f"policy_provider {name!r} takes no policy_port. Leave policy_port out")
    return provider, {**options, "host": host, "port": port}


def parse_endpoint(endpoint: str, schemes: Collection[str] = SCHEMES) -> tuple[str, int, str]:
    """Return host, port and path of an address such as ``ws://host:port/path``.

    Args:
        endpoint: The address.
        schemes: The accepted kinds of addresses.

    Raises:
        ValueError: It is a text of another form.
    """
    try:
        parts = urlsplit(endpoint)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or parts.scheme not in schemes:
        forms = " or ".join(f"{scheme}://host:port" for scheme in schemes)
        raise ValueError(f"remote: the endpoint is {endpoint!r}. Give {forms}")
    return host, port or DEFAULT_PORTS[parts.scheme], parts.path or "/"


def robot_facts(provider: Provider, driver: Driver, robot: str = "", cameras: Sequence[str] = ()) -> dict[str, Any]:
    """Return the facts that a policy needs about its robot (axes, units, cameras), as options of the policy.

    Args:
        provider: The policy's description, which declares the options that it takes.
        driver: The robot's driver.
        robot: Name under which the robot was started.
        cameras: Names of the robot's cameras.
    """
    facts: dict[str, Any] = {"axes": list(driver.axes)} if provider.takes_axes else {}
    if provider.takes_units:
        facts |= {"unit": driver.unit, "travel": driver.travel()}
    if provider.takes_cameras:
        facts |= {"robot": robot, "cameras": list(cameras)}
    return facts


class Sine:
    """The policy ``sine``: a slow sine on each axis, which begins slowly at the first observed position.

    As with ``mock``, the amplitude is smaller if an axis is too slow or has too little room.

    Args:
        axes: Names of the robot's axes.
        amplitude: Amplitude in the driver's units. If it is given, it is never reduced. None: 15, or less if the
            axis needs it.
        hz: Frequency in Hz.
        only: Names of the axes that move; empty for all axes.
        spread: Difference of phase from one axis to the next, as a share of a full turn.
        center: Center by axis, in the driver's units. Other axes swing around their first position.
        ease_s: Time until the sine has its full amplitude, in seconds.
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
        self._is_requested = amplitude is not None
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
        """Set range and speed of the robot's axes, which limit the amplitude."""
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
        return {axis: swing.target(t_s, value, self._ease_s) for (axis, swing), value in rows}

    def _fit(self, axis: str, observation: Mapping[str, float]) -> waves.Swing:
        position, center = observation[axis], self._center.get(axis)
        if axis not in self._table:
            return waves.Swing(position, position if center is None else center, self._amplitude, self._hz)
        swing = waves.fit(self._table[axis], position, self._amplitude, self._hz, self._is_requested, self._ease_s)
        return swing if center is None else structs.replace(swing, center=center)
