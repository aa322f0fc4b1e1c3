"""Declare Boston Dynamics' Spot, which is commanded over gRPC and TLS.

Neither connecting nor ``resume()`` moves the robot. ``resume()`` takes the lease of the body (the
right to command it) and sets up our own e-stop endpoint. ``stand()`` powers the motors and stands
up. Every twist ends by itself 0.6 s after it was sent, by the robot's clock.

``hold``    the robot stands still, motors on: after an expired setpoint, a lost lease, ``stop()``
``settle``  it sits down, motors off: after one of our processes has ended, ``cleanup()``, an e-stop
``off``     motors cut at once: after an e-stop with ``on_estop="cut"``
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import ReadOnlyJoint, Sensor
from strands_actors.contract.tool_verbs import DURATION, MOVE_TO, STATE, STATUS, STOP, ToolVerb, held_move
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.velocity_base import parse_twist
from strands_actors.kernel.messages import Refused

from .config import LATE_S, SAFE_S, SpotConfig, parse_port
from .gates import conditions_of, gates_of, refuse_leg, refuse_twist, with_parts
from .protocol import TWIST_S
from .robots import BASE, DRIVES, KEYS, LEG_SENSORS, TABLES, parts_of

STREAM_TTL_S = 0.3
"""Lifetime of a streamed setpoint: three periods."""

STAND_S = 40.0
"""Longest duration of ``stand``. Powering on takes 20 s at most, standing up 10."""


class SpotOptions(DriverOptions, frozen=True):
    control_frequency: Annotated[float, option("setpoints a second, 2 to 30", ge=2, le=30)] = 10.0
    estop_timeout_s: Annotated[
        float,
        option(
            "seconds without a check-in after which the robot settles and cuts its motors by itself", ge=1, le=10
        ),
    ] = 3.0
    on_estop: Annotated[
        Literal["settle", "cut"],
        option("what an e-stop does: sit down, then motors off; or motors off at once, and it falls"),
    ] = "settle"


class Spot(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.spot.wire:SpotWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.spot.stop_channel:EstopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.spot.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(SpotOptions)
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor("pose", {"xyz": "xyz_m", "rpy": "rpy_rad"}),
        Sensor(
            "odom",
            {
                "xyz": "xyz_m",
                "quaternion": "quaternion_wxyz",
                "linear": "linear_m_s",
                "angular": "angular_rad_s",
            },
        ),
        Sensor("battery", {"pct": "battery_pct", "voltage": "battery_v"}),
    )
    READ_ONLY_JOINTS: ClassVar[tuple[ReadOnlyJoint, ...]] = tuple(
        ReadOnlyJoint(key, sensor, "rad") for key, sensor in LEG_SENSORS.items()
    )
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        READ_SENSORS,
        STATE,
        STATUS,
        ToolVerb("stand", "service", "Power the motors on and stand up. Keep clear of the robot."),
        MOVE_TO,
        held_move(
            f"Walk for {DURATION}, then stand.",
            {"vx": "m/s forward", "vy": "m/s to the left", "wz": "rad/s to the left"},
            dict.fromkeys(BASE, 0.0),
        ),
        STOP,
    )
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO.name, "move")
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "stand": Service(
            "power the motors on and stand up",
            within_s=STAND_S,
            in_motion=True,
            powers=True,
            late_s=LATE_S,
        ),
        "set_twist": Service(
            f"walk so fast for {TWIST_S:g} s, m/s and rad/s of the body, then stand",
            within_s=1.0,
            arguments=dict.fromkeys(BASE, 0.0),
            in_motion=True,
            moves=True,
            late_s=LATE_S,
        ),
    }
    BEFORE_MOTION: ClassVar[str] = "stand"

    config: SpotConfig
    unit = "radians; base: m/s and rad/s"
    bound_s = 0.2
    """From a death to the safe frame. The root asks the robot for its e-stop configuration and for a
    challenge before it stops it."""

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, SpotOptions, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        read = read_options(robot, SpotOptions, options)
        self.robot = TABLES.canonical(robot)
        table = TABLES.table(robot)
        self.declare(*parts_of(table))
        period_s = 1 / read.control_frequency
        self.config = SpotConfig(
            self.robot, port, self.table, read.estop_timeout_s, float(table["arm_rad_s"]), period_s
        )
        self.timing = Timing(
            control_hz=read.control_frequency,
            # No setpoint is repeated, because the robot keeps a command until its end time.
            keepalive_s=3600.0,
            stream_ttl_s=max(STREAM_TTL_S, 1.5 / read.control_frequency),
            state_ttl_s=0.8,
            arm_s=6.0,
            late_s=LATE_S,
            call_s=0.7,
            open_s=16.0,
            handover_s=6.0,
            safe_s=SAFE_S,
        )
        self.gates = gates_of(self.table, self.timing.state_ttl_s)
        self.conditions = conditions_of()
        estop_state = SafeState.OFF if read.on_estop == "cut" else SafeState.SETTLE
        self.fallbacks = {
            **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.SETTLE),
            Reason.STOP: SafeState.HOLD,
            Reason.ESTOP: estop_state,
        }
        self.firmware_watchdog = (
            f"A twist ends {TWIST_S:g} s after it was sent. Without a check-in of our e-stop endpoint for "
            f"{read.estop_timeout_s:g} s the robot sits down and cuts its motors. resume() reads this time back"
        )

    def check_port(self) -> None:
        parse_port(self.config.port)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Parse an action into a target of all axes, followed by flags for the parts of the robot
        that get a command."""
        refused = refuse_leg(action)
        if refused is not None:
            return refused
        target = state.target[: len(KEYS)]
        base = GateState(
            state.now_ns,
            state.observation,
            target,
            state.target_ns,
            state.stream,
            state.period_s,
            state.live,
        )
        parsed = parse_twist(action, self.robot, self.table, self._index, base)
        return parsed if isinstance(parsed, Refused) else with_parts(parsed, state)

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        if refusal is not None or service != "set_twist":
            return refusal
        return refuse_twist(arguments, self.table)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        """Return the values by axis name, without those of an arm if this robot has none."""
        row = dict(zip(self.axes, values, strict=False))
        return {key: value for key, value in row.items() if value == value}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        shown: dict[str, Any] = {"robot": self.robot}
        shown["joints"] = {key: value for key, value in target.items() if key in named and key not in BASE}
        if values[DRIVES]:
            shown["twist"] = {key: target[key] for key in BASE}
        return shown
