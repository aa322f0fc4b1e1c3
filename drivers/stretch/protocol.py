"""Encode and decode the calls and replies of Stretch's boards: steppers, power board (pimu) and wrist board (wacc).
Pure: no I/O.

The firmware's name ends with its protocol: ``Stepper.v0.5.1p5`` speaks ``p5``. Layouts differ by the protocol. All
numbers are little-endian.
"""

from __future__ import annotations

import enum
import re
import struct
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

# -- identification


class Kind(enum.StrEnum):
    """The kind of a board, as in its firmware's name."""

    STEPPER = "Stepper"
    PIMU = "Pimu"
    WACC = "Wacc"


BOARD_INFO = {Kind.STEPPER: 17, Kind.PIMU: 7, Kind.WACC: 7}
"""The call for a board's names, by kind."""
PROTOCOLS = {Kind.STEPPER: range(1, 6), Kind.PIMU: range(1, 7), Kind.WACC: range(1, 4)}
"""Protocols with known layouts, by kind."""
OLDEST_V1 = (0, 4)
"""Oldest firmware that speaks transport V1."""

_NAME_BYTES = 20
INFO_BYTES = 2 * _NAME_BYTES
_FIRMWARE = re.compile(r"([A-Za-z]+)\.v(\d+)\.(\d+)\.(\d+)p(\d+)")


class BoardInfo(NamedTuple):
    variant: str
    firmware: str
    kind: str
    version: tuple[int, int]
    protocol: int

    @property
    def hardware(self) -> int:
        """Return the hardware version of the board; 0 for an older board, whose name does not end with a
        number."""
        last = self.variant.rpartition(".")[2]
        return int(last) if last.isdecimal() else 0


def board_info_reply(variant: str, firmware: str, stepper_type: int | None = None) -> bytes:
    """Encode the reply that identifies a board. A stepper since protocol 5 adds its type at the end."""
    names = variant.encode().ljust(_NAME_BYTES, b"\0") + firmware.encode().ljust(_NAME_BYTES, b"\0")
    return names if stepper_type is None else names + bytes((stepper_type,))


def parse_board_info(data: bytes) -> BoardInfo:
    """Decode the reply that identifies a board. Raise ``MalformedFrame``."""
    if not INFO_BYTES <= len(data) <= INFO_BYTES + 1:
        raise MalformedFrame(f"a board's name has {INFO_BYTES} or {INFO_BYTES + 1} bytes, but {len(data)} arrived")
    try:
        variant, firmware = (
            data[start : start + _NAME_BYTES].rstrip(b"\0").decode("ascii") for start in (0, _NAME_BYTES)
        )
    except UnicodeDecodeError:
        raise MalformedFrame("a board's name is no text") from None
    match = _FIRMWARE.fullmatch(firmware)
    if match is None:
        raise MalformedFrame(f"the firmware's name is {firmware!r} and must look like Stepper.v0.5.1p5")
    kind, major, minor, _, protocol = match.groups()
    return BoardInfo(variant, firmware, kind, (int(major), int(minor)), int(protocol))


# -- steppers

COMMAND, STATUS, GAINS, TRIGGER, FLASH_GAINS, MOTION_LIMITS = 1, 3, 5, 9, 13, 19
NEXT_SEGMENT, START_TRAJECTORY, RESET_TRAJECTORY, STATUS_AUX = 21, 23, 25, 29


class Mode(enum.IntEnum):
    SAFETY = 0
    FREEWHEEL = 1
    HOLD = 2
    POSITION = 3
    VELOCITY = 4
    POSITION_PROFILE = 5
    VELOCITY_PROFILE = 6
    CURRENT = 7
    STEP_PROFILE = 8
    WAYPOINTS = 9


AT_REST = (Mode.SAFETY, Mode.FREEWHEEL, Mode.HOLD)
"""Modes in which a stepper does not start to move by itself."""


class Diag(enum.IntFlag):
    HOMED = 1
    RUNSTOP = 2
    NEAR_POSITION = 4
    NEAR_VELOCITY = 8
    MOVING = 16
    CURRENT_LIMIT = 32
    ACCELERATING = 64
    PROFILE_MOVING = 128
    CALIBRATED = 256
    CONTACT = 512
    SAFETY_EVENT = 1024
    WAITS_FOR_SYNC = 2048
    TRAJECTORY_ACTIVE = 4096
    TRAJECTORY_WAITS = 8192  # for a sync pulse
    IN_SYNC_MODE = 16384


class Config(enum.IntFlag):
    """Flags in the gains of a stepper board."""

    SAFETY_HOLD = 1
    RUNSTOP = 2
    SYNC = 4
    GUARDED = 8
    FLIP_ENCODER = 16
    FLIP_EFFORT = 32
    VELOCITY_WATCHDOG = 64


class Command(NamedTuple):
    """A command to a stepper, in motor radians. If a contact current (A) is exceeded, a guarded motion ends."""

    mode: int
    position: float = 0.0
    velocity: float = 0.0
    acceleration: float = 0.0
    stiffness: float = 1.0
    feedforward_a: float = 0.0
    contact_pos_a: float = 0.0
    contact_neg_a: float = 0.0
    step: int = 0

    def call(self) -> bytes:
        return bytes((COMMAND,)) + _COMMAND.pack(*self)

    @property
    def kind(self) -> str:
        """Return the kind of the command for the log of messages. The mode distinguishes a stop from a setpoint of
        zero: a setpoint has a motion profile, a stop has none."""
        if self.mode in AT_REST or (self.mode == Mode.VELOCITY and self.velocity == 0):
            return "safe"
        return "setpoint"


_COMMAND = struct.Struct("<BfffffffB")
COMMAND_BYTES = _COMMAND.size


def parse_command(data: bytes) -> Command:
    return Command(*_unpack(_COMMAND, data, "a command"))


class StepperStatus(NamedTuple):
    mode: int
    effort: float
    position: float  # motor position, rad
    velocity: float  # motor velocity, rad/s
    error: float
    diag: int
    timestamp_us: int
    debug: float
    contacts: int
    trajectory: float
    waypoint: int
    voltage: float = 0.0  # raw value of the converter

    def has(self, bit: Diag) -> bool:
        return bool(self.diag & bit)


_STEPPER_STATUS = struct.Struct("<BfdffIQfIfH")
_FLOAT = struct.Struct("<f")
VOLTAGE_SINCE = 4


def stepper_status_bytes(protocol: int) -> int:
    return _STEPPER_STATUS.size + (_FLOAT.size if protocol >= VOLTAGE_SINCE else 0)


def pack_stepper_status(status: StepperStatus, protocol: int) -> bytes:
    data = _STEPPER_STATUS.pack(*status[:-1])
    return data + _FLOAT.pack(status.voltage) if protocol >= VOLTAGE_SINCE else data


def parse_stepper_status(data: bytes) -> StepperStatus:
    """Decode the status of a stepper. Raise ``MalformedFrame``, also for a number that is not finite."""
    head, tail = data[: _STEPPER_STATUS.size], data[_STEPPER_STATUS.size :]
    voltage = _unpack(_FLOAT, tail, "a voltage") if tail else ()
    status = StepperStatus(*_unpack(_STEPPER_STATUS, head, "a stepper's status"), *voltage)
    return _finite(status, (status.position, status.velocity), "a stepper's status")


GAINS_ORDER = (
    "pKp_d", "pKi_d", "pKd_d", "pLPF", "pKi_limit", "vKp_d", "vKi_d", "vKd_d", "vLPF", "vKi_limit", "vTe_d",
    "iMax_pos", "iMax_neg", "phase_advance_d", "pos_near_setpoint_d", "vel_near_setpoint_d", "vel_status_LPF",
    "effort_LPF", "safety_stiffness", "i_safety_feedforward",
)  # fmt: skip
"""Order on the wire, in the words of the robot's YAML. ``Config`` and ``voltage_LPF`` follow."""
_CONFIG_WORDS = {
    "safety_hold": Config.SAFETY_HOLD,
    "enable_runstop": Config.RUNSTOP,
    "enable_sync_mode": Config.SYNC,
    "enable_guarded_mode": Config.GUARDED,
    "flip_encoder_polarity": Config.FLIP_ENCODER,
    "flip_effort_polarity": Config.FLIP_EFFORT,
    "enable_vel_watchdog": Config.VELOCITY_WATCHDOG,
}
_GAINS = struct.Struct(f"<{len(GAINS_ORDER)}fB")


class Gains(NamedTuple):
    values: tuple[float, ...]
    config: int
    voltage_lpf: float

    def call(self, protocol: int) -> bytes:
        return bytes((GAINS,)) + self.pack(protocol)

    def pack(self, protocol: int) -> bytes:
        data = _GAINS.pack(*self.values, self.config)
        return data + _FLOAT.pack(self.voltage_lpf) if protocol >= VOLTAGE_SINCE else data


def gains_bytes(protocol: int) -> int:
    return _GAINS.size + (_FLOAT.size if protocol >= VOLTAGE_SINCE else 0)


def gains_of(words: Mapping[str, Any]) -> Gains:
    """Read the gains from a motor's section of the YAML. Sync mode is left out. A command then takes effect
    when it arrives, and not at the next sync pulse of the power board.

    Raises:
        KeyError: A gain is missing.
        ValueError: A gain is no number.
    """
    config = sum(bit for word, bit in _CONFIG_WORDS.items() if words[word] and bit is not Config.SYNC)
    return Gains(tuple(float(words[name]) for name in GAINS_ORDER), config, float(words["voltage_LPF"]))


def parse_gains(data: bytes) -> Gains:
    head, tail = data[: _GAINS.size], data[_GAINS.size :]
    *values, config = _unpack(_GAINS, head, "gains")
    voltage = _unpack(_FLOAT, tail, "a voltage filter") if tail else (0.0,)
    return Gains(tuple(values), config, *voltage)


_TRIGGER = struct.Struct("<If")
BOARD_RESET = 4
RESET_HOMED, SET_HOMED, MARK_POSITION = 16, 32, 1


def parse_trigger(data: bytes) -> tuple[int, float]:
    bits, value = _unpack(_TRIGGER, data, "a trigger")
    return bits, value


_LIMITS = struct.Struct("<ff")


def motion_limits(low: float, high: float) -> bytes:
    """Return the call that sets the motion limits of a stepper, in motor radians."""
    return bytes((MOTION_LIMITS,)) + _LIMITS.pack(low, high)


def parse_motion_limits(data: bytes) -> tuple[float, float]:
    low, high = _unpack(_LIMITS, data, "motion limits")
    return low, high


# -- the power board

PIMU_CONFIG, PIMU_STATUS, PIMU_TRIGGER, MOTOR_SYNC, PIMU_STATUS_AUX = 1, 3, 5, 9, 13
RUNSTOP_RESET, RUNSTOP_ON, CLIFF_RESET = 2, 256, 4


class State(enum.IntFlag):
    """Flags in the status of the power board."""

    RUNSTOP = 16
    CLIFF = 32
    FAN = 64
    BUZZER = 128
    LOW_VOLTAGE = 256
    OVER_TILT = 512
    HIGH_CURRENT = 1024
    CHARGER = 2048
    BOOTED = 4096


class PimuStatus(NamedTuple):
    """Status of the power board. Angles are in degrees. Voltage and current are raw values of its converter."""

    acceleration: tuple[float, float, float]  # m/s2
    gyro: tuple[float, float, float]  # rad/s
    magnetic: tuple[float, float, float]
    roll_pitch_heading: tuple[float, float, float]
    orientation: tuple[float, float, float, float]  # w, x, y, z
    bump: float
    voltage: float
    current: float
    temperature: float
    cliffs: tuple[float, float, float, float]
    state: int
    timestamp_us: int
    bumps: int = 0
    debug: float = 0.0

    @property
    def voltage_v(self) -> float:
        """Battery voltage, converted from the 10-bit raw value (0 to 20 V)."""
        return self.voltage * 20.0 / 1024

    def current_a(self, hardware: int) -> float:
        """Battery current. Hardware 3 and newer measures it with an electronic fuse, older hardware with a
        shunt."""
        return self.current * 3.3 / 1024 / (0.224 if hardware >= 3 else 0.408)


_PIMU_STATUS = struct.Struct("<17f3f4fIQHf")
CHARGE_SINCE, TILT_SINCE = 4, 6
_SHAPE = (3, 3, 3, 3, 4, 1, 1, 1, 1, 4)


def pimu_status_bytes(protocol: int) -> int:
    return _PIMU_STATUS.size + (4 if protocol >= CHARGE_SINCE else 0) + (1 if protocol >= TILT_SINCE else 0)


def pack_pimu_status(status: PimuStatus, protocol: int) -> bytes:
    numbers: list[float] = []
    for value in status[:10]:
        numbers += value if isinstance(value, tuple) else (value,)
    data = _PIMU_STATUS.pack(*numbers, *status[10:])
    return data.ljust(pimu_status_bytes(protocol), b"\0")


def parse_pimu_status(data: bytes) -> PimuStatus:
    """Decode a status of the power board. Raise ``MalformedFrame``."""
    numbers = list(_unpack(_PIMU_STATUS, data[: _PIMU_STATUS.size], "the power board's status"))
    fields: list[Any] = []
    for size in _SHAPE:
        part, numbers = tuple(numbers[:size]), numbers[size:]
        fields.append(part[0] if size == 1 else part)
    return PimuStatus(*fields, *numbers)


def pimu_trigger(bits: int) -> bytes:
    return struct.pack("<BI", PIMU_TRIGGER, bits)


def parse_pimu_trigger(data: bytes) -> int:
    (bits,) = _unpack(struct.Struct("<I"), data, "a trigger of the power board")
    return int(bits)


_PIMU_CONFIG = struct.Struct("<9f5B22f")
PIMU_CONFIG_ORDER = (
    "cliff_zero", "cliff_thresh", "cliff_LPF", "voltage_LPF", "current_LPF", "temp_LPF", "stop_at_cliff",
    "stop_at_runstop", "stop_at_tilt", "stop_at_low_voltage", "stop_at_high_current", "mag_offsets",
    "mag_softiron_matrix", "gyro_zero_offsets", "rate_gyro_vector_scale", "gravity_vector_scale", "accel_LPF",
    "bump_thresh", "low_voltage_alert", "high_current_alert", "over_tilt_alert",
)  # fmt: skip
"""Order on the wire, in the words of the robot's YAML."""
_FLAGS = range(9, 14)
_STOP_AT_RUNSTOP = 10
"""Index in the packed row."""


def pimu_config(words: Mapping[str, Any]) -> tuple[float, ...]:
    """Read the configuration of the power board from the YAML, as a row of values.

    Raises:
        KeyError: A value is missing.
        ValueError: A value is no number.
    """
    row: list[float] = []
    for name in PIMU_CONFIG_ORDER:
        value = words[name]
        row += [float(each) for each in value] if isinstance(value, Sequence) else [float(value)]
    return tuple(row)


def pimu_config_call(values: Sequence[float]) -> bytes:
    return bytes((PIMU_CONFIG,)) + _PIMU_CONFIG.pack(
        *(int(value) if index in _FLAGS else value for index, value in enumerate(values))
    )


def stops_at_runstop(data: bytes) -> bool:
    """Return True if the runstop stops the motors with this configuration of the power board."""
    return bool(_unpack(_PIMU_CONFIG, data, "a configuration of the power board")[_STOP_AT_RUNSTOP])


# -- the wrist board

WACC_CONFIG, WACC_STATUS, WACC_COMMAND = 1, 3, 5
_WACC_STATUS = struct.Struct("<3fh4BIIQI")
WACC_STATUS_BYTES = _WACC_STATUS.size


_WACC_CONFIG = struct.Struct("<Bff2Bf")
_WACC_COMMAND = struct.Struct("<2BI")


def pack_wacc_status(
    acceleration: tuple[float, float, float], timestamp_us: int, outputs: tuple[int, int] = (0, 0)
) -> bytes:
    """Encode a status of the wrist board: its accelerometer and its two digital outputs, with nothing connected to
    its inputs."""
    return _WACC_STATUS.pack(*acceleration, 0, 0, 0, *outputs, 0, 0, timestamp_us, 0)


def acceleration_scale(data: bytes) -> float:
    """Return the factor of the acceleration in a configuration of the wrist board. Raise ``MalformedFrame``."""
    return float(_unpack(_WACC_CONFIG, data, "a configuration of the wrist board")[-1])


def wacc_outputs(data: bytes) -> tuple[int, int]:
    """Return the two digital outputs in a command to the wrist board. Raise ``MalformedFrame``, also for a
    trigger."""
    first, second, trigger = _unpack(_WACC_COMMAND, data, "a command to the wrist board")
    if trigger:
        raise MalformedFrame(f"the trigger {trigger} of the wrist board")
    return first, second


def _unpack(layout: struct.Struct, data: bytes, subject: str) -> tuple[Any, ...]:
    if len(data) != layout.size:
        raise MalformedFrame(f"{subject} has {layout.size} bytes, but {len(data)} arrived")
    return layout.unpack(data)


def _finite(status: StepperStatus, numbers: Sequence[float], subject: str) -> StepperStatus:
    # True for infinity and NaN.
    if any(number - number != 0 for number in numbers):
        raise MalformedFrame(f"{subject} has a number that is not finite")
    return status
