"""UFACTORY xArm 7, on the controller's own TCP protocol: no SDK.

Safe, for a late writer, is to hold: the arm is told its last target once more and stays in servo mode. For everything
else it is stopped: state 4, in which the controller holds the arm, drops what it was told and takes nothing more. It
stays so until ``resume()``, which is where servo mode is set up again. Brakes and power are left as they are.
"""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from strands_actors.drivers.common.gates import parse
from strands_actors.drivers.common.numbers import finite
from strands_actors.drivers.common.tcp_port import parse_address
from strands_actors.runtime.clock import Clock
from strands_actors.runtime.contract import (
    HOLDING_REASONS,
    Candidate,
    Driver,
    GateState,
    Reason,
    SecondPath,
    Timing,
    WireDown,
)
from strands_actors.runtime.messages import Refused
from strands_actors.runtime.tool_verbs import SENSORS, STATUS, STOP, ToolVerb

from .arms import AXES, TABLES, ArmType, arm_of
from .gates import CONDITIONS, INDEX, JOINT_AXES, all_gates
from .protocol import CONTROL_PORT, Version

if TYPE_CHECKING:
    from .wire import XArmWire

CONTROL_HZ, SLOWEST_HZ, FASTEST_HZ = 100.0, 10.0, 250.0
"""The controller's own cycle is 250 Hz [assumed: it takes a target in each]; a setpoint lives for 0.1 s."""


class XArm(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    TWIN: ClassVar[str] = "strands_actors.drivers.xarm.twin:main"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (SENSORS, STATUS, STOP)
    OPTIONS: ClassVar[Mapping[str, str]] = {
        "control_frequency": f"setpoints a second, {SLOWEST_HZ:g} to {FASTEST_HZ:g}; default {CONTROL_HZ:g}. A joint "
        "may step so far as it turns in one period",
    }

    axes = AXES
    ids = tuple(range(1, len(AXES) + 1))
    unit = "radians"
    ladder: Mapping[Reason, str] = {reason: "hold" if reason in HOLDING_REASONS else "stop" for reason in Reason}
    firmware_watchdog = (
        "none: in servo mode the controller drives to the last target at full speed and holds it, whoever is silent"
    )
    conditions = CONDITIONS
    silent_s = 0.3
    """Without a report, or a reply that is owed, for so long the link counts as lost."""

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        if unknown := [name for name in options if name not in (*cls.OPTIONS, "tool_name")]:
            raise TypeError(f"{robot}: unknown option {', '.join(unknown)}. Use {', '.join(cls.OPTIONS)}")
        given = options.get("control_frequency", CONTROL_HZ)
        hz = finite(given)
        if hz is None or not SLOWEST_HZ <= hz <= FASTEST_HZ:
            raise ValueError(
                f"{robot}: control_frequency is {given!r}. Give a number from {SLOWEST_HZ:g} to {FASTEST_HZ:g}"
            )
        return {"control_frequency": hz}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        hz: float = self.resolve(robot, options)["control_frequency"]
        self.robot = TABLES.canonical(robot)
        self.port = port
        self.arm = arm_of(robot)
        self.timing = Timing(
            control_hz=hz,
            keepalive_s=0.1,  # nothing needs it: it heals a target that the controller did not take
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.1,
            arm_s=10.0,
            tick_s=min(0.01, 1 / hz),
        )
        self.gates = all_gates(self.arm, 1 / hz, self.timing.state_ttl_s)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, JOINT_AXES, INDEX, state)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"robot": self.robot, "joints": {axis: target[axis] for axis in AXES if axis in named}}

    def kind_of(self, version: Version) -> ArmType:
        """Raise ``WireDown`` for an arm that is another than it should be."""
        at = self.arm.type_at(version)
        if at is None:
            known = ", ".join(str(number) for number in sorted({kind.number for kind in self.arm.types}))
            raise WireDown(
                f"open: the arm at {self.port} has {version.axes} joints and is of type {version.arm_type}. "
                f"{self.robot} has {len(AXES)}, of type {known}"
            )
        return self.arm.types[at]

    def address(self) -> tuple[str, int]:
        """Of its control port. Raise ``ValueError`` for a ``port`` that is no address."""
        return parse_address(self.port, CONTROL_PORT)

    @property
    def host(self) -> str:
        return self.address()[0]

    def preload(self) -> None:
        importlib.import_module(f"{__package__}.wire")

    def open_wire(self, clock: Clock) -> XArmWire:
        from .wire import XArmWire

        return XArmWire(self, clock)

    def second_path(self, descriptors: Sequence[int], clock: Clock) -> SecondPath:
        from .wire import XArmStopChannel

        return XArmStopChannel(self, clock)
