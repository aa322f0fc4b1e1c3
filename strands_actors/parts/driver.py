"""Describe a robot that is made of other robots (its parts), as data and pure functions.

Axes, gates and conditions are those of the parts' own drivers, under names that begin with the name of the part.
For each reason, the robot's safe state is the most severe one of its parts. Each part goes to the state that its
own table declares.
"""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.contract import refusals as texts
from strands_actors.contract.axis import AxisMode, Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.loading import load, place_of
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.shown import SHOWN
from strands_actors.contract.tool_verbs import MOVE_TO, SENSORS, STATE, STATUS, STOP, ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.drivers import get_native_driver_class
from strands_actors.kernel.messages import Refused
from strands_actors.supervisors.loading import build_driver

from .config import WRITE_S, PartConfig, PartsConfig
from .gates import conditions_of, gate_of, part_of, state_of, together
from .tables import TABLES

SETTLE_S = 1.0
"""How much longer a stop of all parts may take than that of the slowest part: its gate may not answer, so that its
root process stops it."""
SILENT_S = 1.0
"""How long the wire process may be silent while it connects to the parts and arms them. Each part protects
itself."""
CALL_ROOM_S = 0.2
READY_S = 5.0
"""How long the standby of a part may take until it is ready, on a busy computer."""


class PartsDriver(Driver):
    """The driver of a robot of parts. ``port`` is the run directory and the name of the running robot.

    ``options``: ``parts``, a list with the ``name``, ``class``, ``robot`` and ``options`` of each part's driver.
    ``joined_by`` stands between the name of a part and that of an axis.
    """

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES)
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    WIRE: ClassVar[str] = "strands_actors.parts.wire:PartsWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.parts.stop_channel:PartsStopChannel"
    OPTIONS: ClassVar[Mapping[str, str]] = {
        "parts": "each part by name: its robot, port and other keywords of Robot",
        "on_exit": "what the end does with each part that can be lowered; default that of the part",
    }
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, SENSORS, MOVE_TO, STOP)

    config: PartsConfig

    @classmethod
    def is_lowered(cls, robot: str) -> bool:
        return robot in TABLES

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Return the options of a robot of this package, with the usual options of each part. ``Robot`` does not
        call it, since each part has its own keywords there (``caller/resolve/parts.py``)."""
        table = TABLES[robot]
        drivers = {
            name: (own["robot"], get_native_driver_class(own["robot"])) for name, own in table["parts"].items()
        }
        rows = [
            {"name": name, "class": place_of(driver), "robot": part, "options": driver.resolve(part, {})}
            for name, (part, driver) in drivers.items()
            if driver is not None
        ]
        return {"parts": rows, "joined_by": table["joined_by"]}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.robot = robot
        if "joined_by" not in options:
            options = self.resolve(robot, options)
        rows = options["parts"]
        self.drivers = {
            row["name"]: build_driver(load(row["class"]), row["robot"], "", row["options"]) for row in rows
        }
        joined_by = options["joined_by"]
        self.part_prefixes = prefixes = {name: name + joined_by for name in self.drivers}
        self.declare(
            *(
                Part(
                    part.kind,
                    tuple(msgspec.structs.replace(axis, key=prefixes[name] + axis.key) for axis in part.axes),
                    name,
                )
                for name, driver in self.drivers.items()
                for part in driver.parts or (Part(PartKind.ARM, driver.table),)
            )
        )
        self._find = {
            name + between + key: (name, key)
            for name, driver in self.drivers.items()
            for key in driver.axes
            for between in ("_", ".", joined_by)
        }
        drivers = self.drivers.values()
        units = {name: driver.unit for name, driver in self.drivers.items()}
        same = len(set(units.values())) == 1
        self.unit = (
            next(iter(units.values())) if same else "; ".join(f"{name}: {unit}" for name, unit in units.items())
        )
        self.timing = _timing([driver.timing for driver in drivers])
        self.fallbacks = {reason: _most_severe(driver.fallbacks[reason] for driver in drivers) for reason in Reason}
        self.firmware_watchdog = ". ".join(
            f"{name}: {driver.firmware_watchdog}" for name, driver in self.drivers.items()
        )
        self.bound_s = max(driver.bound_s for driver in drivers)
        self.caveats = tuple(
            f"{name}: {caveat}" for name, driver in self.drivers.items() for caveat in driver.caveats
        )
        directory, name = os.path.split(port)
        firsts = itertools.accumulate((len(driver.axes) for driver in drivers), initial=0)
        self.config = PartsConfig(
            robot=name or robot,
            directory=directory,
            parts=tuple(
                _part(each, prefixes[each], name or robot, first, driver)
                for (each, driver), first in zip(self.drivers.items(), firsts, strict=False)
            ),
            fallbacks=self.fallbacks,
        )
        pairs = list(zip(self.config.parts, drivers, strict=True))
        self.gates = tuple(gate_of(part, driver) for part, driver in pairs)
        self.conditions = tuple(
            itertools.chain(
                *(together(part) for part in self.config.parts),
                *(conditions_of(part, driver) for part, driver in pairs),
            )
        )
        vars(self)["ROLLOUTS"] = next((driver.ROLLOUTS for driver in drivers if driver.ROLLOUTS), "")
        vars(self)["TASKS"] = next((driver.TASKS for driver in drivers if driver.TASKS), "")

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        return {}

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        keys = ", ".join(self.axes)
        if not action:
            return texts.empty_action(keys)
        by_part: dict[str, dict[str, Any]] = {}
        for key, value in action.items():
            place = self._find.get(key.removesuffix(".pos")) if isinstance(key, str) else None
            if place is None:
                return texts.unknown_joint(str(key)[:SHOWN] or "''", self.robot, keys)
            own = by_part.setdefault(place[0], {})
            if place[1] in own:
                return texts.both_spellings(str(key).removesuffix(".pos"))
            own[place[1]] = value
        values: list[float] = []
        named: list[int] = []
        until_ns = 0
        for part in self.config.parts:
            driver, own_state = self.drivers[part.name], state_of(state, part)
            if part.name not in by_part:
                values += [
                    axis.rest if axis.mode is AxisMode.VELOCITY else target
                    for axis, target in zip(driver.table, own_state.target, strict=True)
                ]
                continue
            parsed = driver.parse(by_part[part.name], own_state)
            if isinstance(parsed, Refused):
                return msgspec.structs.replace(parsed, reason=f"{part.name}: {parsed.reason}")
            values += parsed.values[: len(part.keys)]
            named += [part.first + index for index in parsed.named if index < len(part.keys)]
            if parsed.until_ns:
                until_ns = min(until_ns or parsed.until_ns, parsed.until_ns)
        return Candidate(tuple(values), tuple(named), until_ns)

    def commanded(self, action: Mapping[str, Any], values: Any) -> dict[str, Any]:
        target = self.as_json(values[: len(self.axes)])
        places = (self._find.get(str(key).removesuffix(".pos")) for key in action)
        named = {self._key(*each) for each in places if each is not None}
        return {"commanded": {key: target[key] for key in target if key in named}, "unit": self.unit}

    def _key(self, part: str, key: str) -> str:
        return next(each.prefix for each in self.config.parts if each.name == part) + key

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        return tuple(
            itertools.chain.from_iterable(
                self.drivers[part.name].first_target(part_of(observation, part)) for part in self.config.parts
            )
        )

    def travel(self) -> dict[str, tuple[float, float]]:
        return {
            part.prefix + key: limits
            for part in self.config.parts
            for key, limits in self.drivers[part.name].travel().items()
        }

    def model_units(self) -> tuple[tuple[float, float], ...]:
        return tuple(itertools.chain.from_iterable(driver.model_units() for driver in self.drivers.values()))

    def readings(self, observation: Observation) -> dict[str, Any]:
        readings = (
            (part.name, self.drivers[part.name].readings(part_of(observation, part))) for part in self.config.parts
        )
        return {name: own for name, own in readings if own}


def _part(name: str, prefix: str, robot: str, first: int, driver: Driver) -> PartConfig:
    return PartConfig(
        name=name,
        prefix=prefix,
        robot=f"{robot}_{name}",
        first=first,
        keys=driver.axes,
        ids=driver.ids,
        timing=driver.timing,
        late_s=driver.late_s,
        fallbacks=driver.fallbacks,
        energised=frozenset(state for state in SafeState if driver.energised(state)),
    )


def _most_severe(states: Any) -> SafeState:
    return max((SafeState(state) for state in states), key=lambda state: state.severity)


def _timing(timings: list[Timing]) -> Timing:
    """Return the times of a robot whose parts have these times. Each part keeps its own towards its hardware."""
    oneshots = [timing.oneshot_ttl_s for timing in timings if timing.oneshot_ttl_s is not None]
    return Timing(
        control_hz=max(timing.control_hz for timing in timings),
        # Each part re-sends its own last setpoint, as its hardware needs it.
        keepalive_s=60.0,
        stream_ttl_s=min(timing.stream_ttl_s for timing in timings),
        oneshot_ttl_s=min(oneshots) if oneshots else None,
        state_ttl_s=max(timing.state_ttl_s for timing in timings),
        arm_s=max(timing.arm_s for timing in timings) + SETTLE_S,
        silent_s=SILENT_S,
        call_s=WRITE_S + CALL_ROOM_S,
        open_s=max(timing.open_s for timing in timings) + READY_S,
        safe_s=max(timing.safe_s for timing in timings) + SETTLE_S,
        late_s=max(timing.late_s for timing in timings),
    )
