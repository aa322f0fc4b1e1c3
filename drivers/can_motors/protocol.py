"""Encode and decode the CAN frames of Damiao and RobStride motors in their MIT mode. Pure.

In MIT mode a motor gives the torque ``kp (q - position) + kd (dq - velocity) + tau`` for the five numbers of its
last command, until the next command. It answers each frame with its feedback. Numbers are mapped linearly onto
unsigned integers. The codec converts from the joint to its motor by the sign and the offset of the robot's table.

Damiao     standard frames (11 bits) to the motor's id; its feedback has another id (``feedback``)
RobStride  extended frames (29 bits) of its private protocol: the type of the message is a part of the id

Zero speed lies between two integers. A setpoint of speed zero takes the lower one, and a hold takes the upper one.
So a log of the bus shows which frames may move the arm. The difference, 0.02 rad/s for most motors, has no effect.
"""

from __future__ import annotations

import enum
import struct
from abc import ABC, abstractmethod
from typing import Final, NamedTuple

import msgspec

HOST: Final = 0xFD
"""The id of this computer in RobStride's protocol."""
TICKS_PER_S: Final = 20_000
"""Both families count their timeout in units of 50 us."""


class Frame(NamedTuple):
    """One CAN frame. ``extended``: its id has 29 bits, not 11."""

    id: int
    data: bytes
    extended: bool = False


class Ranges(msgspec.Struct, frozen=True):
    """The largest value of each number, in rad, rad/s, Nm, Nm/rad and Nm s/rad. Gains begin at 0."""

    position: float
    velocity: float
    torque: float
    kp: float
    kd: float


class State(enum.IntEnum):
    """The state that a motor reports. Every state but the first two is a fault, after which it has no torque."""

    DISABLED = 0
    ENABLED = 1
    SENSOR = 5
    PARAMETER = 6
    OVERVOLTAGE = 8
    UNDERVOLTAGE = 9
    OVERCURRENT = 10
    HOT_DRIVER = 11
    HOT_MOTOR = 12
    LOST_COMMUNICATION = 13
    OVERLOAD = 14
    NOT_CALIBRATED = 16
    UNKNOWN = 17


class Feedback(NamedTuple):
    """A motor's report on itself, for its joint. ``rotor_c`` is NaN if the motor does not report it."""

    position: float
    velocity: float
    torque: float
    driver_c: float
    rotor_c: float
    state: State


class Parameter(NamedTuple):
    """The value of one parameter of a motor: the four bytes that it has sent."""

    number: int
    value: bytes

    @property
    def whole(self) -> int:
        return int.from_bytes(self.value, "little")

    @property
    def real(self) -> float:
        return float(struct.unpack("<f", self.value)[0])


class Command(NamedTuple):
    """The five numbers of a command in MIT mode, for the joint. ``hold``: the frame is marked as a hold."""

    q: float = 0.0
    dq: float = 0.0
    tau: float = 0.0
    kp: float = 0.0
    kd: float = 0.0
    hold: bool = False


def to_code(value: float, low: float, high: float, bits: int) -> int:
    """Map a value in ``low`` to ``high`` onto an unsigned integer. A value outside becomes the nearest end."""
    most = (1 << bits) - 1
    return min(most, max(0, round((value - low) / (high - low) * most)))


def from_code(code: int, low: float, high: float, bits: int) -> float:
    return low + code * (high - low) / ((1 << bits) - 1)


def zero_code(bits: int, hold: bool) -> int:
    """Return the integer for speed zero: the upper one of two for a hold, else the lower one."""
    return (1 << (bits - 1)) - (not hold)


class Codec(ABC):
    """The frames of one motor.

    Args:
        motor_id: The motor's id on the bus.
        feedback_id: The id of a Damiao motor's feedback.
        ranges: The ranges of its numbers.
        sign: 1, or -1 if the joint turns against the motor.
        offset: Position of the motor at the joint's zero, in rad.
    """

    TIMEOUT: int
    """Number of the parameter with the time after which a motor without commands switches its torque off."""
    MODE: int
    MIT: int
    """Value of ``MODE`` for the MIT mode."""
    RANGES: tuple[int, ...] = ()
    """Numbers of the parameters with the ranges of position, velocity and torque; empty without such parameters."""
    BITS: int
    """Number of bits of velocity, torque and gains."""

    def __init__(self, motor_id: int, feedback_id: int, ranges: Ranges, sign: int, offset: float) -> None:
        self.id = motor_id
        self.feedback_id = feedback_id
        self.ranges = ranges
        self._sign = sign
        self._offset = offset
        most = (1 << self.BITS) - 1
        # A frame takes less time to decode with these factors: some 2,000 come in a second.
        self._rad = 2 * ranges.position / 0xFFFF
        self._rad_s = 2 * ranges.velocity / most
        self._nm = 2 * ranges.torque / most

    @abstractmethod
    def enable(self) -> Frame: ...
    @abstractmethod
    def disable(self) -> Frame: ...
    @abstractmethod
    def clear(self) -> Frame:
        """Return the frame that clears a latched fault. The motor stays without torque."""

    @abstractmethod
    def ask(self) -> Frame:
        """Return a frame that the motor answers with its feedback, and that changes nothing."""

    @abstractmethod
    def read(self, number: int) -> Frame: ...
    @abstractmethod
    def write(self, number: int, value: int) -> Frame:
        """Return the frame that writes a whole number to a parameter, until the motor's power is switched off."""

    @abstractmethod
    def decode(self, frame: Frame) -> Feedback | Parameter | None:
        """Decode a frame. Return None if it is no frame of this motor."""

    @abstractmethod
    def _mit(self, q: int, dq: int, tau: int, kp: int, kd: int) -> Frame: ...

    def command(self, command: Command) -> Frame:
        """Return the frame of a command."""
        ranges, bits, sign = self.ranges, self.BITS, self._sign
        q, dq, tau, kp, kd, hold = command
        speed = zero_code(bits, hold)
        if dq != 0.0:
            code = to_code(sign * dq, -ranges.velocity, ranges.velocity, bits)
            speed = code if hold or code != zero_code(bits, True) else speed
        return self._mit(
            to_code(sign * q + self._offset, -ranges.position, ranges.position, 16),
            speed,
            to_code(sign * tau, -ranges.torque, ranges.torque, bits),
            to_code(kp, 0.0, ranges.kp, bits),
            to_code(kd, 0.0, ranges.kd, bits),
        )

    def _feedback(self, q: int, dq: int, tau: int, driver_c: float, rotor_c: float, state: State) -> Feedback:
        ranges, sign = self.ranges, self._sign
        return Feedback(
            sign * (q * self._rad - ranges.position - self._offset),
            sign * (dq * self._rad_s - ranges.velocity),
            sign * (tau * self._nm - ranges.torque),
            driver_c,
            rotor_c,
            state,
        )


_STATES = [State.UNKNOWN] * 16
for _state in State:
    if _state < len(_STATES):
        _STATES[_state] = _state


class Damiao(Codec):
    TIMEOUT, MODE, MIT, RANGES, BITS = 9, 10, 1, (21, 22, 23), 12
    ENABLE, DISABLE, CLEAR = 0xFC, 0xFD, 0xFB
    PARAMETERS, READ, WRITE, ASK = 0x7FF, 0x33, 0x55, 0xCC

    def enable(self) -> Frame:
        return self._simple(self.ENABLE)

    def disable(self) -> Frame:
        return self._simple(self.DISABLE)

    def clear(self) -> Frame:
        return self._simple(self.CLEAR)

    def ask(self) -> Frame:
        return self._parameter(self.ASK, 0)

    def read(self, number: int) -> Frame:
        return self._parameter(self.READ, number)

    def write(self, number: int, value: int) -> Frame:
        return self._parameter(self.WRITE, number, value)

    def decode(self, frame: Frame) -> Feedback | Parameter | None:
        number, data, extended = frame
        if extended or number != self.feedback_id or len(data) != 8:
            return None
        head = data[0]
        # A feedback with these three bytes would come from a motor that stands at the very end of its range.
        if head == self.id and not data[1] and data[2] in (self.READ, self.WRITE):
            return Parameter(data[3], data[4:])
        if (head ^ self.id) & 0xF:
            return None
        whole = int.from_bytes(data, "big")
        q, dq, tau = whole >> 40 & 0xFFFF, whole >> 28 & 0xFFF, whole >> 16 & 0xFFF
        return self._feedback(q, dq, tau, float(data[6]), float(data[7]), _STATES[head >> 4])

    def _mit(self, q: int, dq: int, tau: int, kp: int, kd: int) -> Frame:
        return Frame(self.id, (q << 48 | dq << 36 | kp << 24 | kd << 12 | tau).to_bytes(8, "big"))

    def _simple(self, code: int) -> Frame:
        return Frame(self.id, b"\xff" * 7 + bytes((code,)))

    def _parameter(self, code: int, number: int, value: int = 0) -> Frame:
        return Frame(self.PARAMETERS, struct.pack("<HBBI", self.id, code, number, value))


class RobStride(Codec):
    TIMEOUT, MODE, MIT, BITS = 0x7028, 0x7005, 0, 16
    COMMAND, FEEDBACK, ENABLE, DISABLE, READ, WRITE = 0x01, 0x02, 0x03, 0x04, 0x11, 0x12
    FAULTS = (
        State.UNDERVOLTAGE,
        State.OVERCURRENT,
        State.HOT_MOTOR,
        State.SENSOR,
        State.OVERLOAD,
        State.NOT_CALIBRATED,
    )
    """The fault of each of the bits 16 to 21 of a feedback's id."""
    RUNS = 2
    """Value of the bits 22 and 23 while the motor has torque."""

    def enable(self) -> Frame:
        return self._frame(self.ENABLE)

    def disable(self) -> Frame:
        return self._frame(self.DISABLE)

    def clear(self) -> Frame:
        return self._frame(self.DISABLE, b"\x01" + bytes(7))

    def ask(self) -> Frame:
        # These motors have no question for their feedback. Each write is answered with it, and this one writes the
        # mode that the motor has.
        return self.write(self.MODE, self.MIT)

    def read(self, number: int) -> Frame:
        return self._frame(self.READ, struct.pack("<HHI", number, 0, 0))

    def write(self, number: int, value: int) -> Frame:
        return self._frame(self.WRITE, struct.pack("<HHI", number, 0, value))

    def decode(self, frame: Frame) -> Feedback | Parameter | None:
        kind, data = frame.id >> 24, frame.data
        if not frame.extended or len(data) != 8 or frame.id >> 8 & 0xFF != self.id or frame.id & 0xFF != HOST:
            return None
        if kind == self.READ:
            return Parameter(int.from_bytes(data[:2], "little"), data[4:])
        if kind != self.FEEDBACK:
            return None
        bits, runs = frame.id >> 16 & 0x3F, frame.id >> 22 & 3 == self.RUNS
        faults = (fault for place, fault in enumerate(self.FAULTS) if bits >> place & 1)
        q, dq, tau, tenths = struct.unpack(">HHHH", data)
        state = next(faults, State.ENABLED if runs else State.DISABLED)
        return self._feedback(q, dq, tau, tenths / 10, float("nan"), state)

    def _mit(self, q: int, dq: int, tau: int, kp: int, kd: int) -> Frame:
        return Frame(self.COMMAND << 24 | tau << 8 | self.id, struct.pack(">HHHH", q, dq, kp, kd), True)

    def _frame(self, kind: int, data: bytes = bytes(8)) -> Frame:
        return Frame(kind << 24 | HOST << 8 | self.id, data, True)


CODECS: dict[str, type[Codec]] = {"damiao": Damiao, "robstride": RobStride}
