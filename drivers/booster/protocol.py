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
_COMMAND_MOTOR = struct.Struct("<B3x6f")  # one motor: mode, q, dq, tau, kp, kd, weight
_IMU = struct.Struct("<9f")  # roll, pitch, yaw; turn rates; accelerations
_STATE_MOTOR = struct.Struct("<B3x4fB3xI8x")  # one motor: mode, q, dq, ddq, tau, temperature, lost, reserve
_FALL = struct.Struct("<i?")
_BATTERY = struct.Struct("<4f")  # voltage, current, charge, average voltage
_ODOMETER = struct.Struct("<3f")


class CommandType(enum.IntEnum):
    """How the ankle motors are addressed in a command: as a parallel mechanism or as serial joints."""

    PARALLEL = 0
    SERIAL = 1


class Fall(enum.IntEnum):
    IS_READY = 0
    IS_FALLING = 1
    HAS_FALLEN = 2
    IS_GETTING_UP = 3


def topic(name: str, robot_name: str) -> str:
    """Return the DDS name of a topic: ``rt/low_state``, or ``rt/alice/low_state`` for a robot with
    the name alice."""
    return f"rt/{robot_name}/{name}" if robot_name else f"rt/{name}"


class Motor(NamedTuple):
    """The command to one motor. Units are radians, newton metres and seconds."""

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
    command_type: CommandType
    motors: tuple[Motor, ...]


class State(NamedTuple):
    """The content of a LowState message. Values of motors are in the order of the motors' slots.
    Units are radians, newton metres and degrees Celsius."""

    rpy: tuple[float, ...]
    gyro: tuple[float, ...]  # turn rates about x, y and z, rad/s
    acceleration: tuple[float, ...]  # accelerations along x, y and z, m/s2
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    temperature: tuple[int, ...]


class Battery(NamedTuple):
    voltage: float
    current: float
    soc: float  # battery charge as the robot sends it; its scale is not documented, see ``percent``
    average_voltage: float

    @property
    def percent(self) -> float:
        """Battery charge in percent. The robot's scale is not documented. A value above 1 is read
        as a percentage, any other value as a fraction [assumed]."""
        return self.soc if self.soc > 1.0 else 100.0 * self.soc


class Odometer(NamedTuple):
    x_m: float
    y_m: float
    heading_rad: float


def encode_command(command: Command) -> bytes:
    head = _COMMAND_HEAD.pack(command.command_type, len(command.motors))
    return head + b"".join(_COMMAND_MOTOR.pack(*motor) for motor in command.motors)


def decode_command(body: bytes | memoryview) -> Command:
    """Decode a LowCmd. Raise ``MalformedFrame``."""
    if len(body) < _COMMAND_HEAD.size:
        raise MalformedFrame(f"a LowCmd has {_COMMAND_HEAD.size} bytes at least, not {len(body)}")
    command_type, count = _COMMAND_HEAD.unpack_from(body)
    expected_size = _COMMAND_HEAD.size + count * _COMMAND_MOTOR.size
    if count > MOST_MOTORS or len(body) != expected_size:
        raise MalformedFrame(f"a LowCmd of {len(body)} bytes for {count} motors")
    if command_type not in CommandType.__members__.values():
        raise MalformedFrame(f"a LowCmd of type {command_type}")
    motors = tuple(Motor(*row) for row in _COMMAND_MOTOR.iter_unpack(body[_COMMAND_HEAD.size :]))
    return Command(CommandType(command_type), motors)


def encode_state(state: State) -> bytes:
    """Encode a LowState. It contains the motors twice, as parallel and as serial joints. Both
    copies are equal here, as they were in recorded states."""
    motors = _COUNT.pack(len(state.q)) + b"".join(
        _STATE_MOTOR.pack(1, q, dq, 0.0, tau, temperature, 0)
        for q, dq, tau, temperature in zip(state.q, state.dq, state.tau, state.temperature, strict=True)
    )
    return _IMU.pack(*state.rpy, *state.gyro, *state.acceleration) + motors + motors


def decode_state(body: bytes | memoryview, command_type: CommandType = CommandType.PARALLEL) -> State:
    """Decode a LowState. ``command_type`` selects the parallel or the serial copy of the motors. Raise
    ``MalformedFrame``."""
    imu = _unpack(_IMU, body, "LowState")
    parallel, serial_start = _motors(body, _IMU.size)
    serial, end = _motors(body, serial_start)
    if len(body) != end:
        raise MalformedFrame(f"a LowState of {len(body)} bytes, although its header announces {end}")
    rows = list(_STATE_MOTOR.iter_unpack(parallel if command_type is CommandType.PARALLEL else serial))
    _, q, dq, _, tau, temperature, _ = zip(*rows, strict=True) if rows else ((),) * 7
    if not all(map(math.isfinite, (*imu, *q, *dq, *tau))):
        raise MalformedFrame("a LowState with a number that is not finite")
    return State(imu[:3], imu[3:6], imu[6:9], q, dq, tau, temperature)


def _motors(body: bytes | memoryview, offset: int) -> tuple[bytes | memoryview, int]:
    """Return the bytes of the list of motors that starts at ``offset``, and the offset behind
    it."""
    if len(body) < offset + _COUNT.size:
        raise MalformedFrame(f"a LowState that ends after {len(body)} bytes")
    (count,) = _COUNT.unpack_from(body, offset)
    start = offset + _COUNT.size
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
    """Decode the fields at the start of a payload. Bytes after them may be padding and are ignored."""
    if len(body) < layout.size:
        raise MalformedFrame(f"a {name} has {layout.size} bytes at least, not {len(body)}")
    return layout.unpack_from(body)


def _finite(numbers: Sequence[float]) -> Sequence[float]:
    if not all(map(math.isfinite, numbers)):
        raise MalformedFrame("a number that is not finite")
    return numbers
