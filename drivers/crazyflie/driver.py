"""Declare the Bitcraze Crazyflie, which speaks CRTP over UDP, TCP, a serial line, a Crazyradio or USB. No SDK
is used.

Four verbs begin or end a flight:

``takeoff()``         arms the motors and rises; only this starts a flight, and AI agents cannot call it
``land()``            lands as a part of the program; ``takeoff()`` may follow
``stop()``            lands in any situation; nothing flies again before ``resume()``
``emergency_stop()``  cuts the motors in the air, and locks the drone until it is switched off and on

If the next command is late, the drone hovers, level, at its present place. After half a minute without a
command it lands.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, ClassVar, Literal

from strands_actors.contract.axis import finite, parse_action
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.fallbacks import fallbacks_for
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor, imu, pose
from strands_actors.contract.tool_verbs import DURATION, STATUS, STOP, ToolVerb, held_move
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.ports.addresses import check_device
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import LAND_S, LATE_S, TAKEOFF_M, TAKEOFF_S, CrazyflieConfig, parse_port
from .gates import conditions_of, gates_of
from .robots import AXES, TABLES, VZ, Z, part_of

LIFETIME_S = 0.3
"""Lifetime of a command to a drone."""
BY_USB = "a port radio:// or usb://"
SERVICE_RANGES = {"height": (0.1, 2.0, "m"), "duration": (0.5, 10.0, "s")}


class CrazyflieOptions(DriverOptions, frozen=True):
    setpoint_hz: Annotated[
        float,
        option("setpoints a second, 10 to 100; the firmware levels out after 0.5 s without one", ge=10, le=100),
    ] = 20.0


class Crazyflie(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "address"
    PORT_LIKE: ClassVar[str] = "radio://0/80/2M/E7E7E7E7E7"
    WIRE: ClassVar[str] = "strands_actors.drivers.crazyflie.wire:CrazyflieWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.crazyflie.stop_channel:CrazyflieStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.crazyflie.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(CrazyflieOptions)
    ROLLOUTS: ClassVar[str] = (
        "a Crazyflie runs no policies. Fly it by send_action(), each command for 0.3 s, after takeoff()"
    )
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        pose("xyz_m", rpy="rpy_rad", frame="map"),
        imu(rpy="rpy_rad"),
        Sensor("battery", {"voltage": "battery_v", "volts": "battery_v"}),
    )
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        READ_SENSORS,
        STATUS,
        ToolVerb("land", "stop", "Land at once, motors off on the floor; nothing flies again by itself."),
        held_move(
            f"Fly for {DURATION} after a takeoff, then hover.",
            {"vx": "m/s forward", "vy": "m/s to the left", "vz": "m/s up", "wz": "rad/s to the left"},
            dict.fromkeys(AXES[:Z], 0.0),
        ),
        STOP,
    )
    GUARDED: ClassVar[tuple[str, ...]] = ("move",)
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "takeoff": Service(
            "arm the motors, rise to a height, hover there; in the air: go to that height",
            within_s=28.0,
            arguments={"height": TAKEOFF_M, "duration": TAKEOFF_S},
            powers=True,
            late_s=LATE_S,
        ),
        "set_twist": Service(
            f"fly at vx and vy (m/s) and wz (rad/s) for {LIFETIME_S * 1e3:g} ms, then hover; z: at this height (m)",
            within_s=1.0,
            arguments={"vx": 0.0, "vy": 0.0, "wz": 0.0, "z": None},
            acts=True,
        ),
        "land": Service(
            "come down to the floor, motors off", within_s=20.0, arguments={"duration": LAND_S}, ends_motion=True
        ),
        "emergency_stop": Service(
            "cut the motors at once, wherever it is, and lock it until it is switched off and on",
            within_s=5.0,
            stops=Reason.ESTOP,
        ),
    }
    BEFORE_MOTION: ClassVar[str] = "takeoff"
    EXPERIMENTAL: ClassVar[Mapping[str, str]] = {
        BY_USB: "this was never run on a real drone, only with a replacement for the USB device"
    }

    unit = "m/s (wz: rad/s, z: m)"
    fallbacks: Mapping[Reason, SafeState] = {
        **fallbacks_for(late=SafeState.HOLD, otherwise=SafeState.LAND),
        Reason.ESTOP: SafeState.OFF,
    }
    firmware_watchdog = (
        "The drone levels out 0.5 s after the last setpoint, and after 2 s it cuts its motors and locks itself. It "
        "flies a landing that it has begun to the end. There is nothing to arm or to read back"
    )

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, CrazyflieOptions, options))

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        hz = read_options(robot, CrazyflieOptions, options).setpoint_hz
        self.robot = TABLES.canonical(robot)
        table = TABLES.table(robot)
        low, high = table["z_m"]
        battery_v, climb_m_s = float(table["battery_v"]), float(table["vz_m_s"])
        self.config = CrazyflieConfig(self.robot, port, hz, (low, high), battery_v, climb_m_s)
        self.setpoint_hz = hz
        self.declare(part_of(robot))
        is_usb = bool(port) and _is_usb(port)
        self.caveats = (self.experimental(BY_USB),) if is_usb else ()
        self.timing = Timing(
            control_hz=hz,
            keepalive_s=1 / hz,
            stream_ttl_s=LIFETIME_S,
            oneshot_ttl_s=LIFETIME_S,
            state_ttl_s=self.config.fresh_s,
            arm_s=3.0,
            call_s=0.2 if is_usb else 0.0,
            open_s=30.0,
            handover_s=10.0,
            safe_s=10.0,
        )
        self.gates = gates_of(self.table, self.timing.state_ttl_s)
        self.conditions = conditions_of(battery_v, float(table["hover_s"]))

    def check_port(self) -> None:
        if (endpoint := parse_port(self.config.port)).kind == "serial":
            check_device(endpoint.path)

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        """Parse an action into speeds, a height and a flag. The flag is 1 if the action gives a height: the
        drone hovers there, and speeds are in its own frame. It is 0 if not: speeds are in the world's frame."""
        target = (*state.target[:Z], state.observation.position[Z])
        parsed = parse_action(action, self.robot, self.table, self._index, target)
        if isinstance(parsed, Refused):
            return parsed
        values, named = parsed
        if Z in named and VZ in named:
            return refusals.both_vz_and_z()
        return Candidate((*values, float(Z in named)), named)

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        if refusal is not None:
            return refusal
        for name, default in self.SERVICES[service].arguments.items():
            if name not in SERVICE_RANGES:
                # Arguments that ``SERVICE_RANGES`` lacks are speeds, which ``parse`` checks.
                continue
            low, high, unit = SERVICE_RANGES[name]
            value = finite(arguments.get(name, default))
            if value is None or not low <= value <= high:
                return refusals.argument_out_of_range(name, str(arguments.get(name))[:40], low, high, unit)
        return None

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        by_height = bool(values[Z + 1])
        keys = ("vx", "vy", "wz", "z") if by_height else AXES[:Z]
        args = {key: value for key, value in self.as_json(values).items() if key in keys}
        name = "hover" if by_height else "velocity_world"
        return {"commanded": name, "args": args, "setpoint_hz": self.setpoint_hz, "unit": self.unit}


def _is_usb(port: str) -> bool:
    try:
        return parse_port(port).is_usb
    except ValueError:
        # An invalid port is reported when it is opened.
        return False
