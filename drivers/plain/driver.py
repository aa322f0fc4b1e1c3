"""Run a user's driver class as a robot of this package. The class has plain methods and no actors.

The class is not changed. Its object exists in the wire process only, the process that talks to the robot. Its
methods run one at a time, each with a timeout. If a method hangs, the process is killed. A thread of the class,
such as one that repeats setpoints, ends with that process.

This package does not know the robot's protocol, so it cannot stop the robot by itself after the wire process has
ended. A second process is kept ready for this: it makes a new object of the class, connects it and calls its
``stop()``. If the class has ``stop_channel(port)``, that function is called instead, without an object. Only the
answer of the class confirms that the robot has stopped. ``members`` describes how the axes are found.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.tool_verbs import MOVE_AT_ONCE, STATUS, STOP, ToolVerb
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.contract.wire import WireDown
from strands_actors.kernel.messages import Refused

from .class_location import location_of_class
from .config import LATE_S, Deadlines, PlainConfig
from .gates import CONDITIONS, all_gates
from .members import SENSED, declared_by

MARGIN_S = 0.5
LEAVING = (Reason.CLEANUP, Reason.CALLER, Reason.ROOT)
"""Reasons of a stop after which the object is not used any more."""
NEVER_S = 3600.0
SECRET_WORDS = ("password", "passwd", "token", "secret", "api_key", "credential")
"""Words in the name of a keyword that keep its value out of recordings, certificates and answers."""


class PlainDriver(Driver):
    """A robot with a user's driver class. ``options_of`` makes its ``options``."""

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ()
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TRANSPORTS: ClassVar[tuple[str, ...]] = ()
    WIRE: ClassVar[str] = "strands_actors.drivers.plain.wire:PlainWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.plain.stop_channel:PlainStopChannel"
    TWIN: ClassVar[str] = ""
    SECRETS: ClassVar[frozenset[str]] = frozenset({"secrets"})
    SIMULATION: ClassVar[str] = "a driver class of your own has none"
    DEADLINES: ClassVar[Deadlines] = Deadlines()
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (MOVE_AT_ONCE, READ_SENSORS, STATUS, STOP)

    fallbacks: Mapping[Reason, SafeState] = {
        reason: SafeState.OFF if reason in LEAVING else SafeState.STOP for reason in Reason
    }
    """``stop`` calls the class's ``stop()``. ``off`` also calls its ``cleanup()``, which ends its
    connection."""
    firmware_watchdog = "Not known, because the class does not declare it"
    bound_s = 1.0
    """In seconds, without the times that the class takes to connect and to stop."""
    conditions = CONDITIONS
    SENSORS: ClassVar[tuple[Sensor, ...]] = tuple(Sensor(topic, prefix=f"{topic}.") for topic in SENSED)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        self.config = config = _config_of(options)
        declared, within = config.declared, config.deadlines
        self.declare(Part(PartKind.ARM, tuple(_axis(config, index) for index in range(len(config.axes)))))
        self.unit = declared.unit or ", ".join(dict.fromkeys(declared.units.values())) or "the driver's own"
        hz = declared.control_hz
        stream_ttl_s = max(0.3, 3 / hz)
        self.timing = Timing(
            control_hz=hz,
            # An action is sent once. If the robot needs it again, the class repeats it.
            keepalive_s=NEVER_S,
            stream_ttl_s=stream_ttl_s,
            oneshot_ttl_s=declared.lifetime_s,
            state_ttl_s=max(within.call_s, 3 / hz),
            arm_s=within.connect_s + within.call_s + MARGIN_S,
            late_s=LATE_S,
            # An import holds the interpreter's lock, so no heartbeat is sent meanwhile.
            silent_s=within.connect_s + MARGIN_S,
            # A library of the class may hold the interpreter's lock for some time.
            heartbeat_ttl_s=0.3,
            call_s=within.call_s + MARGIN_S,
            open_s=within.connect_s + within.call_s + within.cleanup_s + within.load_s,
            handover_s=within.load_s,
            safe_s=within.errand_s + MARGIN_S,
        )
        self.gates = all_gates(self.table, self.timing.state_ttl_s, stream_ttl_s)

    @classmethod
    def options_of(cls, driver_class: type[Any], robot: str, keywords: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options of a ``PlainDriver`` for an object ``driver_class(**keywords)``.

        Raises:
            ValueError: Another process cannot load the class, the class declares something invalid, or a keyword
                cannot be sent to another process.
        """
        name = driver_class.__qualname__
        accepted_keywords = accepted(driver_class, keywords)
        for keyword, value in accepted_keywords.items():
            if not _travels(value):
                raise ValueError(
                    f"Robot: {keyword} is {value!r}, which cannot be sent to the process of {name}. "
                    "Give numbers, text, or lists and mappings of these"
                )
        has_channel = callable(getattr(driver_class, "stop_channel", None))
        secrets = {keyword: value for keyword, value in accepted_keywords.items() if _is_secret(keyword)}
        shown = {keyword: value for keyword, value in accepted_keywords.items() if keyword not in secrets}
        location, declared = location_of_class(driver_class), declared_by(driver_class, name)
        config = PlainConfig(robot, location, shown, declared, has_channel, cls.DEADLINES)
        return {"config": msgspec.to_builtins(config), "secrets": secrets}

    @classmethod
    async def complete(cls, robot: str, port: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Add the axes to the options, if the class itself declares no axes. A separate process then makes an
        object and reads its axes."""
        config = _config_of(options)
        if config.declared.keys:
            return dict(options)
        from .stop_channel import learn

        declared = await learn(config)
        if not declared.keys:
            raise WireDown(
                f"{config.name} declares no axes. Give it action_features, a mapping of keys, or a get_observation "
                "that returns numbers"
            )
        return {**options, "config": {**options["config"], "declared": msgspec.to_builtins(declared)}}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of every axis, followed by one flag per axis. The flag is 1 if the action names the
        axis, since the class gets only those axes."""
        count = len(self.axes)
        plain = super().parse(action, msgspec.structs.replace(state, target=state.target[:count]))
        if isinstance(plain, Refused):
            return plain
        flags = tuple(float(index in plain.named) for index in range(count))
        return Candidate(plain.values + flags, plain.named)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the axes with a known value, as a mapping. The class may measure fewer axes than it can move."""
        return {axis: value for axis, value in zip(self.axes, values, strict=False) if not math.isnan(value)}


def _config_of(options: Mapping[str, Any]) -> PlainConfig:
    """Return the config from the options, with the secrets. In the options the secrets are separate, because
    recordings must not contain them."""
    config = msgspec.convert(options["config"], PlainConfig)
    return msgspec.structs.replace(config, keywords={**config.keywords, **options.get("secrets", {})})


def _is_secret(keyword: str) -> bool:
    return any(word in keyword.lower() for word in SECRET_WORDS)


def accepted(cls: type[Any], keywords: Mapping[str, Any]) -> dict[str, Any]:
    """Return those keywords that the class accepts. A class need not accept every keyword that ``docs/drivers.md``
    names."""
    parameters = inspect.signature(cls).parameters
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values()):
        return dict(keywords)
    return {name: value for name, value in keywords.items() if name in parameters}


def _travels(value: Any) -> bool:
    """Return True if a value can be sent to another process without a change. A tuple may arrive as a list."""
    try:
        return bool(msgspec.json.decode(msgspec.json.encode(value)) == _as_lists(value))
    except (TypeError, ValueError, OverflowError):
        return False


def _as_lists(value: Any) -> Any:
    """Return a value with lists in place of tuples, as another process receives it."""
    if isinstance(value, tuple | list):
        return [_as_lists(each) for each in value]
    return {key: _as_lists(each) for key, each in value.items()} if isinstance(value, Mapping) else value


def _axis(config: PlainConfig, index: int) -> Axis:
    declared, key, axis = config.declared, config.declared.keys[index], config.axes[index]

    def of(table: Mapping[str, Any], default: Any) -> Any:
        return table.get(key, table.get(axis, default))

    low, high = of(declared.limits, (-math.inf, math.inf))
    unit = of(declared.units, declared.unit)
    return Axis(key=axis, unit=unit, low=low, high=high, speed=of(declared.speeds, math.inf), id=index)
