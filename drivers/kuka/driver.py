"""Drive a KUKA LBR iiwa 14 through FRI, with joint positions: ``kuka_iiwa``.

The controller sends a message in every cycle, and this driver must answer each one with joint positions. To hold
the arm means to answer with the last commanded position. After any fault the driver holds the arm. The drives stay
on. Brakes and e-stop are operated on the robot's pendant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from msgspec.structs import replace

from strands_actors.contract.arm_model import ArmModel, arm_table
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.loading import load
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.tool_verbs import GET_POSE, MOVE_TO_POSE, STATE, STATUS, STOP, ToolVerb
from strands_actors.contract.wire import Observation, Wire
from strands_actors.kernel.clock import Clock
from strands_actors.kernel.messages import Refused

from .config import KeptPort, KukaConfig
from .gates import conditions, gates, last_target, span_s
from .protocol import FRI_PORT
from .robots import FLANGE_M, TABLES, arm_of


class Options(DriverOptions, frozen=True):
    fri_port: Annotated[int, option("UDP port of both ends of FRI", ge=1, le=65535)] = FRI_PORT
    control_frequency: Annotated[float, option("commands per second", ge=20, le=100)] = 50.0
    connect_timeout: Annotated[float, option("longest wait for the first message, seconds", gt=0, le=8)] = 5.0


class Kuka(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_OPTIONAL: ClassVar[bool] = True
    WIRE: ClassVar[str] = "strands_actors.drivers.kuka.wire:KukaWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.kuka.stop_channel:KukaStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.kuka.twin:main"
    TORQUES: ClassVar[str] = "torque_nm"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (STATE, STATUS, GET_POSE, MOVE_TO_POSE, STOP)
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO_POSE.name,)
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(Options)

    config: KukaConfig
    unit = "radians"
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.HOLD)
    firmware_watchdog = (
        "The FRI session is the watchdog: after some missing answers the controller drops it to monitoring, and "
        "the robot's own program holds the arm [?]. It needs no arming, and works only in position control mode"
    )
    bound_s = 0.05

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, Options, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, Options, options)
        self.arm = arm_of(robot)
        self.robot = self.arm.name
        self.period_s = 1.0 / chosen.control_frequency
        self.declare(self.arm.part)
        self.timing = Timing(
            control_hz=chosen.control_frequency,
            keepalive_s=0.9 * self.period_s,
            stream_ttl_s=0.1,
            oneshot_ttl_s=None,
            state_ttl_s=0.2,
            arm_s=5.0,
            open_s=chosen.connect_timeout + 3.5,
        )
        self.config = KukaConfig(self.arm, port, chosen.fri_port, chosen.connect_timeout, self.timing.stream_ttl_s)
        self.kept = KeptPort(self.config)
        self.conditions = conditions(self.table, self.timing.state_ttl_s)
        self.gates = gates(self.table, self.period_s)

    def check_port(self) -> None:
        self.config.address()

    def arm_model(self, sensors: Mapping[str, tuple[float, ...]]) -> ArmModel:
        # Imported here, since only the caller needs the links of the arm.
        from .twin.model import model_table

        table = model_table(self.arm)
        home = tuple(table["home_rad"])
        return ArmModel(arm_table(table), self.axes, "link7", (0.0, 0.0, FLANGE_M), home=home)

    def link_rows(self) -> str:
        from .twin.model import model_table

        return str(model_table(self.arm)["model_rows"])

    def first_target(self, observation: Observation) -> tuple[float, ...]:
        """Return the position from which the first motion begins: the commanded one, which the arm follows."""
        return observation.sensors.get("commanded_rad", observation.position)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Return the target of all joints (rad), followed by the time in which the arm should reach it (s).

        Joints that the action does not name keep their commanded position.
        """
        parsed = super().parse(action, replace(state, target=last_target(state)))
        if isinstance(parsed, Refused):
            return parsed
        return Candidate((*parsed.values, span_s(state, self.period_s)), parsed.named)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the joint positions of a target by joint name, without the time at its end."""
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {
            "robot": self.robot,
            "joints": [joint for joint in self.axes if joint in named],
            "targets": {joint: target[joint] for joint in self.axes if joint in named},
            "control_period": self.period_s,
        }

    def open_wire(self, clock: Clock) -> Wire:
        wire: Wire = load(self.WIRE)(self.config, clock, self.kept)
        return wire
