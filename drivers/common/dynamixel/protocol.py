"""Encode and decode the frames of Dynamixel Protocol 2.0, with their checksums. Pure: no I/O, no clock.

The registers are in ``table``. An instruction is ``FF FF FD 00 id len len inst params.. crc crc``, a status is ``FF
FF FD 00 id len len 55 err params.. crc crc``. ``len`` is the number of bytes that follow it. It has two bytes, the
low one first, as every word of this protocol.

Inside the body ``FF FF FD`` is sent as ``FF FF FD FD``, so that no data looks like a header. Frames have no
sequence number: a late reply looks like the reply to the next request of the same id and length.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from .table import BAUD_RATES as BAUD_RATES
from .table import GOAL_POSITION as GOAL_POSITION
from .table import GOAL_PWM, GOALS, PRESENT_PWM, PROFILE_VELOCITY, Register
from .table import MODEL_NUMBERS as MODEL_NUMBERS
from .table import POSITION as POSITION
from .table import TORQUE_ENABLE as TORQUE_ENABLE

HEADER = b"\xff\xff\xfd\x00"
BROADCAST = 0xFE
MAX_ID = 0xFC
OVERHEAD = 11
"""Bytes of a status without params."""
MAX_LENGTH = 1024
"""The whole control table fits into this length. A longer one is noise, and the decoder does not wait for it."""

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
"""Bit of the error byte: register 70 is not zero. The reply itself is valid."""


def _crc_table() -> tuple[int, ...]:
    """Return the table of the CRC: polynomial 0x8005, most significant bit first."""
    table = []
    for byte in range(256):
        crc = byte << 8
        for _ in range(8):
            crc = crc << 1 ^ (0x18005 if crc & 0x8000 else 0)
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc16(data: bytes, crc: int = 0) -> int:
    """Return the CRC of ``data``. If ``data`` continues earlier bytes, ``crc`` is the CRC of those bytes."""
    for byte in data:
        crc = (crc << 8 & 0xFFFF) ^ _CRC[crc >> 8 ^ byte]
    return crc


class Packet(NamedTuple):
    """One frame with a correct CRC. ``code`` is the instruction; STATUS marks a reply. Only a reply has an
    ``error`` byte."""

    id: int
    code: int
    params: bytes
    error: int = 0

    @property
    def alert(self) -> bool:
        return bool(self.error & ALERT)

    @property
    def failure(self) -> str:
        """Return why the servo did not carry out the request; empty if it did.

        A set alert bit alone is no failure.
        """
        number = self.error & ~ALERT
        return ERROR_NUMBERS.get(number, f"error {number}") if number else ""


def frame(servo_id: int, code: int, params: bytes = b"", error: int = 0) -> bytes:
    """Return the bytes of one frame. A status frame also needs its ``error`` byte."""
    body = bytes((code, error)) if code == STATUS else bytes((code,))
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
    """Return a frame that reboots the servo, which then has no torque and its default RAM values."""
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
    """Return a ``sync_read`` that all servos answer together in one frame (see ``fast_status``)."""
    return frame(BROADCAST, FAST_SYNC_READ, _words(address, size) + bytes(ids))


def fast_status(answers: Sequence[tuple[int, int, bytes]], sizes: Sequence[int]) -> bytes:
    """Return the single frame in which all servos answer a fast sync read or fast bulk read.

    Servo after servo, the frame has the id, error and data of this servo, then the CRC of all bytes so far. The
    data has exactly the requested length, so ``FF FF FD`` in it is not escaped [assumed].

    Args:
        answers: Id, error and data of each servo that answers.
        sizes: Data sizes of all requested servos. If fewer servos answer, the frame ends early.
    """
    data = HEADER + bytes((BROADCAST,)) + _words(1 + sum(4 + size for size in sizes)) + bytes((STATUS,))
    for servo_id, error, block in answers:
        data += bytes((error, servo_id)) + block
        data += crc16(data).to_bytes(2, "little")
    return data


def fast_answers(packet: Packet, size: int) -> dict[int, Packet]:
    """Return each servo's answer, by id, from the answer to a fast sync read of ``size`` bytes."""
    # A reply to a fast read ends with the CRC of its last servo, which the decoder has removed. Two bytes replace
    # it.
    block = bytes((packet.error,)) + packet.params + b"\0\0"
    rows = [block[offset : offset + 4 + size] for offset in range(0, len(block) - size - 3, 4 + size)]
    return {row[1]: Packet(row[1], STATUS, row[2 : 2 + size], row[0]) for row in rows}


def sync_write(register: Register, values: Mapping[int, int]) -> bytes:
    rows = b"".join(bytes((servo_id,)) + register.encode(value) for servo_id, value in values.items())
    return frame(BROADCAST, SYNC_WRITE, _words(register.address, register.size) + rows)


def goals(counts: Mapping[int, int]) -> bytes:
    """Return one frame that sets the goal positions of several servos."""
    return sync_write(GOAL_POSITION, counts)


def hold(positions: Mapping[int, int]) -> bytes:
    """Return a frame that sets the goal positions to the measured positions.

    It writes two registers at once: profile velocity and goal (address 112, eight bytes). Velocity 0 means no
    profile, as after a power-on, so a moving servo stops at once. A setpoint writes only the goal. So a log can
    distinguish a hold from a setpoint.
    """
    rows = b"".join(
        bytes((servo_id,)) + bytes(PROFILE_VELOCITY.size) + GOAL_POSITION.encode(count)
        for servo_id, count in positions.items()
    )
    size = PROFILE_VELOCITY.size + GOAL_POSITION.size
    return frame(BROADCAST, SYNC_WRITE, _words(PROFILE_VELOCITY.address, size) + rows)


LOWERING_VELOCITY = 100
"""Highest speed of a servo while its arm is lowered, 22.9 rpm. The servo itself keeps it, even if no further frame
comes."""

TORQUE_LIMIT = GOAL_PWM
EFFORT, FULL_EFFORT = PRESENT_PWM, 885


def lower(goals: Mapping[int, int], torque_limits: Mapping[int, int]) -> bytes:
    """Return two frames with the torque limit (goal PWM), and with the highest speed and the goal of each servo
    while its arm is lowered. A hold has no highest speed, and a setpoint has a goal only, so a log can distinguish
    them."""
    rows = b"".join(
        bytes((servo_id,)) + PROFILE_VELOCITY.encode(LOWERING_VELOCITY) + GOAL_POSITION.encode(count)
        for servo_id, count in goals.items()
    )
    size = PROFILE_VELOCITY.size + GOAL_POSITION.size
    limits = {servo_id: torque_limits[servo_id] for servo_id in goals}
    return full_torque(limits) + frame(BROADCAST, SYNC_WRITE, _words(PROFILE_VELOCITY.address, size) + rows)


def full_torque(torque_limits: Mapping[int, int]) -> bytes:
    """Return a frame with the torque limit of each servo. The next hold lifts the speed limit."""
    return sync_write(GOAL_PWM, torque_limits)


LIMP = torque(BROADCAST, False)
"""Torque off on every servo in one frame, for any ids. The stop channel needs no other frame. A broadcast gets no
status, so register 64 is read to confirm."""

RESYNC = b"\0\0\0\0"
"""Bytes before the first safe frame. After a torn header, with or without its id, the servo would read our FF FF as
a length and wait for 65 kB. A length of 0 is invalid, so its parser starts again."""


class Decoder:
    """Decode a stream of bytes into packets with a correct CRC.

    Bytes that belong to no packet are skipped and counted. An incomplete frame is kept until the rest of it
    arrives.
    """

    def __init__(self) -> None:
        self._buffer = bytearray()
        self.garbage_bytes = 0
        self._damaged: list[tuple[int, bytes]] = []

    @property
    def pending(self) -> int:
        """The number of received bytes of a frame that is not complete yet."""
        return len(self._buffer)

    def clear(self) -> None:
        self._buffer.clear()

    def take_damaged(self) -> list[tuple[int, bytes]]:
        """Return the frames with a wrong CRC since the last call, each with its servo id.

        The simulated bus answers them: a real servo also reports a wrong CRC in its status.
        """
        damaged, self._damaged = self._damaged, []
        return damaged

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
                self._damaged = [*self._damaged[-9:], (whole[4], whole)]
                self._drop(len(HEADER))
                continue
            del buffer[: 7 + length]
            yield _packet(whole)

    def _drop(self, count: int) -> None:
        if count:
            self.garbage_bytes += count
            del self._buffer[:count]


def _beginning(buffer: bytearray) -> int:
    """Return the number of bytes at the end of the buffer that may be the beginning of a header."""
    return next((size for size in (3, 2, 1) if buffer.endswith(HEADER[:size])), 0)


def _packet(whole: bytes) -> Packet:
    servo_id, code, body = whole[4], whole[7], whole[8:-2]
    # The reply to a fast read is sent without escaping ``FF FF FD``.
    if code == STATUS and servo_id == BROADCAST:
        return Packet(servo_id, code, body[1:], body[0] if body else 0)
    body = body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
    if code == STATUS:
        return Packet(servo_id, code, body[1:], body[0] if body else 0)
    return Packet(servo_id, code, body)


def rows_of(packet: Packet) -> tuple[int, dict[int, bytes]]:
    """Return the first register address that a sync write (one write request to several servos) changes, and the
    bytes for each servo, by id."""
    address, size = (int.from_bytes(packet.params[offset : offset + 2], "little") for offset in (0, 2))
    rows = packet.params[4:]
    return address, {rows[i]: rows[i + 1 : i + 1 + size] for i in range(0, len(rows) - size, size + 1)}


def classify(packet: Packet) -> str:
    """Return the kind of a request, for the log: setpoint, safe, lowering, enable, read, config or
    other."""
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
        offset = TORQUE_ENABLE.address - address
        return "safe" if all(row[offset] == 0 for row in rows if len(row) > offset) else "enable"
    if address == PROFILE_VELOCITY.address and covers.stop == GOALS.stop and not any(any(row[:4]) for row in rows):
        return "safe"
    lowering_speed = PROFILE_VELOCITY.encode(LOWERING_VELOCITY)
    if (
        address == PROFILE_VELOCITY.address
        and covers.stop == GOALS.stop
        and all(row[: PROFILE_VELOCITY.size] == lowering_speed for row in rows)
    ):
        return "lowering"
    if address == GOAL_PWM.address and len(covers) == GOAL_PWM.size and len(rows) > 1:
        return "config"  # the limits of the torque, without a goal
    if covers.start < GOALS.stop and covers.stop > GOALS.start:
        return "setpoint"
    return "config"


def safe_state(packet: Packet, ids: Collection[int]) -> str:
    """Return the safe state to which this request alone brings all servos in ``ids``: ``limp`` (no torque),
    ``hold`` (torque at the present position), or empty if it does not."""
    if packet.code not in (WRITE, SYNC_WRITE) or classify(packet) != "safe":
        return ""
    if packet.code == WRITE:
        return "limp" if packet.id == BROADCAST else ""
    address, rows = rows_of(packet)
    if not rows.keys() >= set(ids):
        return ""
    return "hold" if address == PROFILE_VELOCITY.address else "limp"
