"""Unitree's low-level frames: LowCmd and LowState of both families, and their checksum. No I/O, no clock.

A frame is XCDR1, little endian, without its four-byte encapsulation. There are two families of frames: G1 and H1-2
use ``hg`` (with places, called slots, for 35 motors), and Go2, B2 and H1 use ``go`` (20 slots). A codec is made for
one robot. Slots without a motor are zero and are never read.

CDR aligns members, not structs. So the mode byte of the first motor directly follows the head of the frame, and the
padding is behind this byte. The robot computes the checksum over its C struct, in which the padding is before this
byte. So ``checksum`` moves the padding first.
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
"""The charge that a simulated robot of the family ``go`` sends if its charge is unknown [assumed]."""

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
    """A joint command (LowCmd). Each tuple has one value per joint, in the vendor's names."""

    machine: int  # The field ``mode_machine``, which only the family ``hg`` has.
    mode: tuple[int, ...]
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    kp: tuple[float, ...]
    kd: tuple[float, ...]


class State(NamedTuple):
    """A LowState of the robot. Joint values are in rad, rad/s, Nm and degrees Celsius."""

    machine: int
    tick: int
    quaternion: tuple[float, ...]  # Orientation of the body as w, x, y, z.
    gyroscope: tuple[float, ...]  # Angular velocity of the body in rad/s.
    accelerometer: tuple[float, ...]  # Acceleration of the body in m/s2.
    q: tuple[float, ...]
    dq: tuple[float, ...]
    tau: tuple[float, ...]
    temperature: tuple[int, ...]
    soc: int | None  # Charge of the battery in percent. None: unknown, or published on a separate topic.


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
    """Compute the checksum of a frame. The last four bytes of ``body``, its place, are ignored."""
    start = first_motor
    pad = -start % 4
    return _crc(body[:start] + bytes(pad) + body[start : start + 1] + b"\0\0\0" + body[start + pad : -4])


# -- the codecs


def _motors(model: Model, first: str, later: str, bytes_each: int) -> str:
    """Return the format for ``struct`` of all motor slots.

    ``first`` is the format of slot 0, and ``later`` that of the other slots. Slots without a motor are padding.
    """
    used = set(model.slots)
    codes = []
    for slot in range(SLOTS[model.family]):
        if slot in used:
            codes.append(later if slot else first)
        else:
            codes.append(f"{bytes_each}x" if slot else f"{struct.calcsize('<' + first)}x")
    return "".join(codes)


class CommandCodec:
    """Encode and decode the LowCmd of one robot.

    For speed, ``encode`` reuses one buffer, and writes only the values of the joints and the checksum.
    """

    def __init__(self, model: Model) -> None:
        self._family: Family = model.family
        self._first_motor = _FIRST_MOTOR[self._family, "command"]
        if self._family == "hg":
            stride = 28
            code = f"<BB{_motors(model, 'Bx5f4x', 'B3x5f4x', stride)}16xI"
            head: list[float] = [
                0,
                0,
            ]  # mode_pr 0: ankles are commanded by pitch and roll, not by their two motors.
        else:
            stride = 36
            code = f"<BBB19x{_motors(model, 'Bx5f12x', 'B3x5f12x', stride)}64xI"
            head = [*HEAD, LEVEL_LOW]
        self._struct = struct.Struct(code)
        assert self._struct.size == COMMAND_BYTES[self._family]
        # The order of the joints may differ from the order of their slots in the frame.
        count = len(model.joints)
        self._order = sorted(range(count), key=model.slots.__getitem__)
        self._in_order = self._order == list(range(count))
        self.modes = tuple(joint.mode for joint in model.joints)
        self._start = len(head)
        self._width = 6 * count
        idle = [word for index in self._order for word in (self.modes[index], 0.0, 0.0, 0.0, 0.0, 0.0)]
        self._body = bytearray(self._struct.pack(*head, *idle, 0))
        # First pack the values into a second buffer, row by row (q, dq, tau, kp, kd). Then copy each row into the
        # motors of the frame.
        used = set(model.slots)
        slots = max(used) + 1
        row = "".join("f" if slot in used else "4x" for slot in range(slots))
        self._rows = struct.Struct(f"<{5 * row}")
        self._by_slot = [count * row_index + index for row_index in range(5) for index in self._order]
        self._packed = bytearray(self._rows.size)
        words, values = memoryview(self._body).cast("f"), memoryview(self._packed).cast("f")
        # ``first`` is the index of the first value, after the mode byte of the first motor and its padding.
        step, first = stride // 4, (self._first_motor + 2) // 4
        self._columns = [
            (words[first + row_index :][: step * slots : step], values[slots * row_index :][:slots])
            for row_index in range(5)
        ]

    def encode(self, machine: int, values: Sequence[float]) -> bytes:
        """Return a complete frame that commands every joint.

        ``values`` has q of all joints, then dq, tau, kp and kd of all joints.
        """
        body = self._body
        if self._family == "hg":
            body[1] = machine
        if not self._in_order:
            values = [values[index] for index in self._by_slot]
        self._rows.pack_into(self._packed, 0, *values)
        for motors, row in self._columns:
            motors[:] = row
        body[-4:] = checksum(body, self._first_motor).to_bytes(4, "little")
        return bytes(body)

    def decode(self, body: bytes) -> Command:
        """Decode a joint command. Raise ``MalformedFrame`` if its length or checksum is wrong."""
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
    """Raised for a frame that has the right length but a wrong checksum."""


class StateCodec:
    """Encode and decode the LowState of one robot."""

    def __init__(self, model: Model, unsealed: bool = False) -> None:
        """Make a codec for ``model``. If ``unsealed``, it also accepts states with the checksum 0 (no checksum)."""
        self._unsealed = unsealed
        self._family: Family = model.family
        self._first_motor = _FIRST_MOTOR[self._family, "state"]
        if self._family == "hg":
            # These fields of each motor are not read: ddq, second temperature, volt, sensor, motorstate, reserve.
            motors = _motors(model, "Bx2f4xfh34x", "B3x2f4xfh34x", 56)
            code = f"<9xB2xI13fh{motors}56xI"
            self._stride, self._start = 5, 16
        else:
            # These fields of each motor are not read: ddq, the three raw values, lost, reserve.
            motors = _motors(model, "B2x2f4xf12xB15x", "B3x2f4xf12xB15x", 48)
            code = f"<24x13fB{motors}3xB56xI72xI"
            self._stride, self._start = 5, 14
        self._struct = struct.Struct(code)
        assert self._struct.size == STATE_BYTES[self._family]
        self._order = sorted(range(len(model.joints)), key=model.slots.__getitem__)
        self._in_order = self._order == list(range(len(model.joints)))
        self._joints = len(model.joints)

    def decode(self, body: bytes | memoryview) -> State:
        """Decode a LowState.

        For the family ``go`` the checksum is not checked, because the C layout of its frame was not verified.

        Raises:
            MalformedFrame: The length or the checksum is wrong, or a number is not finite. Joints may be commanded
                to hold these positions, so they must be finite.
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
        """Encode a LowState. Only the simulated robot needs this."""
        columns = ((1,) * self._joints, state.q, state.dq, state.tau, state.temperature)
        motors: list[float] = [0] * (self._stride * self._joints)
        for offset, column in enumerate(columns):
            motors[offset :: self._stride] = column if self._in_order else [column[index] for index in self._order]
        rpy = roll_pitch_yaw(
            state.quaternion
        )  # This driver reads the quaternion. Other clients read roll, pitch, yaw.
        imu = (*state.quaternion, *state.gyroscope, *state.accelerometer, *rpy)
        temperature = 40  # Temperature of the IMU in degrees Celsius.
        if self._family == "hg":
            body = bytearray(self._struct.pack(state.machine, state.tick, *imu, temperature, *motors, 0))
        else:
            soc = NO_CHARGE if state.soc is None else state.soc
            body = bytearray(self._struct.pack(*imu, temperature, *motors, soc, state.tick, 0))
            body[:3] = (*HEAD, LEVEL_LOW)
        body[-4:] = checksum(bytes(body), self._first_motor).to_bytes(4, "little")
        return bytes(body)


def _reordered(row: tuple[float, ...], order: Sequence[int]) -> tuple[float, ...]:
    """Reorder values from the order of the slots to the order of the joints."""
    values = [0.0] * len(row)
    for value, index in zip(row, order, strict=True):
        values[index] = value
    return tuple(values)


# -- the battery, which the family hg publishes on a separate topic


def decode_battery(body: bytes | memoryview) -> int:
    """Decode the battery's charge in percent. Raise ``MalformedFrame`` if length or charge is impossible."""
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
