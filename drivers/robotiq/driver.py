"""Drive Robotiq two-finger grippers by Modbus, over TCP or a serial port: robotiq_2f85, robotiq_2f85_v4.

After any fault the gripper is held: its fingers stop where they are (rGTO 0) and stay activated. A gripped object
stays gripped, because pushing the fingers cannot turn the gear [assumed]. The fingers never go limp, and this
driver never requests the automatic release. While it is held, the gripper does not close further if the object
slips.

A hold command and every setpoint have the activation bit rACT set. If the gripper has lost its power since its last
answer, such a command activates it, which moves the fingers through their whole stroke. So if the last answer is
older than 60 ms, the driver reads the status first. If the gripper does not answer, no setpoint is written, and a
stop sends a reset. After a reset the fingers stop and the gear holds [assumed], and the next arming activates the
gripper again. One case is not covered: a power supply that fails and returns within these 60 ms.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Meta, structs

from strands_actors.contract.axis import Axis, Part, PartKind
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Timing
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.tool_verbs import MOVE_TO, SENSORS, STATUS, STOP, ToolVerb
from strands_actors.contract.wire import Observation
from strands_actors.drivers.common.ports.addresses import check_device
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import AXIS, BAUD, BAUD_RATES, LATE_S, RobotiqConfig
from .gates import FORCE, POSITION, SPEED, Keys, all_gates
from .protocol import ACTIVATION_S, counts_of
from .robots import TABLES, UNIT

_HOW: Mapping[str, Mapping[str, str]] = {
    "speed": {"type": "number", "description": "0 slowest to 1 fastest; else what the robot was made with"},
    "force": {"type": "number", "description": "0 weakest to 1 strongest; else what the robot was made with"},
}


class RobotiqOptions(DriverOptions, frozen=True):
    unit_id: Annotated[int, option("Modbus unit, 0 to 247; behind a UR controller 0", ge=0, le=247)] = UNIT
    stroke_mm: Annotated[
        float | None, option("opening when fully open, to be sure that it is the gripper that was meant")
    ] = None
    tcp_port: Annotated[
        Annotated[int, Meta(ge=1, le=65535)] | None,
        option("TCP port of the gripper's gateway, 1 to 65535, where port= does not name it; None: 502"),
    ] = None
    baud: Annotated[
        int | None,
        option(f"of a serial port, one of {', '.join(map(str, BAUD_RATES))} bits per second; None: {BAUD}"),
    ] = None
    speed: Annotated[float, option("of an action that names none, 0 slowest to 1 fastest", ge=0, le=1)] = 1.0
    force: Annotated[float, option("of an action that names none, 0 weakest to 1 strongest", ge=0, le=1)] = 1.0
    activate: Annotated[
        bool,
        option(
            "True or False: whether connecting may activate a gripper that is not; "
            "that moves its fingers through their whole stroke"
        ),
    ] = True


class Robotiq(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    DISTINGUISHED_BY: ClassVar[tuple[str, ...]] = ("unit_id",)
    WIRE: ClassVar[str] = "strands_actors.drivers.robotiq.wire:RobotiqWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.robotiq.stop_channel:RobotiqStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.robotiq.twin:main"
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        ToolVerb("open", "action", "Open the fingers all the way.", _HOW, action={AXIS: 0.0}),
        ToolVerb("close", "action", "Close the fingers, onto what is between them.", _HOW, action={AXIS: 1.0}),
        MOVE_TO,
        SENSORS,
        STATUS,
        STOP,
    )
    ANSWERS_WITH: ClassVar[tuple[str, ...]] = ("contact",)
    ROLLOUTS: ClassVar[str] = "a gripper is one dimension of its arm's action and runs no separate policy"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(RobotiqOptions)
    SPELLINGS: ClassVar[Mapping[str, str]] = {"baud_rate": "baud"}

    unit = "closed fraction, 0 open to 1 closed (position, aperture_mm: millimetres open)"
    timing = Timing(
        control_hz=50.0,
        keepalive_s=0.5,  # The gripper needs no keepalive. A repetition only replaces a lost command.
        stream_ttl_s=0.1,
        oneshot_ttl_s=None,
        state_ttl_s=0.3,
        arm_s=ACTIVATION_S + 2.0,
        late_s=LATE_S,
    )
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.HOLD)
    firmware_watchdog = (
        "The firmware has no watchdog: the gripper keeps its grip and finishes its last motion [assumed]"
    )

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        stroke_mm = TABLES.table(robot)["stroke_mm"]
        chosen = read_options(robot, RobotiqOptions, options)
        if chosen.stroke_mm not in (None, stroke_mm):
            raise ValueError(
                f"{robot}: stroke_mm is {chosen.stroke_mm:g}, but this gripper opens {stroke_mm:g} mm. "
                "Use the robot name of your gripper"
            )
        if chosen.baud is not None and chosen.baud not in BAUD_RATES:
            raise ValueError(f"{robot}: baud is {chosen.baud}. Use one of {', '.join(map(str, BAUD_RATES))}")
        return plain(chosen)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        chosen = read_options(robot, RobotiqOptions, self.resolve(robot, options))
        self.robot = TABLES.canonical(robot)
        stroke_mm: float = TABLES.table(robot)["stroke_mm"]
        baud = BAUD if chosen.baud is None else chosen.baud
        self.config = RobotiqConfig(
            self.robot, port, chosen.unit_id, stroke_mm, chosen.activate, chosen.tcp_port, baud
        )
        if port and chosen.tcp_port is not None and self.config.serial:
            raise ValueError(
                f"{robot}: port is {port!r}, a serial device, so tcp_port has no meaning. Leave tcp_port out"
            )
        if port and chosen.baud is not None and not self.config.serial:
            raise ValueError(f"{robot}: port is {port!r}, an address, so baud has no meaning. Leave baud out")
        self.declare(Part(PartKind.GRIPPER, (Axis(key=AXIS, unit="", low=0.0, high=1.0, id=chosen.unit_id),)))
        if self.config.serial:  # On a serial line no command can arrive after a later one.
            self.timing = structs.replace(self.timing, late_s=0.0)
        self.keys = Keys(self.robot, stroke_mm, chosen.speed, chosen.force)
        self.gates = all_gates(self.table, self.timing.state_ttl_s)

    def check_port(self) -> None:
        if self.config.serial:
            check_device(self.config.port)
        else:
            self.config.address()

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return self.keys.parse(action)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return {AXIS: values[POSITION]}

    def timed(
        self, targets: Mapping[str, Any], seconds: float, observation: Observation
    ) -> dict[str, Any] | Refused | None:
        """Return the action with the speed at which the motion takes ``seconds``.

        The fingers have a lowest speed. If that is faster than required, the motion ends earlier.
        """
        if "speed" in targets:
            return refusals.speed_and_seconds()
        parsed = self.keys.parse(targets)
        if isinstance(parsed, Refused):
            return parsed
        slowest, fastest = TABLES.table(self.robot)["speed_mm_s"]
        distance_mm = abs(parsed.values[POSITION] - observation.position[0]) * self.config.stroke_mm
        if not distance_mm / seconds <= fastest:
            least_s = math.ceil(100 * distance_mm / fastest) / 100
            return refusals.too_fast(distance_mm, seconds, least_s)
        share = (distance_mm / seconds - slowest) / (fastest - slowest)
        return {**targets, "speed": min(1.0, max(0.0, share))}

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        """Return the accepted target, for the caller's answer.

        ``gripper`` is the closed fraction. ``position``, ``speed`` and ``force`` are register values, 0 to 255.
        """
        position, speed, force = (counts_of(values[slot]) for slot in (POSITION, SPEED, FORCE))
        return {
            "robot": self.robot,
            "commanded_key": self.keys.places_in(action)[0],
            AXIS: round(values[POSITION], 4),
            "position": position,
            "aperture_mm": round(self.config.aperture_mm(values[POSITION]), 2),
            "speed": speed,
            "force": force,
        }

    def accepted(
        self, action: Mapping[str, Any], values: Sequence[float], sensors: Mapping[str, tuple[float, ...]]
    ) -> dict[str, Any]:
        return {**self.commanded(action, values), "holding": holding(sensors)}

    def readings(self, observation: Observation) -> dict[str, Any]:
        sensors = observation.sensors
        readings: dict[str, Any] = {"position": counts_of(observation.position[0]), "holding": holding(sensors)}
        if "aperture_mm" in sensors:
            readings["aperture_mm"] = round(sensors["aperture_mm"][0], 2)
        return readings


def holding(sensors: Mapping[str, tuple[float, ...]]) -> bool | None:
    """Return True if the last reading shows that the fingers have met an object.

    Return None while this is unknown: the fingers still move, or the gripper has not yet received the last command.
    """
    contact = sensors.get("contact", (math.nan,))[0]
    return None if math.isnan(contact) else contact != 0.0
