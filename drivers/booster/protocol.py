"""Encode and decode the topics of a T1: commands, states, fall, battery, odometer. Pure: no I/O.

A payload is XCDR1, little endian, without its four-byte encapsulation. Motors are in the order of
their slots. Each ``decode_*`` raises ``MalformedFrame`` for a payload that it cannot read.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

TYPES = "booster_interface::msg::dds_::"
COMMAND_TYPE, STATE_TYPE, FALL_TYPE = f"{TYPES}LowCmd_", f"{TYPES}LowState_", f"{TYPES}FallDownState_"
BATTERY_TYPE, ODOMETER_TYPE = f"{TYPES}BatteryState_", f"{TYPES}Odometer_"

MOST_MOTORS = 64
"""Largest number of motors in a frame. A T1 has 23."""

_COUNT = struct.Struct("<I")
_COMMAND_HEAD = struct.Struct("<II")
_COMMAND_MOTOR = struct.Struct("<B3x6f")  # mode, q, dq, tau, kp, kd, weight
_IMU = struct.Struct("<9f")  # roll pitch yaw, turn rate, acceleration
_STATE_MOTOR = struct.Struct("<B3x4fB3xI8x")  # mode, q, dq, ddq, tau, temperature, lost, reserve
_FALL = struct.Struct("<i?")
_BATTERY = struct.Struct("<4f")  # voltage, current, soc, average voltage
_ODOMETER = struct.Struct("<3f")


class CommandType(enum.IntEnum):
    """The order of the ankles' motors in a command. There are two."""

    PARALLEL = 0
    SERIAL = 1


class Fall(enum.IntEnum):
    IS_READY = 0
    IS_FALLING = 1
    HAS_FALLEN = 2
    IS_GETTING_UP = 3


def topic(name: str, robot_name: str) -> str:
    """Return the name of a topic on the wire: ``rt/low_state``, or ``rt/alice/low_state`` for a robot
    that is called alice."""
    return f"rt/{robot_name}/{name}" if robot_name else f"rt/{name}"


class Motor(NamedTuple):
    """The command to one motor. Radians, newton metres, seconds."""

    mode: int = 0
    q: float = 0.0
    dq: float = 0.0
    tau: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    weight: float = 0.0


IDLE = Motor()
"""The command to every motor outside the upper body, without an effect."""


class Command(NamedTuple):
    kind: CommandType
    motors: tuple[Motor, ...]


class State(NamedTuple):
    """The content of a LowState, rows by slot. Radians, newton metres, degrees Celsius."""

    rpy: tuple[float, ...]
    gyro: tuple[float, ...]  # rad/s
    acceleration: tuple[float, ...]  # m/s2
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    temperature: tuple[int, ...]


class Battery(NamedTuple):
    voltage: float
    current: float
    soc: float  # in a scale that is not documented: see ``percent``
    average_voltage: float

    @property
    def percent(self) -> float:
        """State of charge. A value above 1 is read as a percentage, and up to 1 as a fraction
        [assumed]: the scale is not documented."""
        return self.soc if self.soc > 1.0 else 100.0 * self.soc


class Odometer(NamedTuple):
    x_m: float
    y_m: float
    heading_rad: float


def encode_command(command: Command) -> bytes:
    head = _COMMAND_HEAD.pack(command.kind, len(command.motors))
    return head + b"".join(_COMMAND_MOTOR.pack(*motor) for motor in command.motors)


def decode_command(body: bytes | memoryview) -> Command:
    """Decode a LowCmd. Raise ``MalformedFrame``."""
    if len(body) < _COMMAND_HEAD.size:
        raise MalformedFrame(f"a LowCmd has {_COMMAND_HEAD.size} bytes at least, not {len(body)}")
    kind, count = _COMMAND_HEAD.unpack_from(body)
    wanted = _COMMAND_HEAD.size + count * _COMMAND_MOTOR.size
    if count > MOST_MOTORS or len(body) != wanted:
        raise MalformedFrame(f"a LowCmd of {len(body)} bytes for {count} motors")
    if kind not in CommandType.__members__.values():
        raise MalformedFrame(f"a LowCmd of type {kind}")
    motors = tuple(Motor(*row) for row in _COMMAND_MOTOR.iter_unpack(body[_COMMAND_HEAD.size :]))
    return Command(CommandType(kind), motors)


def encode_state(state: State) -> bytes:
    """Encode a LowState. Its two copies of the motors, parallel and serial, are the same here, as they
    were in the recorded states."""
    motors = _COUNT.pack(len(state.q)) + b"".join(
        _STATE_MOTOR.pack(1, q, dq, 0.0, tau, temperature, 0)
        for q, dq, tau, temperature in zip(state.q, state.dq, state.tau, state.temperature, strict=True)
    )
    return _IMU.pack(*state.rpy, *state.gyro, *state.acceleration) + motors + motors


def decode_state(body: bytes | memoryview, kind: CommandType = CommandType.PARALLEL) -> State:
    """Decode a LowState, with the copy of the motors that ``kind`` names. Raise ``MalformedFrame``."""
    imu = _unpack(_IMU, body, "LowState")
    parallel, at = _motors(body, _IMU.size)
    serial, end = _motors(body, at)
    if len(body) != end:
        raise MalformedFrame(f"a LowState of {len(body)} bytes, where {end} are told")
    rows = list(_STATE_MOTOR.iter_unpack(parallel if kind is CommandType.PARALLEL else serial))
    _, q, dq, _, tau, temperature, _ = zip(*rows, strict=True) if rows else ((),) * 7
    if not all(map(math.isfinite, (*imu, *q, *dq, *tau))):
        raise MalformedFrame("a LowState with a number that is not finite")
    return State(imu[:3], imu[3:6], imu[6:9], q, dq, tau, temperature)


def _motors(body: bytes | memoryview, at: int) -> tuple[bytes | memoryview, int]:
    """Return one copy of the motors, and the offset of its end."""
    if len(body) < at + _COUNT.size:
        raise MalformedFrame(f"a LowState that ends after {len(body)} bytes")
    (count,) = _COUNT.unpack_from(body, at)
    start = at + _COUNT.size
    end = start + count * _STATE_MOTOR.size
    if count > MOST_MOTORS or len(body) < end:
        raise MalformedFrame(f"a LowState of {len(body)} bytes for {count} motors")
    return body[start:end], end


def encode_fall(fall: Fall, recoverable: bool) -> bytes:
    return _FALL.pack(fall, recoverable)


def decode_fall(body: bytes | memoryview) -> tuple[Fall, bool]:
    """Return the fall state, and whether the robot can get up by itself. Raise ``MalformedFrame``."""
    number, recoverable = _unpack(_FALL, body, "FallDownState")
    state = int(number)
    if state not in Fall.__members__.values():
        raise MalformedFrame(f"a fall state of {state}")
    return Fall(state), bool(recoverable)


def encode_battery(battery: Battery) -> bytes:
    return _BATTERY.pack(*battery)


def decode_battery(body: bytes | memoryview) -> Battery:
    """Decode a BatteryState. Raise ``MalformedFrame``."""
    return Battery(*_finite(_unpack(_BATTERY, body, "BatteryState")))


def encode_odometer(odometer: Odometer) -> bytes:
    return _ODOMETER.pack(*odometer)


def decode_odometer(body: bytes | memoryview) -> Odometer:
    """Decode an Odometer. Raise ``MalformedFrame``."""
    return Odometer(*_finite(_unpack(_ODOMETER, body, "Odometer")))


def _unpack(layout: struct.Struct, body: bytes | memoryview, name: str) -> tuple[float, ...]:
    """Read the beginning of a payload. The bytes behind it may be padding."""
    if len(body) < layout.size:
        raise MalformedFrame(f"a {name} has {layout.size} bytes at least, not {len(body)}")
    return layout.unpack_from(body)


def _finite(numbers: Sequence[float]) -> Sequence[float]:
    if not all(map(math.isfinite, numbers)):
        raise MalformedFrame("a number that is not finite")
    return numbers
