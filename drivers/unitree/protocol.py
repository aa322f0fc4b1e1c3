"""Unitree's low-level frames: LowCmd and LowState of both families, and their checksum. No I/O, no clock.

A frame is XCDR1, little endian, without its four-byte encapsulation. G1 and H1-2 speak ``hg`` (35 slots);
Go2, B2 and H1 speak ``go`` (20 slots). A codec is made for one robot: slots without a motor are zero and
are never read.

CDR aligns members, not structs: the first motor's mode byte follows the head directly, with less padding
behind it than in the other motors. The checksum covers the C struct, in which the padding stands before that
byte, so it is not computed over these bytes directly.
"""

from __future__ import annotations

import array
import math
import struct
import sys
import zlib
from collections.abc import Sequence
from typing import Literal, NamedTuple

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .robots import Model

Family = Literal["hg", "go"]

SLOTS: dict[Family, int] = {"hg": 35, "go": 20}
COMMAND_BYTES: dict[Family, int] = {"hg": 1000, "go": 808}
STATE_BYTES: dict[Family, int] = {"hg": 2088, "go": 1176}

COMMAND_TOPIC, STATE_TOPIC = "rt/lowcmd", "rt/lowstate"
BATTERY_TOPIC, BATTERY_TYPE = "rt/lf/bmsstate", "unitree_hg::msg::dds_::BmsState_"
BATTERY_BYTES = 164
_BATTERY_SOC = 100
"""Offset of the state of charge in a BmsState (computed from its layout, never checked against a robot)."""

FULL_PCT = 100
"""A larger number is no valid charge."""
NO_CHARGE = 255
"""The charge that the twin of ``go`` sends for an unknown battery [assumed]."""

LEVEL_LOW = 0xFF
HEAD = b"\xfe\xef"

_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
_FIRST_MOTOR = {
    ("hg", "command"): 2,
    ("hg", "state"): 70,
    ("go", "command"): 22,
    ("go", "state"): 77,
}


def command_type(family: Family) -> str:
    return f"unitree_{family}::msg::dds_::LowCmd_"


def state_type(family: Family) -> str:
    return f"unitree_{family}::msg::dds_::LowState_"


class Command(NamedTuple):
    """A LowCmd, by joint."""

    machine: int  # mode_machine; hg only
    mode: tuple[int, ...]
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]


class State(NamedTuple):
    """A LowState, with rows by joint. Radians, newton metres, degrees Celsius."""

    machine: int
    tick: int
    quaternion: tuple[float, ...]  # w x y z
    gyroscope: tuple[float, ...]  # rad/s
    accelerometer: tuple[float, ...]  # m/s2
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    temperature: tuple[int, ...]
    soc: int | None  # percent; None: not known, or the battery has a topic of its own


# -- the checksum


def _crc(image: bytes | bytearray) -> int:
    """Return the CRC-32/MPEG-2 over little-endian words, most significant byte first. zlib's CRC is its
    mirror image."""
    words = array.array("I", image)
    if sys.byteorder == "little":
        words.byteswap()
    mirrored = zlib.crc32(words.tobytes().translate(_REVERSED)) ^ 0xFFFFFFFF
    return int.from_bytes(mirrored.to_bytes(4, "little").translate(_REVERSED), "big")


def checksum(body: bytes | bytearray, first_motor: int) -> int:
    """Return the checksum of a frame. The last word, the checksum itself, is ignored."""
    at = first_motor
    pad = -at % 4
    return _crc(body[:at] + bytes(pad) + body[at : at + 1] + b"\0\0\0" + body[at + pad : -4])


# -- the codecs


def _motors(model: Model, first: str, other: str, bytes_each: int) -> str:
    """Return struct codes of all slots: ``first`` for slot 0, ``other`` for the rest, padding for slots
    without a motor."""
    used = set(model.slots)
    codes = []
    for slot in range(SLOTS[model.family]):
        if slot in used:
            codes.append(other if slot else first)
        else:
            codes.append(f"{bytes_each}x" if slot else f"{struct.calcsize('<' + first)}x")
    return "".join(codes)


class CommandCodec:
    """The LowCmd of one robot. ``encode`` rewrites the joints' values and the checksum in one buffer; all
    other bytes stay."""

    def __init__(self, model: Model) -> None:
        self._family: Family = model.family
        self._first_motor = _FIRST_MOTOR[self._family, "command"]
        if self._family == "hg":
            stride = 28
            code = f"<BB{_motors(model, 'Bx5f4x', 'B3x5f4x', stride)}16xI"
            head: list[float] = [0, 0]  # mode_pr: pitch and roll of the ankles, not their two motors
        else:
            stride = 36
            code = f"<BBB19x{_motors(model, 'Bx5f12x', 'B3x5f12x', stride)}64xI"
            head = [*HEAD, LEVEL_LOW]
        self._struct = struct.Struct(code)
        assert self._struct.size == COMMAND_BYTES[self._family]
        # The slots need not be in the order of the joints.
        count = len(model.joints)
        self._order = sorted(range(count), key=model.slots.__getitem__)
        self._in_order = self._order == list(range(count))
        self.modes = tuple(joint.mode for joint in model.joints)
        self._start = len(head)
        self._width = 6 * count
        idle = [word for at in self._order for word in (self.modes[at], 0.0, 0.0, 0.0, 0.0, 0.0)]
        self._body = bytearray(self._struct.pack(*head, *idle, 0))
        # Pack row by row, with gaps for slots without a motor. From there copy into the motors, value by
        # value.
        used = set(model.slots)
        slots = max(used) + 1
        row = "".join("f" if slot in used else "4x" for slot in range(slots))
        self._rows = struct.Struct(f"<{5 * row}")
        self._by_slot = [count * kind + at for kind in range(5) for at in self._order]
        self._packed = bytearray(self._rows.size)
        words, values = memoryview(self._body).cast("f"), memoryview(self._packed).cast("f")
        step, first = stride // 4, (self._first_motor + 2) // 4  # after the first motor's mode and its padding
        self._columns = [
            (words[first + kind :][: step * slots : step], values[slots * kind :][:slots]) for kind in range(5)
        ]

    def encode(self, machine: int, values: Sequence[float]) -> bytes:
        """Return a frame with a checksum that commands every joint. ``values`` are the rows q, dq, tau, kp
        and kd, one after the other."""
        body = self._body
        if self._family == "hg":
            body[1] = machine
        if not self._in_order:
            values = [values[at] for at in self._by_slot]
        self._rows.pack_into(self._packed, 0, *values)
        for motors, row in self._columns:
            motors[:] = row
        body[-4:] = checksum(body, self._first_motor).to_bytes(4, "little")
        return bytes(body)

    def decode(self, body: bytes) -> Command:
        """Return the command of a frame. Raise ``MalformedFrame`` if its length or checksum is wrong."""
        if len(body) != COMMAND_BYTES[self._family]:
            expected = COMMAND_BYTES[self._family]
            raise MalformedFrame(f"a LowCmd of {self._family} has {expected} bytes, not {len(body)}")
        if checksum(body, self._first_motor) != int.from_bytes(body[-4:], "little"):
            raise MalformedFrame("the checksum of the LowCmd is wrong")
        flat = self._struct.unpack(body)
        rows = [flat[self._start + offset : self._start + self._width : 6] for offset in range(6)]
        if not self._in_order:
            rows = [_reordered(row, self._order) for row in rows]
        return Command(int(flat[1]) if self._family == "hg" else 0, *rows)


class WrongChecksum(MalformedFrame):
    """A complete frame has a wrong checksum."""


class StateCodec:
    """LowState of one robot."""

    def __init__(self, model: Model, unsealed: bool = False) -> None:
        """``unsealed``: also accept a state without a checksum, with 0 in its place."""
        self._unsealed = unsealed
        self._family: Family = model.family
        self._first_motor = _FIRST_MOTOR[self._family, "state"]
        if self._family == "hg":
            # Skipped in each motor: ddq, second temperature, volt, sensor, motorstate, reserve.
            motors = _motors(model, "Bx2f4xfh34x", "B3x2f4xfh34x", 56)
            code = f"<9xB2xI13fh{motors}56xI"
            self._stride, self._start = 5, 16
        else:
            # Skipped in each motor: ddq, the three raw values, lost, reserve.
            motors = _motors(model, "B2x2f4xf12xB15x", "B3x2f4xf12xB15x", 48)
            code = f"<24x13fB{motors}3xB56xI72xI"
            self._stride, self._start = 5, 14
        self._struct = struct.Struct(code)
        assert self._struct.size == STATE_BYTES[self._family]
        self._order = sorted(range(len(model.joints)), key=model.slots.__getitem__)
        self._in_order = self._order == list(range(len(model.joints)))
        self._joints = len(model.joints)

    def decode(self, body: bytes | memoryview) -> State:
        """Return the state of a frame.

        The checksum of ``go`` is not checked, since its C layout has not been verified.

        Raises:
            MalformedFrame: Its length or checksum is wrong, or a number is not finite. Joints are held at
                these positions, so they must be finite.
        """
        if len(body) != STATE_BYTES[self._family]:
            expected = STATE_BYTES[self._family]
            raise MalformedFrame(f"a LowState of {self._family} has {expected} bytes, not {len(body)}")
        flat = self._struct.unpack(body)
        if self._family == "hg":
            unsealed = self._unsealed and flat[-1] == 0
            if not unsealed and checksum(bytes(body), self._first_motor) != flat[-1]:
                raise WrongChecksum("the checksum of the LowState is wrong")
            machine, tick, soc = flat[0], flat[1], None
            imu = flat[2:]
        else:
            machine, tick, soc = 0, flat[-2], flat[-3] if flat[-3] <= FULL_PCT else None
            imu = flat
        end = self._start + self._stride * self._joints
        rows = [flat[self._start + offset : end : self._stride] for offset in range(1, 5)]
        if not self._in_order:
            rows = [_reordered(row, self._order) for row in rows]
        q, dq, tau, temperature = rows
        if not all(map(math.isfinite, (*imu[:10], *q, *dq, *tau))):
            raise MalformedFrame("a LowState with a number that is not finite")
        return State(machine, tick, imu[:4], imu[4:7], imu[7:10], q, dq, tau, temperature, soc)

    def encode(self, state: State) -> bytes:
        """Return the frame of a state, for twins."""
        columns = ((1,) * self._joints, state.q, state.dq, state.tau, state.temperature)
        motors: list[float] = [0] * (self._stride * self._joints)
        for offset, column in enumerate(columns):
            motors[offset :: self._stride] = column if self._in_order else [column[at] for at in self._order]
        rpy = roll_pitch_yaw(state.quaternion)  # for other clients; ours reads the quaternion
        imu = (*state.quaternion, *state.gyroscope, *state.accelerometer, *rpy)
        temperature = 40  # of the inertial unit
        if self._family == "hg":
            body = bytearray(self._struct.pack(state.machine, state.tick, *imu, temperature, *motors, 0))
        else:
            soc = NO_CHARGE if state.soc is None else state.soc
            body = bytearray(self._struct.pack(*imu, temperature, *motors, soc, state.tick, 0))
            body[:3] = (*HEAD, LEVEL_LOW)
        body[-4:] = checksum(bytes(body), self._first_motor).to_bytes(4, "little")
        return bytes(body)


def _reordered(row: tuple[float, ...], order: Sequence[int]) -> tuple[float, ...]:
    """Reorder a row from slots to joints."""
    values = [0.0] * len(row)
    for value, at in zip(row, order, strict=True):
        values[at] = value
    return tuple(values)


# -- the battery of hg


def decode_battery(body: bytes | memoryview) -> int:
    """Return the state of charge in percent. Raise ``MalformedFrame`` for a wrong length or charge."""
    if len(body) != BATTERY_BYTES:
        raise MalformedFrame(f"a BmsState has {BATTERY_BYTES} bytes, not {len(body)}")
    soc = int(body[_BATTERY_SOC])
    if soc > FULL_PCT:
        raise MalformedFrame(f"a state of charge of {soc} percent")
    return soc


def encode_battery(soc: int) -> bytes:
    body = bytearray(BATTERY_BYTES)
    body[_BATTERY_SOC] = soc
    return bytes(body)
