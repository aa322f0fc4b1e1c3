"""Declare the FrodoBots EarthRover Mini, which is driven through the HTTP service of the vendor's SDK process.

The safe state is zero for every reason: the wheels stop, and the lamp keeps its state. The service confirms a
command when it has forwarded it, not when the rover has received it. So the stop command is repeated until the
rover's later reports show speed 0 for a second.

A command ends after 300 ms. Then the next command may move the rover again. After a stop, only ``resume()``
permits the next command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind
from strands_actors.contract.axis_gates import past_range, stale
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu
from strands_actors.contract.tool_verbs import DURATION, STATUS, STOP, ToolVerb, held_move
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S, parse_twist
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import REPORT_OLD_S, EarthRoverConfig
from .protocol import PICTURES, SPEAK_S
from .robots import TABLES

SPOKEN = 200
"""Longest text to speak, in characters [assumed]."""

_SPEED = {"type": "number", "minimum": -1, "maximum": 1}


class EarthRoverOptions(DriverOptions, frozen=True):
    timeout_s: Annotated[
        float, option("longest time until the SDK process sends its first data, in seconds", gt=0, le=60)
    ] = 10.0
    turn_sign: Annotated[
        float, option("1.0, or -1.0 for a rover that turns right at a positive ``angular``", ge=-1, le=1)
    ] = 1.0


class EarthRover(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    WIRE: ClassVar[str] = "strands_actors.drivers.earthrover.wire:EarthRoverWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.earthrover.stop:EarthRoverStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.earthrover.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(EarthRoverOptions)
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor("battery", {"pct": "battery_pct"}),
        imu(gyro="gyros", accel="accels"),  # in the rover's units, which are not documented
        Sensor("pose", {"gps": "latitude_longitude_deg", "heading": "heading_deg"}),
    )
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        held_move(
            f"Drive for {DURATION}, or for 0.3 s, then stand.",
            {
                "linear": "fraction of full speed, forward positive, -1 to 1",
                "angular": "fraction of full turning speed, left positive, -1 to 1",
            },
            {"linear": 0.0, "angular": 0.0},
        ),
        ToolVerb(
            "lamp",
            "action",
            "Light the lamp, or put it out; the rover drives on as it does.",
            {"lamp": {**_SPEED, "description": "lit from 0.5 on"}},
            ("lamp",),
        ),
        ToolVerb(
            "speak",
            "service",
            "Say a text by the rover's speaker; not while it drives.",
            {"text": {"type": "string"}},
            ("text",),
        ),
        READ_SENSORS,
        STATUS,
        STOP,
    )
    CAMERAS: ClassVar[Mapping[str, str]] = dict.fromkeys(
        PICTURES, "strands_actors.drivers.earthrover.cameras:open_camera"
    )
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "speak": Service("say a text by the rover's speaker", within_s=SPEAK_S, arguments={"text": ""})
    }

    config: EarthRoverConfig
    unit = "fractions of full speed, -1 to 1 (lamp: lit from 0.5 on)"
    timing = Timing(
        control_hz=10.0,
        # Re-send often: the SDK process stops the rover after 3 s without a command.
        keepalive_s=0.1,
        stream_ttl_s=LIFETIME_S,
        oneshot_ttl_s=LIFETIME_S,
        state_ttl_s=REPORT_OLD_S,
        call_s=0.8,
        # Longest time until a stop is confirmed. The stop command itself is sent at once.
        safe_s=3.0,
    )
    fallbacks: Mapping[Reason, SafeState] = dict.fromkeys(Reason, SafeState.ZERO)
    firmware_watchdog = (
        "The rover repeats its last command until a new one comes. Its SDK process sends zero after 3 s without a "
        "command, unless its CONTROL_WATCHDOG_S has another value, which cannot be read back [assumed: 3 s]"
    )

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        read = read_options(robot, EarthRoverOptions, options)
        if abs(read.turn_sign) != 1.0:
            raise ValueError(
                f"{robot}: turn_sign is {read.turn_sign!r}. Give 1.0, or -1.0 if the rover turns the wrong way"
            )
        return plain(read)

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        resolved = self.resolve(robot, options)
        self.robot = TABLES.canonical(robot)
        timeout_s: float = resolved["timeout_s"]
        self.declare(
            Part(
                PartKind.BASE,
                (
                    _axis("linear", 1, AxisMode.VELOCITY),
                    _axis("angular", 2, AxisMode.VELOCITY, sign=resolved["turn_sign"]),
                    _axis("lamp", 3, AxisMode.POSITION),
                ),
            )
        )
        timing = type(self).timing
        self.timing = Timing(
            **{name: getattr(timing, name) for name in timing.__struct_fields__ if name != "open_s"},
            open_s=timeout_s + REPORT_OLD_S + timing.handover_s + 1.0,
        )
        self.config = EarthRoverConfig(port, self.table, timeout_s, self.timing.control_hz)
        # No gate limits a step, because the rover itself limits how fast its speed changes.
        self.gates = stale(self.table, self.timing.state_ttl_s), past_range(self.table)

    def check_port(self) -> None:
        self.config.address()

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse_twist(action, self.robot, self.table, self._index, state)

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        if refusal is not None:
            return refusal
        text = arguments.get("text", "")
        if isinstance(text, str) and 0 < len(text) <= SPOKEN:
            return None
        return refusals.unfit_text(text, SPOKEN)

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        return {"driver": "strands", "robot": self.robot, **super().commanded(action, values)}


def _axis(key: str, number: int, mode: AxisMode, sign: float = 1.0) -> Axis:
    return Axis(key=key, unit="", low=-1.0, high=1.0, mode=mode, sign=sign, id=number)
