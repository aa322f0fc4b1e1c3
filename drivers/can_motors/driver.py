"""Drive arms of Damiao and RobStride motors on CAN, with commands in the motors' MIT mode: openarm, bi_openarm,
rebot_b601, yam, and any arm from a table.

The arm holds itself up only by its motors, and has no brakes. So every stop brings it down in one of these ways:

``lowered``      it is driven to its rest pose, then it is damped, then the torque is off
``damp``         kp 0, kd of the table until the joints stand, then the torque is off: the arm sinks
``limp``         the torque is off at once: the arm falls
``zero_torque``  the same by commands without torque

If a program is late, the arm holds. For all other faults it is damped.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.tool_verbs import SENSORS, STATE, STATUS, STOP, ToolVerb
from strands_actors.drivers.common.kinematics.chain import Chain
from strands_actors.drivers.common.kit.motor_targets import Parser, target_gates
from strands_actors.drivers.common.servo.resting import WITHOUT_HURRY
from strands_actors.kernel.messages import Refused

from .can_port import check_bus, is_interface
from .config import CanConfig
from .gates import conditions, table_gains
from .robots import TABLES, arm_of, model_table, read_table, table_of
from .stopping import CONFIRM_S, DAMP_S

MARGIN_S = 0.5
LATE_S = 0.02
"""A setpoint of a stream that comes late may step as far as the joint turns in this time. The motor goes there at
once, with its stiffness."""
OnExit = Literal["lower", "damp", "limp", "zero_torque"]
_SAFE_STATES: Mapping[str, SafeState] = {
    "lower": SafeState.LOWERED,
    "damp": SafeState.DAMP,
    "limp": SafeState.LIMP,
    "zero_torque": SafeState.ZERO_TORQUE,
}


class Options(DriverOptions, frozen=True):
    adapter: Annotated[
        Literal["slcan", "damiao", "robstride"] | None,
        option(
            "adapter at a serial port; None: that of the robot's table. A port without / is an interface (can0)"
        ),
    ] = None
    baud: Annotated[int, option("bits per second of the serial port", gt=0, le=12_000_000)] = 921_600
    side: Annotated[Literal["left", "right"], option("side of a single arm, for its ranges")] = "right"
    control_frequency: Annotated[float, option("commands per second", ge=50, le=500)] = 250.0
    gravity_compensation: Annotated[bool, option("add the torques that carry the arm, by its model")] = False
    gains_in_actions: Annotated[bool, option("let actions set kp and kd")] = False
    on_exit: Annotated[
        OnExit | None,
        option(
            "what stop(), cleanup() and the end of your program do: lower (to the rest pose), damp, limp or "
            "zero_torque; None: lower for an arm with a rest pose and a model, else damp"
        ),
    ] = None
    lower_s: Annotated[float, option("seconds that lowering may take; then it is damped", ge=0.5, le=20)] = 12.0
    table: Annotated[
        str | dict[str, Any] | None,
        option("table of an arm of your own: the path of a TOML file, or its content", is_path=True),
    ] = None


class CanMotors(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_LIKE: ClassVar[str] = "can0"
    WIRE: ClassVar[str] = "strands_actors.drivers.can_motors.wire:CanWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.can_motors.stop_channel:CanStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.can_motors.twin:main"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, SENSORS, STOP)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)
    TWIN_OPTIONS: ClassVar[tuple[str, ...]] = ("table", "side")

    config: CanConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState]
    firmware_watchdog = (
        "Each motor switches its torque off 0.2 s after its last command. The driver sets this and reads it back "
        "when it energises the motors. The arm then falls"
    )
    bound_s = 0.01

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        table = options.get("table")
        if isinstance(table, os.PathLike):
            options = {**options, "table": os.fspath(table)}
        chosen = read_options(robot, Options, options)
        table = _table(robot, chosen)
        arm_of(robot, table)
        return {**plain(chosen), "table": table}

    @classmethod
    def is_lowered(cls, robot: str) -> bool:
        return robot in TABLES.robots

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        table = _table(robot, chosen)
        self.robot = TABLES.aliases.get(robot, robot)
        self.arm = arm = arm_of(self.robot, table)
        self.model = model_table(arm, table)
        control_s = 1.0 / chosen.control_frequency
        on_exit = chosen.on_exit or ("lower" if self.model["lowers"] else "damp")
        if on_exit == "lower" and not self.model["lowers"]:
            raise ValueError(f"{robot}: on_exit is 'lower', but its table has no links and rest. Use damp or limp")
        if chosen.gravity_compensation and not table.get("links"):
            raise ValueError(f"{robot}: gravity_compensation needs links in the table. Add them, or leave it out")
        self.declare(*arm.parts)
        names = tuple(name.strip() for name in port.split(",")) if port else ("",) * arm.buses
        adapter = chosen.adapter or arm.adapter
        self.config = CanConfig(
            arm=arm,
            ports=names,
            adapters=tuple("socketcan" if is_interface(name) else adapter for name in names),
            baud=chosen.baud,
            control_s=control_s,
            model=self.model,
            lower_s=chosen.lower_s,
            gravity=chosen.gravity_compensation,
        )
        safe_s = DAMP_S + CONFIRM_S + MARGIN_S
        self.timing = Timing(
            control_hz=chosen.control_frequency,
            keepalive_s=0.9 * control_s,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.1,
            tick_s=min(0.01, control_s),
            heartbeat_ttl_s=0.05,
            arm_s=5.0,
            safe_s=safe_s + (chosen.lower_s if on_exit == "lower" else 0.0),
        )
        self.fallbacks = {
            **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.DAMP),
            **dict.fromkeys(WITHOUT_HURRY, _SAFE_STATES[on_exit]),
        }
        self.conditions = conditions(arm, self.timing.state_ttl_s)
        gates = target_gates(arm, control_s, plans_motion=True, late_s=LATE_S)
        self.gates = gates if chosen.gains_in_actions else (table_gains(arm), *gates)
        self._parser = Parser(arm)

    def check_port(self) -> None:
        port, buses = ",".join(self.config.ports), self.arm.buses
        for name in self.config.ports:
            check_bus(name)
        if len(self.config.ports) != buses or not all(self.config.ports):
            example = ",".join(f"can{bus}" for bus in range(buses))
            raise ValueError(
                f"port is {port!r}. Number of CAN buses of {self.robot}: {buses}. Give {example}, or the path of "
                "an adapter for each, with commas between them"
            )
        if len(set(self.config.ports)) < buses:
            raise ValueError(f"port is {port!r}, and names one bus twice. Give one for each arm")

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target: q, dq, tau, kp and kd of all joints (see ``motor_targets``)."""
        return self._parser.parse(action, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the positions of a target, by joint. Its other rows are left out."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        named = [self.axes[index] for index in self._parser.named(action)]
        target = self.as_json(values)
        return {
            "robot": self.robot,
            "joints": named,
            "targets": {key: target[key] for key in named},
            "unit": self.unit,
        }

    def link_rows(self) -> str:
        return str(self.model["model_rows"])

    def tool_m(self, values: Mapping[str, float]) -> tuple[float, float, float] | None:
        if not self.model["lowers"] or not all(key in values for key in self.axes):
            return None
        return Chain(self.model, self.axes).points([values[key] for key in self.axes])[-1]


def _table(robot: str, chosen: Options) -> dict[str, Any]:
    if isinstance(chosen.table, dict):
        return chosen.table
    if chosen.table is not None:
        return read_table(robot, chosen.table)
    if TABLES.aliases.get(robot, robot) not in TABLES.robots:
        raise ValueError(f"{robot}: give the table of the arm, table='my_arm.toml' (docs/robots/can_motors.md)")
    return table_of(robot, chosen.side)
