"""Encode and decode CRTP, the protocol of a Crazyflie on every link: packets of a header byte and at most 30
bytes. Pure: no I/O.

All values are in SI units. The firmware uses degrees for yaw rates and angles; only ``_deg`` and ``_rad``
convert them. Layouts: the CRTP pages of the firmware's documentation, tried with cflib 0.1.34.

The hover that makes the drone safe has a negative zero for ``vx``. For the firmware this is the same hover. A
log of packets can tell it from a setpoint of zero.
"""

from __future__ import annotations

import enum
import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import msgspec

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

LONGEST = 31
"""Largest packet in bytes, header included."""
NULL = b"\xff"
"""A packet without content. It finds out which robot is there, and lets a robot on a radio answer."""
OLDEST = 12
"""Oldest supported protocol version. It is the first with a supervisor port, which confirms a landing."""
NAME = b"Bitcraze Crazyflie"
EXISTS = 17
"""Status for a block of the log that exists already, because the request was repeated."""


class Port(enum.IntEnum):
    PARAMETERS = 2
    RPYT = 3
    MEMORY = 4
    LOG = 5
    LOCALIZATION = 6
    SETPOINT = 7
    HIGH_LEVEL = 8
    SUPERVISOR = 9
    PLATFORM = 13
    LINK = 15


class Setpoint(enum.IntEnum):
    """Kinds of setpoints: the first byte of the data on ``Port.SETPOINT``, channel 0."""

    STOP = 0
    OLD_VELOCITY_WORLD = 1
    OLD_Z_DISTANCE = 2
    ALTITUDE_HOLD = 4
    OLD_HOVER = 5
    FULL_STATE = 6
    POSITION = 7
    VELOCITY_WORLD = 8
    Z_DISTANCE = 9
    HOVER = 10
    MANUAL = 11


class HighLevel(enum.IntEnum):
    """Orders to the high-level commander: the first byte of the data on ``Port.HIGH_LEVEL``."""

    SET_GROUP_MASK = 0
    OLD_TAKEOFF = 1
    OLD_LAND = 2
    STOP = 3
    GO_TO = 4
    START_TRAJECTORY = 5
    DEFINE_TRAJECTORY = 6
    TAKEOFF = 7
    LAND = 8
    TAKEOFF_WITH_VELOCITY = 9
    LAND_WITH_VELOCITY = 10
    SPIRAL = 11
    GO_TO_2 = 12
    START_TRAJECTORY_2 = 13


class Order(enum.IntEnum):
    """Orders to the supervisor: the first byte of the data on ``Port.SUPERVISOR``, channel 1."""

    ARM = 1
    RECOVER = 2
    EMERGENCY_STOP = 3
    KEEP_ALIVE = 4


class Bit(enum.IntFlag):
    """Flags that the drone's supervisor reports."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    AUTO_ARMED = 1 << 2
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7
    HIGH_LEVEL_ACTIVE = 1 << 8
    TRAJECTORY_FINISHED = 1 << 9
    HIGH_LEVEL_DISABLED = 1 << 10

    @property
    def airborne(self) -> bool:
        """Return True if motors keep the drone in the air. The flag "flying" stays set for a while after a
        landing, so the drone must also be armed and not locked."""
        return Bit.FLYING in self and Bit.ARMED in self and Bit.LOCKED not in self


class Battery(enum.IntEnum):
    """``pm.state``."""

    BATTERY = 0
    CHARGING = 1
    CHARGED = 2
    LOW_POWER = 3
    SHUTDOWN = 4


class LogBlock(NamedTuple):
    """One report that the drone's log sends periodically: its number, and the name and type of each variable
    (at most nine)."""

    number: int
    variables: tuple[tuple[str, int], ...]
    layout: struct.Struct


_FP16, _FLOAT, _U8, _U16 = 8, 7, 1, 2

FLIGHT = LogBlock(
    1,
    (
        ("stateEstimate.z", _FP16),
        ("stateEstimate.vx", _FP16),
        ("stateEstimate.vy", _FP16),
        ("stateEstimate.vz", _FP16),
        ("gyro.z", _FP16),
        ("stabilizer.roll", _FP16),
        ("stabilizer.pitch", _FP16),
        ("supervisor.info", _U16),
    ),
    struct.Struct("<7eH"),
)
"""The values that flying needs."""

POSITION = LogBlock(
    2,
    (
        ("stateEstimate.x", _FLOAT),
        ("stateEstimate.y", _FLOAT),
        ("stabilizer.yaw", _FLOAT),
        ("pm.vbat", _FLOAT),
        ("pm.state", _U8),
    ),
    struct.Struct("<4fB"),
)
"""Values that may be older. Voltage and state of the battery are in one report, so that a refusal for the state can
name the voltage of the same moment."""

STAMP_WRAP_MS = 1 << 24
"""Value at which the robot's clock in a report restarts at 0, after 4.7 hours."""

_ALL_BITS = (1 << 11) - 1


class Packet(NamedTuple):
    port: int
    channel: int
    data: bytes


def encode(port: int, channel: int, data: bytes = b"") -> bytes:
    return bytes((port << 4 | 0x0C | channel,)) + data


def decode(packet: bytes) -> Packet:
    """Split a packet into its port, channel and data. Raise ``MalformedFrame``."""
    if not 1 <= len(packet) <= LONGEST:
        raise MalformedFrame(f"a packet of {len(packet)} bytes, not 1 to {LONGEST}")
    return Packet(packet[0] >> 4, packet[0] & 3, packet[1:])


def is_null(packet: bytes) -> bool:
    """Return True for an empty packet or the answer to one (port 15, channel 3)."""
    return packet[:1] == NULL


# -- commands


def hover(vx_m_s: float, vy_m_s: float, wz_rad_s: float, z_m: float) -> bytes:
    """Encode a setpoint to hover at a height, with velocities in the robot's own frame."""
    return _setpoint(Setpoint.HOVER, vx_m_s + 0.0, vy_m_s, _deg(wz_rad_s), z_m)


def hover_still(z_m: float) -> bytes:
    """Encode the hover that makes the drone safe: level, at its present place."""
    return _setpoint(Setpoint.HOVER, -0.0, 0.0, 0.0, z_m)


def velocity(vx_m_s: float, vy_m_s: float, vz_m_s: float, wz_rad_s: float) -> bytes:
    """Encode a setpoint of velocities in the world's frame."""
    return _setpoint(Setpoint.VELOCITY_WORLD, vx_m_s, vy_m_s, vz_m_s, _deg(wz_rad_s))


def _setpoint(kind: Setpoint, *values: float) -> bytes:
    return encode(Port.SETPOINT, 0, struct.pack("<Bffff", kind, *values))


STOP = encode(Port.SETPOINT, 0, bytes((Setpoint.STOP,)))
"""Switch motors off."""
YIELD = encode(Port.SETPOINT, 1, struct.pack("<BI", 0, 0))
"""Obey the high-level commander from now on, and not the last setpoint."""
ARM = encode(Port.SUPERVISOR, 1, bytes((Order.ARM, 1)))
DISARM = encode(Port.SUPERVISOR, 1, bytes((Order.ARM, 0)))
EMERGENCY_STOP = encode(Port.SUPERVISOR, 1, bytes((Order.EMERGENCY_STOP,)))
"""Switch motors off, and lock the drone until it is switched off and on."""


def land(duration_s: float) -> bytes:
    """Encode the order to land in ``duration_s`` seconds. The high-level commander flies straight down to the
    floor."""
    return encode(Port.HIGH_LEVEL, 0, struct.pack("<BBff?f", HighLevel.LAND, 0, 0.0, 0.0, True, duration_s))


def land_with_velocity(mean_m_s: float) -> bytes:
    """Encode the order to land with a mean speed. The robot knows its height, and chooses the duration from it."""
    data = struct.pack("<BBf?f?f", HighLevel.LAND_WITH_VELOCITY, 0, 0.0, False, 0.0, True, mean_m_s)
    return encode(Port.HIGH_LEVEL, 0, data)


# -- requests that the drone answers


class Question(NamedTuple):
    packet: bytes
    answer: bytes
    """The beginning of an answer, header included. Bits 2 and 3 of an answer's header may have any value."""

    def answered_by(self, packet: bytes) -> bool:
        mine, theirs = self.answer, packet[: len(self.answer)]
        return len(theirs) == len(mine) and (theirs[0] ^ mine[0]) & 0xF3 == 0 and theirs[1:] == mine[1:]


def _ask(port: int, channel: int, data: bytes, answer: bytes) -> Question:
    return Question(encode(port, channel, data), encode(port, channel, answer))


NAME_QUESTION = _ask(Port.LINK, 1, b"", NAME)
VERSION_QUESTION = _ask(Port.PLATFORM, 1, b"\x00", b"\x00")
FIRMWARE_QUESTION = _ask(Port.PLATFORM, 1, b"\x01", b"\x01")
SUPERVISOR_QUESTION = _ask(Port.SUPERVISOR, 0, b"\x0c", b"\x8c")
ARM_QUESTION = Question(ARM, encode(Port.SUPERVISOR, 1, b"\x81"))
DISARM_QUESTION = Question(DISARM, encode(Port.SUPERVISOR, 1, b"\x81"))
LOG_INFO_QUESTION = _ask(Port.LOG, 0, b"\x03", b"\x03")
LOG_RESET_QUESTION = _ask(Port.LOG, 1, b"\x05", b"\x05")


def landing_question(order: bytes) -> Question:
    """Return the request that repeats an order to land and asks for its status. The answer repeats the first
    three bytes of the order, followed by a status."""
    return Question(order, order[:4])


def log_item_question(number: int) -> Question:
    item = struct.pack("<BH", 2, number)
    return _ask(Port.LOG, 0, item, item)


def log_create_question(block: LogBlock, numbers: Sequence[int]) -> Question:
    """Return the request to create a log block. It lists for each variable its number and the type in which it
    is sent."""
    rows = zip(block.variables, numbers, strict=True)
    items = b"".join(struct.pack("<BH", type_code, number) for (_, type_code), number in rows)
    head = bytes((6, block.number))
    return _ask(Port.LOG, 1, head + items, head)


def log_start_question(block: LogBlock, period_s: float) -> Question:
    """Return the request to start a log block. The period is sent in units of 0.01 s, from 0.01 to 2.55 s."""
    hundredths = min(255, max(1, round(period_s * 100)))
    head = bytes((3, block.number))
    return _ask(Port.LOG, 1, head + bytes((hundredths,)), head)


# -- answers


def version_of(packet: bytes) -> int:
    """Decode the answer with the protocol version. Raise ``MalformedFrame``."""
    return _unpack("<BB", packet)[1]


def firmware_of(packet: bytes) -> str:
    """Return the firmware's name, with only the printable characters."""
    text = packet[2:].split(b"\0")[0].decode("ascii", "replace")
    return "".join(letter for letter in text if letter.isprintable())


def supervisor_of(packet: bytes) -> Bit:
    """Decode the answer with the supervisor's flags. Raise ``MalformedFrame``."""
    return Bit(_unpack("<BH", packet)[1] & _ALL_BITS)


def is_armed(packet: bytes) -> bool:
    """Return True if the answer to an order to arm or disarm reports the drone as armed. Raise
    ``MalformedFrame``."""
    return bool(_unpack("<BBB", packet)[2])


def log_count_of(packet: bytes) -> int:
    """Decode the answer with the number of log variables. Raise ``MalformedFrame``."""
    return int(_unpack("<BHI", packet)[1])


def log_name_of(packet: bytes) -> str:
    """Decode the answer that names a log variable. Return ``group.name``. Raise ``MalformedFrame``."""
    try:
        group, name = packet[5:].decode("ascii").split("\0")[:2]
    except (UnicodeDecodeError, ValueError):
        raise MalformedFrame("an item of the log without a name") from None
    return f"{group}.{name}"


def status_of(packet: bytes) -> int:
    """Return the status at the end of an answer; 0 is success. Raise ``MalformedFrame``."""
    if len(packet) < 4:
        raise MalformedFrame("an answer without a status")
    return packet[-1]


def landing_status_of(packet: bytes) -> int:
    """Return the status of an answer to an order to land; 0 if the drone lands now. Raise
    ``MalformedFrame``."""
    if len(packet) < 5:
        raise MalformedFrame("an answer to an order to land without a status")
    return packet[4]


# -- readings


class Flight(msgspec.Struct, frozen=True):
    """One report of the log block ``FLIGHT``, in SI units."""

    z_m: float
    velocity_m_s: tuple[float, float, float]
    wz_rad_s: float
    roll_rad: float
    pitch_rad: float
    bits: Bit


class Position(msgspec.Struct, frozen=True):
    """One report of the log block ``POSITION``, in SI units."""

    x_m: float
    y_m: float
    yaw_rad: float
    battery_v: float
    battery_state: int


def report_of(packet: bytes) -> tuple[int, Flight | Position] | None:
    """Decode a report of one of the log blocks that this driver starts.

    Returns:
        The robot's clock (ms, 24 bits) and the reading. None for any other packet.

    Raises:
        MalformedFrame: The report has another length, or a value that is not finite.
    """
    port, channel, data = decode(packet)
    block = next((block for block in (FLIGHT, POSITION) if data[:1] == bytes((block.number,))), None)
    if (port, channel) != (Port.LOG, 2) or block is None:
        return None
    if len(data) != 4 + block.layout.size:
        raise MalformedFrame(f"a report of {len(data)} bytes, not {4 + block.layout.size}")
    values = block.layout.unpack(data[4:])
    if not all(map(math.isfinite, values)):
        raise MalformedFrame("a report with a number that is not finite")
    stamp_ms = int.from_bytes(data[1:4], "little")
    if block is POSITION:
        x, y, yaw, volts, battery = values
        return stamp_ms, Position(x, y, _rad(yaw), volts, battery)
    z, vx, vy, vz, turn, roll, pitch, bits = values
    # The firmware counts a pitch with the nose up as positive.
    return stamp_ms, Flight(z, (vx, vy, vz), _rad(turn), _rad(roll), _rad(-pitch), Bit(bits & _ALL_BITS))


def _deg(rad: float) -> float:
    return math.degrees(rad)


def _rad(deg: float) -> float:
    return math.radians(deg)


def _unpack(layout: str, packet: bytes) -> tuple[int, ...]:
    """Decode the first values in a packet's data. Raise ``MalformedFrame``."""
    size = struct.calcsize(layout)
    if len(packet) < size + 1:
        raise MalformedFrame(f"an answer of {len(packet)} bytes, not {size + 1}")
    return struct.unpack(layout, packet[1 : size + 1])
