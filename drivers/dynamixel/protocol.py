"""Dynamixel Protocol 2.0, X series: frames, registers, checksums. Pure: no I/O, no clock.

Instruction ``FF FF FD 00 id len len inst params.. crc crc``, status ``FF FF FD 00 id len len 55 err params.. crc
crc``; ``len`` (two bytes, low first, as every word here) counts what follows it. Inside the body ``FF FF FD``
is sent as ``FF FF FD FD``, so that a header is never data. There is no sequence number: a late reply looks
like the answer to the next question of the same id and length.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
MAX_ID = 0xFC
OVERHEAD = 11
"""Bytes of a status that has no params."""
MAX_LENGTH = 1024
"""A length beyond this is noise, not a frame to wait for: the whole control table fits."""

PING = 0x01
READ = 0x02
WRITE = 0x03
REG_WRITE = 0x04
ACTION = 0x05
FACTORY_RESET = 0x06
REBOOT = 0x08
CLEAR = 0x10
STATUS = 0x55
SYNC_READ = 0x82
SYNC_WRITE = 0x83
FAST_SYNC_READ = 0x8A
BULK_READ = 0x92
BULK_WRITE = 0x93
FAST_BULK_READ = 0x9A


class Register(NamedTuple):
    """One entry of the control table. Signed words are two's complement."""

    address: int
    size: int = 1
    signed: bool = False

    def encode(self, value: int) -> bytes:
        """Little-endian bytes. Raise ``ValueError`` outside the register's range."""
        try:
            return value.to_bytes(self.size, "little", signed=self.signed)
        except OverflowError:
            raise ValueError(f"{value} does not fit {self.size} byte(s)") from None

    def decode(self, data: bytes, base: int | None = None) -> int:
        """The value in ``data``, a block that was read from address ``base`` (default: this register's own)."""
        start = 0 if base is None else self.address - base
        return int.from_bytes(data[start : start + self.size], "little", signed=self.signed)


# EEPROM: cannot be written while torque is on
MODEL = Register(0, 2)
FIRMWARE = Register(6)
ID = Register(7)
BAUD = Register(8)
RETURN_DELAY = Register(9)  # 2 us a count, factory 250
DRIVE_MODE = Register(10)  # bit 0: turns the other way; the servo does it, not the host
MODE = Register(11)
HOMING_OFFSET = Register(20, 4, True)
MAX_TEMPERATURE = Register(31)  # deg C
MAX_VOLTAGE = Register(32, 2)  # 0.1 V
MIN_VOLTAGE = Register(34, 2)
PWM_LIMIT = Register(36, 2)  # 885: all of it
CURRENT_LIMIT = Register(38, 2)
VELOCITY_LIMIT = Register(44, 4)
MAX_POSITION = Register(48, 4)
MIN_POSITION = Register(52, 4)
SHUTDOWN = Register(63)  # which hardware errors take the torque away
# RAM
TORQUE_ENABLE = Register(64)
LED = Register(65)
STATUS_LEVEL = Register(68)  # 0: answers a ping, 1: and a read, 2: everything
REGISTERED = Register(69)
HARDWARE_ERROR = Register(70)
BUS_WATCHDOG = Register(98, 1, True)  # 20 ms a count; 0: off, -1: tripped
GOAL_PWM = Register(100, 2, True)
GOAL_CURRENT = Register(102, 2, True)
GOAL_VELOCITY = Register(104, 4, True)
PROFILE_ACCELERATION = Register(108, 4)
PROFILE_VELOCITY = Register(112, 4)  # 0: none, as fast as it can
GOAL_POSITION = Register(116, 4, True)
# read only
MOVING = Register(122)
CURRENT = Register(126, 2, True)  # XL330: 1 mA; XL430, which has no current sensor: load, 0.1 %
VELOCITY = Register(128, 4, True)  # 0.229 rpm
POSITION = Register(132, 4, True)
VOLTAGE = Register(144, 2)  # 0.1 V
TEMPERATURE = Register(146)  # deg C

TABLE_SIZE = 147
EEPROM_END = 64
READ_ONLY = frozenset((*range(7), 69, 70, *range(120, TABLE_SIZE)))
GOALS = range(GOAL_PWM.address, GOAL_POSITION.address + GOAL_POSITION.size)
"""Goals, and the profile on the way to them."""

POSITION_MODE = 3
EXTENDED_POSITION_MODE = 4
CURRENT_POSITION_MODE = 5
MODE_NAMES = {
    0: "current",
    1: "velocity",
    POSITION_MODE: "position",
    EXTENDED_POSITION_MODE: "extended position",
    CURRENT_POSITION_MODE: "current-based position",
    16: "pwm",
}

WATCHDOG_OFF = 0
WATCHDOG_TRIPPED = -1
WATCHDOG_COUNT_S = 0.02

BAUD_RATES = (9_600, 57_600, 115_200, 1_000_000, 2_000_000, 3_000_000, 4_000_000)
"""Rate per code of register 8."""

MODEL_NUMBERS = {
    1020: "XM430-W350",
    1060: "XL430-W250",
    1070: "XC430",
    1120: "XM540-W270",
    1190: "XL330-M077",
    1200: "XL330-M288",
    1210: "XC330-T181",
    1220: "XC330-T288",
}

ERROR_NUMBERS = {
    1: "result fail",
    2: "instruction error",
    3: "CRC error",
    4: "data range error",
    5: "data length error",
    6: "data limit error",
    7: "access error",
}
RESULT_FAIL, INSTRUCTION_ERROR, CRC_ERROR, RANGE_ERROR, LENGTH_ERROR, LIMIT_ERROR, ACCESS_ERROR = ERROR_NUMBERS
ALERT = 0x80
"""Bit of the error byte: register 70 is not zero. Not an error of the reply, which is whole."""

VOLTAGE_BIT, OVERHEAT_BIT, ENCODER_BIT, SHOCK_BIT, OVERLOAD_BIT = 0x01, 0x04, 0x08, 0x10, 0x20
HARDWARE_BITS = {
    VOLTAGE_BIT: "voltage",
    OVERHEAT_BIT: "overheat",
    ENCODER_BIT: "encoder",
    SHOCK_BIT: "electric shock",
    OVERLOAD_BIT: "overload",
}


def error_words(hardware_error: int) -> str:
    """The names of the bits set in register 70."""
    known = [word for bit, word in HARDWARE_BITS.items() if hardware_error & bit]
    rest = hardware_error & ~sum(HARDWARE_BITS)
    return ", ".join(known + ([f"unknown 0x{rest:02x}"] if rest else []))


def _crc_table() -> tuple[int, ...]:
    """Polynomial 0x8005, most significant bit first."""
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x18005 if crc & 0x8000 else 0)
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes, crc: int = 0) -> int:
    """CRC of ``data``; ``crc``: of what came before it."""
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC[crc >> 8 ^ byte]
    return crc


class Packet(NamedTuple):
    """One checked frame. ``code``: the instruction, or STATUS, which alone has an ``error`` byte."""

    id: int
    code: int
    params: bytes
    error: int = 0

    @property
    def alert(self) -> bool:
        return bool(self.error & ALERT)

    @property
    def failure(self) -> str:
        """Why the servo did not do what it was asked; empty when it did. The alert bit is no failure."""
        number = self.error & ~ALERT
        return ERROR_NUMBERS.get(number, f"error {number}") if number else ""


def frame(servo_id: int, code: int, params: bytes = b"", error: int | None = None) -> bytes:
    """Bytes of one frame; ``error``: of a status (default: its error byte is 0)."""
    body = bytes((code,)) if code != STATUS else bytes((code, error or 0))
    stuffed = (body + params).replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    data = HEADER + bytes((servo_id,)) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed
    return data + crc16(data).to_bytes(2, "little")


def status(servo_id: int, error: int = 0, params: bytes = b"") -> bytes:
    return frame(servo_id, STATUS, params, error)


def _words(*values: int) -> bytes:
    return b"".join(value.to_bytes(2, "little") for value in values)


def ping(servo_id: int) -> bytes:
    return frame(servo_id, PING)


def reboot(servo_id: int) -> bytes:
    """Drops the torque, and all of the RAM."""
    return frame(servo_id, REBOOT)


def read(servo_id: int, address: int, size: int) -> bytes:
    return frame(servo_id, READ, _words(address, size))


def write(servo_id: int, register: Register, value: int) -> bytes:
    return frame(servo_id, WRITE, _words(register.address) + register.encode(value))


def torque(servo_id: int, on: bool) -> bytes:
    return write(servo_id, TORQUE_ENABLE, int(on))


def sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    return frame(BROADCAST, SYNC_READ, _words(address, size) + bytes(ids))


def fast_sync_read(ids: Sequence[int], address: int, size: int) -> bytes:
    """As ``sync_read``, but all answer in one frame: see ``fast_status``."""
    return frame(BROADCAST, FAST_SYNC_READ, _words(address, size) + bytes(ids))


def fast_status(answers: Sequence[tuple[int, int, bytes]], expected: int) -> bytes:
    """The one frame that answers a fast sync read: (id, error, data) of each servo in turn, each closed by the
    CRC of everything so far. Each is as long as was asked for, so nothing is stuffed [assumed]. When fewer
    than ``expected`` answer, the frame ends early."""
    size = len(answers[0][2]) if answers else 0
    data = HEADER + bytes((BROADCAST,)) + _words(1 + expected * (4 + size)) + bytes((STATUS,))
    for servo_id, error, block in answers:
        data += bytes((error, servo_id)) + block
        data += crc16(data).to_bytes(2, "little")
    return data


def fast_answers(packet: Packet, size: int) -> dict[int, Packet]:
    """What each servo said in the answer to a fast sync read of ``size`` bytes, by id."""
    block = bytes((packet.error,)) + packet.params + b"\0\0"  # the last CRC closed the frame
    rows = [block[at : at + 4 + size] for at in range(0, len(block) - size - 3, 4 + size)]
    return {row[1]: Packet(row[1], STATUS, row[2 : 2 + size], row[0]) for row in rows}


def sync_write(register: Register, values: Mapping[int, int]) -> bytes:
    rows = b"".join(bytes((servo_id,)) + register.encode(value) for servo_id, value in values.items())
    return frame(BROADCAST, SYNC_WRITE, _words(register.address, register.size) + rows)


def goals(counts: Mapping[int, int]) -> bytes:
    """One setpoint for all."""
    return sync_write(GOAL_POSITION, counts)


def hold(positions: Mapping[int, int]) -> bytes:
    """Goals := the measured positions. Written as the block profile velocity + goal (112, eight bytes, velocity
    0: no profile, as after power on), where a setpoint writes the goal alone: so the wire itself tells a
    hold from a setpoint, and a servo that was on its way is not eased to its stop."""
    rows = b"".join(
        bytes((servo_id,)) + bytes(PROFILE_VELOCITY.size) + GOAL_POSITION.encode(count)
        for servo_id, count in positions.items()
    )
    size = PROFILE_VELOCITY.size + GOAL_POSITION.size
    return frame(BROADCAST, SYNC_WRITE, _words(PROFILE_VELOCITY.address, size) + rows)


LIMP = torque(BROADCAST, False)
"""Torque off on every servo in one frame, without knowing who is there: the second path needs no more. A
broadcast has no status: confirm by reading register 64."""

RESYNC = b"\0\0\0\0"
"""In front of the first safe frame. After a torn header, or one with its id, our own FF FF would be taken for
a length and 65 kB be waited for; a length of 0 is none, and the parser begins anew."""


class Decoder:
    """Bytes in any pieces, checked packets out. Garbage is skipped and counted, a torn frame waits for its rest."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.garbage_bytes = 0
        self.damaged: list[int] = []
        """Ids of frames with a wrong CRC; a servo answers one that was meant for it with an error."""

    @property
    def pending(self) -> int:
        """Bytes of a frame that has not ended yet."""
        return len(self._buffer)

    def clear(self) -> None:
        self._buffer.clear()

    def feed(self, data: bytes) -> Iterator[Packet]:
        buffer = self._buffer
        buffer += data
        while True:
            start = buffer.find(HEADER)
            if start < 0:
                self._drop(len(buffer) - _beginning(buffer))
                return
            self._drop(start)
            if len(buffer) < 7:
                return
            length = buffer[5] | buffer[6] << 8
            if not 3 <= length <= MAX_LENGTH:
                self._drop(len(HEADER))
                continue
            if len(buffer) < 7 + length:
                return
            whole = bytes(buffer[: 7 + length])
            if crc16(whole[:-2]).to_bytes(2, "little") != whole[-2:]:
                self.damaged.append(whole[4])
                self._drop(len(HEADER))
                continue
            del buffer[: 7 + length]
            yield _packet(whole)

    def _drop(self, count: int) -> None:
        if count:
            self.garbage_bytes += count
            del self._buffer[:count]


def _beginning(buffer: bytearray) -> int:
    """How many of the last bytes may be the beginning of a header."""
    return next((size for size in (3, 2, 1) if buffer.endswith(HEADER[:size])), 0)


def _packet(whole: bytes) -> Packet:
    servo_id, code, body = whole[4], whole[7], whole[8:-2]
    if code == STATUS and servo_id == BROADCAST:  # of a fast read: nothing in it is stuffed
        return Packet(servo_id, code, body[1:], body[0] if body else 0)
    body = body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
    if code == STATUS:
        return Packet(servo_id, code, body[1:], body[0] if body else 0)
    return Packet(servo_id, code, body)


def rows_of(packet: Packet) -> tuple[int, dict[int, bytes]]:
    """Of a sync write: the first address, and the bytes for each servo."""
    address, size = (int.from_bytes(packet.params[at : at + 2], "little") for at in (0, 2))
    rows = packet.params[4:]
    return address, {rows[i]: rows[i + 1 : i + 1 + size] for i in range(0, len(rows) - size, size + 1)}


def classify(packet: Packet) -> str:
    """What a request means for the wire log: setpoint, safe, enable, read, config or other."""
    if packet.code in (PING, READ, SYNC_READ, FAST_SYNC_READ, BULK_READ, FAST_BULK_READ):
        return "read"
    if packet.code in (WRITE, REG_WRITE) and len(packet.params) > 2:
        return _classify_write(int.from_bytes(packet.params[:2], "little"), (packet.params[2:],))
    if packet.code == SYNC_WRITE and len(packet.params) > 4:
        address, rows = rows_of(packet)
        return _classify_write(address, tuple(rows.values()))
    return "other"


def _classify_write(address: int, rows: Sequence[bytes]) -> str:
    covers = range(address, address + max(map(len, rows), default=0))
    if TORQUE_ENABLE.address in covers:
        at = TORQUE_ENABLE.address - address
        return "safe" if all(row[at] == 0 for row in rows if len(row) > at) else "enable"
    if address == PROFILE_VELOCITY.address and covers.stop == GOALS.stop and not any(any(row[:4]) for row in rows):
        return "safe"
    if covers.start < GOALS.stop and covers.stop > GOALS.start:
        return "setpoint"
    return "config"


def rung(packet: Packet, ids: Collection[int]) -> str:
    """The rung that a request by itself brings all of ``ids`` to: limp, hold, or none."""
    if packet.code not in (WRITE, SYNC_WRITE) or classify(packet) != "safe":
        return ""
    if packet.code == WRITE:
        return "limp" if packet.id == BROADCAST else ""
    address, rows = rows_of(packet)
    if not rows.keys() >= set(ids):
        return ""
    return "hold" if address == PROFILE_VELOCITY.address else "limp"
