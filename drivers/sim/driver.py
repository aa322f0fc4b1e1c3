"""Drive any robot in simulation.

Names, units, ranges and safe states come from the robot's own driver. Commands go to the simulation control, the
socket of the simulated robot, and not through its real wire protocol.

The gates refuse an unknown joint, a number that is not finite or too large for the physics, and a target outside
the joint's range (unless ``gated`` is False). They also refuse a joint that another program drives, since a command
to it would have no effect. Only the real driver checks speed, age of readings, and the state of motors.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

import msgspec

from strands_actors.contract.arm_model import ArmModel
from strands_actors.contract.axis_gates import past_range
from strands_actors.contract.driver import HOLDING_REASONS, Candidate, Driver, GateState, Service
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.tool_verbs import ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.physics.body import TIMESTEP_S
from strands_actors.drivers.common.simulation_control.protocol import MOST_STEPS, STEP_S
from strands_actors.kernel.messages import Refused

from .config import SimConfig
from .gates import computable, refuse_not_held

OF_THE_ROBOT = ("READ_ONLY_JOINTS", "ROLLOUTS", "TASKS", "TOOL_VERBS", "GUARDED", "TOPICS")
"""Declarations that are copied from the robot's own driver."""

RANGE_ROUNDING = 1e-6
"""Largest rounding error of a target at the end of its range, from converting units."""

TICK_S = 0.01
"""Shortest tick in simulation, in seconds. A driver with a shorter tick gets the timing of other drivers."""

KEEPALIVE_S = 1.0
"""Re-send the last target once a second. This has no effect, since no message to a simulation is lost."""


class SimDriver(Driver):
    """The driver of a simulated robot. ``port`` is the path of the socket for requests to the simulation.

    ``options``: ``class`` (``module:name``) and ``options`` describe the robot's own driver. ``gated`` is True if
    targets outside the range of a joint are refused.
    """

    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = ()
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TRANSPORTS: ClassVar[tuple[str, ...]] = ()
    WIRE: ClassVar[str] = "strands_actors.drivers.sim.wire:SimWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.sim.stop_channel:SimStopChannel"
    TWIN: ClassVar[str] = ""
    SIMULATED: ClassVar[bool] = True

    SERVICES: ClassVar[Mapping[str, Service]] = {
        "step": Service(
            f"let so many steps of physics, of {TIMESTEP_S * 1e3:g} ms each, pass at once, as fast as they are "
            "computed; deadlines and leases are of the clock all the same",
            within_s=STEP_S,
            arguments={"steps": 1},
            counts={"steps": MOST_STEPS},
            in_motion=True,
        ),
        "reset": Service(
            "put everything back to where it began, and hold it there: after a stop, before a resume",
            within_s=STEP_S,
        ),
    }

    config: SimConfig
    firmware_watchdog = "A simulation holds its last target"

    @classmethod
    def services(cls, options: Mapping[str, Any]) -> Mapping[str, Service]:
        """Return the services (named operations, such as ``reset``) of the simulation, and those services of the
        real robot's driver that move it."""
        real = _class_of(options)
        acts = {name: service for name, service in real.services(options["options"]).items() if service.acts}
        return {**cls.SERVICES, **acts}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        self.real = _class_of(options)(robot, "", options["options"])
        real = self.real
        self.robot = real.robot
        self.axes, self.ids, self.table, self.unit = real.axes, real.ids, real.table, real.unit
        self.timing = msgspec.structs.replace(real.timing, keepalive_s=KEEPALIVE_S, arm_s=2.0, silent_s=0.0)
        # A driver with shorter ticks controls a robot that falls if a tick is late. The simulated robot does not
        # fall, so longer ticks are enough.
        if self.timing.tick_s < TICK_S:
            self.timing = msgspec.structs.replace(
                self.timing, oneshot_ttl_s=None, tick_s=TICK_S, heartbeat_ttl_s=0.1, state_ttl_s=0.3
            )
        self.fallbacks = {
            reason: SafeState.HOLD if reason in HOLDING_REASONS and not self.energised(state) else state
            for reason, state in real.fallbacks.items()
        }
        self.config = SimConfig(
            control=port,
            axes=self.axes,
            ids=self.ids,
            units=real.model_units(),
            energised=frozenset(str(state) for state in SafeState if self.energised(state)),
            rows=real.SIMULATED_ROWS,
        )
        ranges = (past_range(self.table, rounding=RANGE_ROUNDING),) if options.get("gated", True) else ()
        self.gates = (*ranges, computable(self.table, self.config.units), refuse_not_held(self.axes))
        vars(self).update({name: getattr(real, name) for name in OF_THE_ROBOT})
        vars(self)["SERVICES"] = self.services(options)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return self.real.parse_simulated(action, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return self.real.as_json(values)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        return self.real.commanded(action, values)

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        return self.real.accepted(action, values, sensors)

    def action_of(self, verb: ToolVerb, inputs: Mapping[str, Any]) -> dict[str, Any] | Refused:
        return self.real.action_of(verb, inputs)

    def readings(self, observation: Observation) -> dict[str, Any]:
        return self.real.readings(observation)

    def energised(self, safe_state: SafeState) -> bool:
        return safe_state == SafeState.HOLD or self.real.energised(safe_state)

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel | None:
        return self.real.arm_model(sensors)

    def model_units(self) -> tuple[tuple[float, float], ...]:
        return self.config.units

    def travel(self) -> dict[str, tuple[float, float]]:
        return self.real.travel()


def _class_of(options: Mapping[str, Any]) -> type[Driver]:
    """Return the class of the robot's own driver."""
    module, _, name = options["class"].partition(":")
    driver_class: type[Driver] = getattr(importlib.import_module(module), name)
    return driver_class
