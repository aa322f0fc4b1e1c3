"""The Feetech STS/SMS/SCS serial protocol: frames, registers, checksums. Pure: no I/O, no clock.

Request ``FF FF id len inst params.. sum``, status ``FF FF id len err params.. sum``. ``len`` is the number of
parameter bytes plus two. ``sum`` is the inverted low byte of the sum of all bytes between header and sum. There is
no sequence number, so a late reply looks like the answer to the next request with the same id and length.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

HEADER = b"\xff\xff"
BROADCAST = 0xFE
MAX_ID = 0xFD
OVERHEAD = 6
"""Bytes of a status without params."""

PING = 0x01
READ = 0x02
WRITE = 0x03
REG_WRITE = 0x04
ACTION = 0x05
RESET = 0x06
REBOOT = 0x08
SYNC_READ = 0x82
SYNC_WRITE = 0x83

COUNTS = 4096
"""Encoder counts per turn (STS, SMS)."""


class Register(NamedTuple):
    """One entry of the control table. A signed word has its sign in the bit ``sign_bit`` and its magnitude in the
    bits below. It is never a two's complement."""

    address: int
    size: int = 1
    sign_bit: int | None = None

    def encode(self, value: int) -> bytes:
        """Return little-endian bytes (STS, SMS). Raise ``ValueError`` for a value out of range."""
        size, sign_bit = self.size, self.sign_bit
        if sign_bit is not None:
            if not -1 << sign_bit < value < 1 << sign_bit:
                raise ValueError(f"{value} does not fit sign-magnitude with sign bit {sign_bit}")
            value = -value | 1 << sign_bit if value < 0 else value
        if not 0 <= value < 1 << 8 * size:
            raise ValueError(f"{value} does not fit into {size} byte(s)")
        return value.to_bytes(size, "little")

    def decode(self, data: bytes, base: int | None = None) -> int:
        """Return the value of this register from ``data``, a block that was read from address ``base``. By default
        the block begins at this register."""
        start = 0 if base is None else self.address - base
        raw = int.from_bytes(data[start : start + self.size], "little")
        if self.sign_bit is not None and raw >> self.sign_bit & 1:
            return -(raw & (1 << self.sign_bit) - 1)
        return raw


# EEPROM registers. A value is kept without power only if it was written while LOCK was 0.
FIRMWARE = Register(0, 2)
MODEL = Register(3, 2)
ID = Register(5)
BAUD = Register(6)
RETURN_DELAY = Register(7)  # in units of 2 us; 250 at delivery
STATUS_LEVEL = Register(8)
MIN_POSITION = Register(9, 2)
MAX_POSITION = Register(11, 2)
MAX_TEMPERATURE = Register(13)
MAX_VOLTAGE = Register(14)  # in units of 0.1 V
MIN_VOLTAGE = Register(15)
MAX_TORQUE = Register(16, 2)
PHASE = Register(18)
SPEED_IN_COUNTS = 0x04
"""Bit of PHASE. With it a speed counts 1 count/s (0.0146 rpm), without it 50 counts/s (0.732 rpm).

An STS3215 leaves the factory with it: the vendor's examples for it (SCServo library, ``SyncWritePosEx``) say
"factory speed unit is 0.0146 rpm", and how to convert if it is 0.732 rpm, as on an SMS40BL. The bit itself is
from users who have measured it, as at HumanaOpen (``switch_phase_bit2.py``)."""
COARSE_COUNTS = 50
UNLOAD_CONDITION = Register(19)  # error bits for which the servo switches its torque off
LED_ALARM = Register(20)
P_GAIN = Register(21)
D_GAIN = Register(22)
I_GAIN = Register(23)
MIN_START_FORCE = Register(24, 2)
CLOCKWISE_DEAD_ZONE, COUNTER_DEAD_ZONE = Register(26), Register(27)
PROTECTION_CURRENT = Register(28, 2)
ANGULAR_RESOLUTION = Register(30)
HOMING_OFFSET = Register(31, 2, 11)
MODE = Register(33)
PROTECTIVE_TORQUE = Register(34)
PROTECTION_TIME = Register(35)
OVERLOAD_TORQUE = Register(36)
VELOCITY_P = Register(37)
OVERCURRENT_TIME = Register(38)  # in units of 10 ms
VELOCITY_I = Register(39)
# RAM
TORQUE_ENABLE = Register(40)
ACCELERATION = Register(41)
GOAL_POSITION = Register(42, 2, 15)
GOAL_TIME = Register(44, 2, 10)  # in mode 2 (PWM) the power, in units of 0.1 %
GOAL_VELOCITY = Register(46, 2, 15)  # counts/s; in mode 0 the highest speed on the way to a goal, 0 for no limit
TORQUE_LIMIT = Register(48, 2)
LOCK = Register(55)
# read only
POSITION = Register(56, 2, 15)
VELOCITY = Register(58, 2, 15)
LOAD = Register(60, 2, 10)
VOLTAGE = Register(62)  # in units of 0.1 V
TEMPERATURE = Register(63)  # in degrees Celsius
STATUS = Register(65)
MOVING = Register(66)
CURRENT = Register(69, 2)

LOWER_SIZE = TORQUE_LIMIT.address + TORQUE_LIMIT.size - GOAL_POSITION.address
"""Bytes for each servo in a frame of a lowering."""

TABLE_SIZE = 90
EEPROM_END = 40
READ_ONLY = frozenset((*range(5), *range(56, 72)))
POSITION_MODE, VELOCITY_MODE, PWM_MODE, STEP_MODE = range(4)

SET_MIDDLE = 128
"""Value for TORQUE_ENABLE that makes the present position the middle (assumed for all STS firmware)."""

BAUD_RATES = (1_000_000, 500_000, 250_000, 128_000, 115_200, 76_800, 57_600, 38_400)
"""Rate of each code of register 6, in the vendor's order. Codes 5 to 7 are uncertain, since sources
disagree."""

MODEL_NUMBERS = {777: "STS3215", 2825: "STS3250", 11272: "SM8512BL", 1284: "SCS0009"}

ERROR_BITS = {1: "voltage", 2: "sensor", 4: "overheat", 8: "overcurrent", 32: "overload"}


def error_words(error: int) -> str:
    """Return the names of the bits in a status packet's error byte."""
    names = [word for bit, word in ERROR_BITS.items() if error & bit]
    rest = error & ~sum(ERROR_BITS)
    return ", ".join(names + ([f"unknown 0x{rest:02x}"] if rest else []))


class Packet(NamedTuple):
    """One frame with a valid checksum. ``code`` is the instruction of a request or the error byte of a status
    packet."""

    id: int
    code: int
    params: bytes

    @property
    def failure(self) -> str:
        """Return an empty text, since a status packet never reports that the servo has refused a request."""
        return ""


def frame(servo_id: int, code: int, params: bytes = b"") -> bytes:
    """Return the bytes of a request, or of a status if ``code`` is an error byte."""
    body = bytes((servo_id, len(params) + 2, code)) + params
    return HEADER + body + bytes((~sum(body) & 0xFF,))


def ping(servo_id: int) -> bytes:
    return frame(servo_id, PING)


def read(servo_id: int, address: int, size: int) -> bytes:
    return frame(servo_id, READ, bytes((address, size)))


def write(servo_id: int, register: Register, value: int) -> bytes:
    return frame(servo_id, WRITE, bytes((register.address,)) + register.encode(value))


def torque(servo_id: int, on: bool) -> bytes:
    return write(servo_id, TORQUE_ENABLE, int(on))


def sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    return frame(BROADCAST, SYNC_READ, bytes((address, size, *ids)))


def sync_write(register: Register, values: Mapping[int, int]) -> bytes:
    rows = bytearray((register.address, register.size))
    for servo_id, value in values.items():
        rows.append(servo_id)
        rows += register.encode(value)
    return frame(BROADCAST, SYNC_WRITE, bytes(rows))


def goals(counts: Mapping[int, int]) -> bytes:
    """Return a frame with one goal position for each servo."""
    return sync_write(GOAL_POSITION, counts)


def hold(positions: Mapping[int, int]) -> bytes:
    """Return a frame that makes every servo hold its measured position.

    The frame writes goal and time (register 42, four bytes, time 0). A setpoint writes the goal only. So the log of
    sent frames can tell a hold from a setpoint.
    """
    rows = b"".join(
        bytes((servo_id,)) + GOAL_POSITION.encode(count) + b"\0\0" for servo_id, count in positions.items()
    )
    return frame(BROADCAST, SYNC_WRITE, bytes((GOAL_POSITION.address, 4)) + rows)


def speed_unit(phase: int) -> int:
    """Return the counts/s of one unit in the registers of speeds, from the value of PHASE."""
    return 1 if phase & SPEED_IN_COUNTS else COARSE_COUNTS


LOWERING_COUNTS_S = 1500
"""Highest speed of a servo while its arm is lowered, 2.3 rad/s. The servo itself keeps it, even if no further frame
comes. A servo with ``COARSE_COUNTS`` has no limit then, and only the torque limits slow its arm down."""

EFFORT, FULL_EFFORT = LOAD, 1000


def lower(goals: Mapping[int, int], torque_limits: Mapping[int, int]) -> bytes:
    """Return a frame with the goal, the highest speed and the torque limit of each servo while its arm is lowered.

    It writes the registers 42 to 49. No setpoint and no hold does that, so the log of sent frames can tell them
    apart.
    """
    rows = b"".join(
        bytes((servo_id,))
        + GOAL_POSITION.encode(count)
        + GOAL_TIME.encode(0)
        + GOAL_VELOCITY.encode(LOWERING_COUNTS_S)
        + TORQUE_LIMIT.encode(torque_limits[servo_id])
        for servo_id, count in goals.items()
    )
    return frame(BROADCAST, SYNC_WRITE, bytes((GOAL_POSITION.address, LOWER_SIZE)) + rows)


def full_torque(torque_limits: Mapping[int, int]) -> bytes:
    """Return a frame that lifts the speed limit and the torque limit of each servo."""
    rows = b"".join(
        bytes((servo_id,)) + GOAL_VELOCITY.encode(0) + TORQUE_LIMIT.encode(limit)
        for servo_id, limit in torque_limits.items()
    )
    size = GOAL_VELOCITY.size + TORQUE_LIMIT.size
    return frame(BROADCAST, SYNC_WRITE, bytes((GOAL_VELOCITY.address, size)) + rows)


LIMP = torque(BROADCAST, False)
"""One frame that switches off the torque of every servo. A broadcast gets no reply, so register 40 of each servo
must be read to confirm it."""

RESYNC = b"\0\0"
"""Bytes in front of the first safe frame. A servo that has received only ``FF FF id`` of an earlier frame would
take the next FF for a length and wait for 255 bytes. A length of 0 is invalid, so the servo discards the earlier
frame."""


class Decoder:
    """Decode bytes, in pieces of any size, into packets. Bytes that belong to no valid frame are skipped and
    counted. The beginning of a frame is kept until the rest arrives."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.garbage_bytes = 0

    @property
    def pending(self) -> int:
        """Return the number of bytes of a frame that is still incomplete."""
        return len(self._buffer)

    def clear(self) -> None:
        self._buffer.clear()

    def feed(self, data: bytes) -> Iterator[Packet]:
        buffer = self._buffer
        buffer += data
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                keep = 1 if buffer.endswith(b"\xff") else 0
                self._drop(len(buffer) - keep)
                return
            if start:
                self._drop(start)
            if len(buffer) < 4:
                return
            # After three bytes FF the header begins at the second one.
            if buffer[2] == 0xFF:
                self._drop(1)
                continue
            size = buffer[3] + 4
            if size < 6:
                self._drop(2)
                continue
            if len(buffer) < size:
                return
            body = bytes(buffer[2:size])
            if ~sum(body[:-1]) & 0xFF != body[-1]:
                self._drop(2)
                continue
            del buffer[:size]
            yield Packet(body[0], body[2], body[3:-1])

    def _drop(self, count: int) -> None:
        if count:
            self.garbage_bytes += count
            del self._buffer[:count]


def rows_of(packet: Packet) -> tuple[int, dict[int, bytes]]:
    """Decode a sync write, a frame that writes to several servos. Return the address of its first register, and
    the bytes for each servo by id."""
    address, size, *_ = packet.params
    rows = packet.params[2:]
    return address, {rows[i]: rows[i + 1 : i + 1 + size] for i in range(0, len(rows), size + 1)}


def classify(packet: Packet) -> str:
    """Return the kind of a request for the log of sent frames: setpoint, safe (torque off or hold), lowering,
    enable, read, config or other."""
    if packet.code in (PING, READ, SYNC_READ):
        return "read"
    if packet.code in (WRITE, REG_WRITE) and packet.params:
        return _classify_write(packet.params[0], (packet.params[1:],))
    if packet.code == SYNC_WRITE and len(packet.params) > 2:
        address, rows = rows_of(packet)
        return _classify_write(address, list(rows.values()))
    return "other"


def _classify_write(address: int, rows: Sequence[bytes]) -> str:
    covers = range(address, address + max(map(len, rows), default=0))
    if TORQUE_ENABLE.address in covers:
        index = TORQUE_ENABLE.address - address
        return "safe" if all(row[index] == 0 for row in rows if len(row) > index) else "enable"
    if address == GOAL_POSITION.address and len(covers) == 4 and all(row[2:] == b"\0\0" for row in rows):
        return "safe"
    if address == GOAL_POSITION.address and len(covers) == LOWER_SIZE:
        return "lowering"
    if address == GOAL_VELOCITY.address and len(covers) == 4 and all(row[:2] == b"\0\0" for row in rows):
        return "config"
    if GOAL_POSITION.address in covers or GOAL_VELOCITY.address in covers or GOAL_TIME.address in covers:
        return "setpoint"
    return "config"


def safe_state(packet: Packet, ids: Collection[int]) -> str:
    """Return the safe state that a request gives to all servos in ``ids``: "limp" or "hold". Return an empty text
    if it does not reach all of them."""
    if packet.code not in (WRITE, SYNC_WRITE) or classify(packet) != "safe":
        return ""
    if packet.code == WRITE:
        return "limp" if packet.id == BROADCAST else ""
    address, rows = rows_of(packet)
    if not rows.keys() >= set(ids):
        return ""
    return "hold" if address == GOAL_POSITION.address else "limp"
