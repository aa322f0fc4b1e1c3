"""Declare Hello Robot's Stretch 2 and 3, commanded over the serial lines of their boards, without an SDK.

Lift and arm are in metres, wrist and head in radians. ``set_twist(vx, wz)`` drives the base. Every stop is a
hold: the wheels stand, and all joints stay where they are. An e-stop sets the robot's runstop (its stop
button), too. The boards then stop by themselves until a person releases it on the robot.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from strands_actors.contract.axis import Axis, AxisMode, Part, PartKind, finite
from strands_actors.contract.driver import Candidate, Driver, GateState, Reason, Service, Timing
from strands_actors.contract.options import DriverOptions, meanings, option, plain, read_options
from strands_actors.contract.safe_state import SafeState
from strands_actors.contract.sensors import Sensor
from strands_actors.contract.tool_verbs import DURATION, MOVE_TO, STATE, STATUS, STOP, ToolVerb, held_move
from strands_actors.contract.tool_verbs import SENSORS as READ_SENSORS
from strands_actors.drivers.common.kit.velocity_base import LIFETIME_S
from strands_actors.kernel.messages import Refused

from . import refusals
from .config import ARM, BASE, LIFT, StretchConfig
from .gates import conditions, gates_of, parse
from .parameters import Chain, Parameters, folder_of, parameters_of, read_folder
from .robots import TABLES

TWIN_PORT = "stretch-twin"
"""Name of the folder with a twin's ports. They have the same names there as on a robot."""

_DEVICES = "/dev/"


class StretchOptions(DriverOptions, frozen=True):
    control_frequency: Annotated[
        float, option("setpoints of a policy a second, and how often the robot is read, 5 to 50", ge=5, le=50)
    ] = 15.0


class Stretch(Driver):
    SUPPORTED_ROBOTS: ClassVar[tuple[str, ...]] = tuple(TABLES.robots)
    ALIASES: ClassVar[Mapping[str, str]] = TABLES.aliases
    PORT_KIND: ClassVar[Literal["serial", "address"]] = "serial"
    PORT_OPTIONAL: ClassVar[bool] = True
    WIRE: ClassVar[str] = "strands_actors.drivers.stretch.wire:StretchWire"
    STOP_CHANNEL: ClassVar[str] = "strands_actors.drivers.stretch.stop_channel:StretchStopChannel"
    TWIN: ClassVar[str] = "strands_actors.drivers.stretch.twin:main"
    OPTIONS: ClassVar[Mapping[str, str]] = meanings(StretchOptions)
    SENSORS: ClassVar[tuple[Sensor, ...]] = (
        Sensor(
            "odom",
            {
                "xy": "odometry_xy_m",
                "yaw": "odometry_yaw_rad",
                "linear": "odometry_linear_m_s",
                "angular": "odometry_angular_rad_s",
            },
        ),
        Sensor(
            "imu",
            {
                "rpy": "rpy_rad",
                "gyro": "gyro_rad_s",
                "accel": "acceleration_m_s2",
                "quaternion": "orientation_wxyz",
            },
        ),
        Sensor("battery", {"voltage": "battery_v", "current": "battery_a", "charging": "charging"}),
    )
    TOOL_VERBS: ClassVar[tuple[ToolVerb, ...]] = (
        READ_SENSORS,
        STATUS,
        STATE,
        MOVE_TO,
        held_move(
            f"Drive for {DURATION}, then stand.",
            {"vx": "m/s forward", "wz": "rad/s to the left"},
            dict.fromkeys(BASE, 0.0),
        ),
        STOP,
    )
    GUARDED: ClassVar[tuple[str, ...]] = (MOVE_TO.name, "move")
    SERVICES: ClassVar[Mapping[str, Service]] = {
        "set_twist": Service(
            f"drive at vx (m/s, forward) and wz (rad/s, to the left) for {LIFETIME_S * 1e3:g} ms",
            within_s=1.0,
            arguments={"vx": 0.0, "wz": 0.0, "vy": 0.0},
            acts=True,
        ),
        "set_soft_limits": Service(
            "from now on refuse goals of a joint outside low..high; never wider than its range",
            within_s=2.0,
            arguments={"joint": "", "low": math.nan, "high": math.nan},
        ),
    }

    unit = "m and rad (vx: m/s, wz: rad/s)"
    fallbacks: Mapping[Reason, SafeState] = {
        **dict.fromkeys(Reason, SafeState.HOLD),
        Reason.ESTOP: SafeState.STOP,
    }
    firmware_watchdog = (
        "The velocity watchdog of the wheels (bit 64 of their gains) is armed and acknowledged whenever the robot "
        "is connected, and its setting in flash is read back: 1.0 s after the last velocity the wheels fall into "
        "their safety mode, in which they roll out. Lift and arm go to their last goal and hold. "
        "Servos: bus watchdog (register 98), after 0.3 s they stop where they are, torque on"
    )

    @classmethod
    def resolve(cls, robot: str, options: Mapping[str, Any]) -> dict[str, Any]:
        return plain(read_options(robot, StretchOptions, options))

    @classmethod
    async def complete(cls, robot: str, port: str, options: Mapping[str, Any]) -> dict[str, Any]:
        """Read the robot's parameters from its own YAML. A simulated robot has its ports in a folder, and needs
        no YAML."""
        if port or "parameters" in options:
            return dict(options)
        read = read_folder(robot, folder_of(os.environ))
        return {**options, "parameters": msgspec.to_builtins(read)}

    def __init__(self, robot: str, port: str, options: Mapping[str, Any]) -> None:
        checked = {name: value for name, value in options.items() if name != "parameters"}
        hz = read_options(robot, StretchOptions, checked).control_frequency
        if port and PurePath(port).name != TWIN_PORT:
            raise ValueError(
                f"{robot}: port is {port!r}. Leave it out: the boards are found by their names, "
                "/dev/hello-motor-lift and so on, from the robot's own YAML (HELLO_FLEET_PATH, HELLO_FLEET_ID)"
            )
        self.robot = TABLES.canonical(robot)
        read = options.get("parameters")
        parameters = parameters_of(self.robot) if read is None else msgspec.convert(read, Parameters)
        self.config = StretchConfig(self.robot, _moved(parameters, port) if port else parameters)
        self.declare(*_parts(self.config))
        self.timing = Timing(
            control_hz=hz,
            keepalive_s=0.1,
            stream_ttl_s=LIFETIME_S,
            state_ttl_s=max(0.25, 2 / hz),
            arm_s=5.0,
            open_s=15.0,
            safe_s=2.0,
        )
        self.gates = gates_of(self.config, self.table, self.timing.state_ttl_s)
        self.conditions = conditions()

    def parse(self, action: Mapping[str, float], state: GateState) -> Candidate | Refused:
        return parse(action, self.robot, self.table, self._index, state)

    def as_json(self, values: Sequence[float]) -> dict[str, float]:
        return dict(zip(self.axes, values, strict=False))

    def commanded(self, action: Mapping[str, Any], values: Sequence[float]) -> dict[str, Any]:
        target = self.as_json(values)
        named = {str(key).removesuffix(".pos") for key in action}
        return {"robot": self.robot, "joints": {key: target[key] for key in target if key in named}}

    def check_service(self, service: str, arguments: Mapping[str, Any]) -> Refused | None:
        refusal = super().check_service(service, arguments)
        if refusal is not None or service != "set_soft_limits":
            return refusal
        ranges = {axis.key: axis.limits for axis in self.table if axis.mode is AxisMode.POSITION}
        joint = str(arguments.get("joint", ""))[:40]
        if joint not in ranges:
            return refusals.unknown_joint_argument(joint, ", ".join(ranges))
        low, high = (finite(arguments.get(name)) for name in ("low", "high"))
        least, most = ranges[joint]
        if low is None or high is None or not least - 1e-9 <= low < high <= most + 1e-9:
            return refusals.bad_soft_limits(joint, arguments.get("low"), arguments.get("high"), least, most)
        return None


def _parts(config: StretchConfig) -> tuple[Part, ...]:
    p = config.parameters
    wheel, turn = p.wheel_m_s, 2 * p.wheel_m_s / p.separation_m
    lift, arm = (
        Axis(key=key, unit="m", low=motor.low_m, high=motor.high_m, speed=motor.speed_m_s, id=number)
        for number, (key, motor) in enumerate(((LIFT, p.lift), (ARM, p.arm)), 3)
    )
    vx, wz = (
        Axis(key=key, unit=unit, low=-most, high=most, mode=AxisMode.VELOCITY, id=number)
        for number, (key, unit, most) in enumerate(zip(BASE, ("m/s", "rad/s"), (wheel, turn), strict=True), 1)
    )
    wrist, head = (tuple(servo.declared for servo in config.chain_config(chain).joints) for chain in config.chains)
    return (
        Part(PartKind.TORSO, (lift,)),
        Part(PartKind.ARM, (arm, *wrist)),
        Part(PartKind.HEAD, head),
        Part(PartKind.BASE, (vx, wz)),
    )


def _moved(parameters: Parameters, folder: str) -> Parameters:
    """Return the parameters of a robot, with its serial devices in another folder."""

    def move(usb: str) -> str:
        return f"{folder}/{usb.removeprefix(_DEVICES)}"

    def chain(servos: Chain) -> Chain:
        return msgspec.structs.replace(servos, usb=move(servos.usb))

    motors = {name: getattr(parameters, name) for name in ("lift", "arm", "left", "right")}
    return msgspec.structs.replace(
        parameters,
        **{name: msgspec.structs.replace(motor, usb=move(motor.usb)) for name, motor in motors.items()},
        pimu_usb=move(parameters.pimu_usb),
        wrist=chain(parameters.wrist),
        head=chain(parameters.head),
    )
