"""Encode and decode requests and replies on an xArm controller's control port, 502.

Pure: no I/O, no clock.

    request  u16 number | u16 protocol | u16 length | u8 register | data
    reply    u16 number | u16 protocol | u16 length | u8 register | u8 state | data

Headers and integers are big-endian, floats little-endian. ``length`` counts from the register on. A TCP
stream has no start marks, so after an impossible header only a new connection helps. The source is the
traffic of the vendor's Python SDK 1.18.4. Facts that were never seen on a controller are marked
[assumed].
"""

from __future__ import annotations

import enum
import math
import re
import struct
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

CONTROL_PORT = 502

JOINTS = 7


class Register(enum.IntEnum):
    VERSION = 1
    SERIAL = 2
    MOTION_ENABLE = 11
    SET_STATE = 12
    GET_STATE = 13
    QUEUE = 14
    ERRORS = 15
    CLEAR_ERROR = 16
    CLEAR_WARNING = 17
    SET_MODE = 19
    MOVE_LINE = 21
    MOVE_LINE_ROUNDED = 22
    MOVE_JOINT = 23
    MOVE_JOINT_ROUNDED = 24
    MOVE_HOME = 25
    PAUSE = 26
    MOVE_CIRCLE = 27
    MOVE_LINE_TOOL = 28
    SERVO_JOINT = 29
    SERVO_POSE = 30
    TCP_POSE = 41
    JOINT_STATES = 42
    JOINT_TORQUE = 55
    JOINT_VELOCITY = 81
    POSE_VELOCITY = 82
    MOVE_RELATIVE = 83
    MOVE_LINE_AXIS_ANGLE = 92
    TOOL_RS485 = 124
    TOOL_WRITE_16 = 127
    TOOL_READ_16 = 128
    SERVO_POSE_AXIS_ANGLE = 93


MOTIONS = frozenset(
    (
        *range(Register.MOVE_LINE, Register.SERVO_POSE + 1),
        *range(Register.JOINT_VELOCITY, Register.MOVE_RELATIVE + 1),
        Register.MOVE_LINE_AXIS_ANGLE,
        Register.SERVO_POSE_AXIS_ANGLE,
    )
)
"""Registers whose requests move the arm."""


class State(enum.IntEnum):
    """State of the arm. ``SET_STATE`` accepts 0, 3 and 4. The controller reports the other states, too."""

    GO = 0
    MOVING = 1
    READY = 2
    PAUSED = 3
    STOPPED = 4


class Mode(enum.IntEnum):
    POSITION = 0
    SERVO = 1
    TEACH = 2
    VELOCITY = 4
    POSE_VELOCITY = 5
    JOINT_ONLINE = 6
    POSE_ONLINE = 7


ALL_JOINTS = 8
"""Selects all joints in ``MOTION_ENABLE``."""

ERROR, WARNING, NOT_READY, INVALID = 0x40, 0x20, 0x10, 0x08
"""Bits of the state byte in a reply."""

ERRORS = {
    1: "emergency stop button",
    2: "emergency stop input",
    3: "emergency stop of the three-state switch",
    10: "servo motors",
    **{10 + joint: f"servo motor {joint}" for joint in range(1, JOINTS + 1)},
    18: "force torque sensor",
    19: "end effector",
    21: "kinematics",
    22: "self-collision",
    23: "joint angle past its limit",
    24: "speed exceeds limit",
    25: "planning",
    26: "real-time system of the controller",
    27: "command reply",
    28: "end module",
    30: "feedback speed exceeds limit",
    31: "collision",
    33: "controller inputs",
    35: "safety boundary",
    36: "too many delayed commands",
    37: "abnormal motion in manual mode",
    38: "abnormal joint angle",
    39: "power board",
    40: "joint trajectory",
    60: "linear speed exceeds limit in servo mode",
}
"""Error codes of the controller, from the vendor's SDK."""


def error_words(code: int) -> str:
    return f"{code} ({ERRORS.get(code, 'unknown')})"


# -- requests and replies


class Frame(NamedTuple):
    """One frame, of a request or a reply. ``body`` is register and data; in a reply the state byte lies between
    these two."""

    number: int
    protocol: int
    body: bytes


class Reply(NamedTuple):
    number: int
    register: int
    state: int
    data: bytes


PROTOCOL = 2
"""Protocol version of every request. The SDK changes to 3 if the firmware is 1.8.6 or newer. Version 2 is the one
that the SDK sends first to every firmware."""
HEARTBEAT_PROTOCOL = 1
STANDARD_MODBUS = 0
"""Protocol of standard Modbus at the same port, which only a controller accepts."""
PROTOCOLS = (HEARTBEAT_PROTOCOL, PROTOCOL, 3)

LAST_NUMBER = 0xFFFF
LONGEST = 1024
"""Largest size of a frame's body, in bytes. The longest known body has 320."""

_HEADER = struct.Struct(">HHH")


class Decoder:
    """Decode a stream of bytes, in pieces of any size, into frames."""

    def __init__(self, protocols: Collection[int] = PROTOCOLS) -> None:
        self._protocols = protocols
        self._pending = bytearray()

    def feed(self, data: bytes) -> Iterator[Frame]:
        """Yield the complete frames. Raise ``MalformedFrame`` at an impossible header."""
        self._pending += data
        while len(self._pending) >= _HEADER.size:
            number, protocol, length = _HEADER.unpack_from(self._pending)
            if protocol not in self._protocols or not 1 <= length <= LONGEST:
                raise MalformedFrame(f"protocol {protocol}, length {length}")
            end = _HEADER.size + length
            if len(self._pending) < end:
                return
            body = bytes(self._pending[_HEADER.size : end])
            del self._pending[:end]
            yield Frame(number, protocol, body)


def frame(number: int, body: bytes, protocol: int = PROTOCOL) -> bytes:
    return _HEADER.pack(number, protocol, len(body)) + body


def request(number: int, register: int, data: bytes = b"") -> bytes:
    return frame(number, bytes((register,)) + data)


def reply_of(received: Frame) -> Reply:
    """Return a frame as a reply. Raise ``MalformedFrame`` if it is too short or a heartbeat."""
    if len(received.body) < 2 or received.protocol == HEARTBEAT_PROTOCOL:
        raise MalformedFrame(f"a reply of {len(received.body)} bytes, protocol {received.protocol}")
    return Reply(received.number, received.body[0], received.body[1], received.body[2:])


def floats(values: Sequence[float]) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


def unpack_floats(data: bytes, count: int, offset: int = 0) -> tuple[float, ...]:
    """Return ``count`` floats that begin at byte ``offset``. Raise ``MalformedFrame`` if ``data`` is too short."""
    if len(data) < offset + 4 * count:
        raise MalformedFrame(f"{len(data)} bytes hold no {count} floats from {offset} on")
    return struct.unpack_from(f"<{count}f", data, offset)


SETPOINT_SPEED_RAD_S, SETPOINT_ACC_RAD_S2 = math.pi, 20.0
"""Values of a setpoint in fields that the controller does not use. A hold has 0 there. So the log of sent frames
can tell a hold from a setpoint. Both values would also be valid for a firmware that uses the fields."""


def servo_data(target_rad: Sequence[float], *, hold: bool = False) -> bytes:
    """Return the data of a ``SERVO_JOINT`` request. ``hold`` marks it as a hold in the log of sent frames."""
    speed, acc = (0.0, 0.0) if hold else (SETPOINT_SPEED_RAD_S, SETPOINT_ACC_RAD_S2)
    return floats((*target_rad, speed, acc, 0.0))


def errors_of(data: bytes) -> tuple[int, int]:
    """Return the codes of error and warning. Raise ``MalformedFrame`` if ``data`` is too short."""
    if len(data) < 2:
        raise MalformedFrame(f"{len(data)} bytes of error codes")
    return data[0], data[1]


def classify(body: bytes) -> tuple[str, str | None]:
    """Return the kind of a request for the log of sent frames, and the safe state that this request alone gives the
    arm. The safe state is None if the request gives none."""
    register, data = body[0], body[1:]
    match register:
        case Register.SET_STATE if data[:1] == bytes((State.STOPPED,)):
            return "safe", "stop"
        case Register.SET_STATE if data[:1] == bytes((State.PAUSED,)):
            return "config", None
        case Register.MOTION_ENABLE if data[1:2] == b"\0":
            return "config", None
        case Register.MOTION_ENABLE | Register.SET_STATE | Register.SET_MODE:
            return "enable", None
        case Register.SERVO_JOINT if len(data) >= 4 * JOINTS + 4 and unpack_floats(data, 1, 4 * JOINTS) == (0.0,):
            return "safe", "hold"
        case _ if register in MOTIONS:
            return "setpoint", None
        case Register.CLEAR_ERROR | Register.CLEAR_WARNING:
            return "config", None
        case Register.TOOL_RS485 | Register.TOOL_WRITE_16:
            return classify_tool(body), None
    return "read" if register in tuple(Register) else "other", None


# -- the tool's board and the gripper on the tool's bus

TOOL_BOARD, GRIPPER_ID = 9, 8
"""Numbers of the tool's board and of the gripper on the tool's bus."""

READ_REGISTERS, WRITE_REGISTERS = 3, 16
"""Functions of Modbus."""


class GripperRegister(enum.IntEnum):
    """Registers of the gripper. A position has 32 bits, every other one 16."""

    STATUS = 0x0000
    ERROR = 0x000F
    ENABLE = 0x0100
    MODE = 0x0101
    SPEED = 0x0303
    TARGET = 0x0700
    POSITION = 0x0702


class GripperStatus(enum.IntEnum):
    """The lowest two bits of the gripper's status."""

    AT_REST = 0
    MOVES = 1
    GRASPED = 2


class ToolRegister(enum.IntEnum):
    """Registers of the tool's board. The first output switches the vacuum on, the second one blows it off."""

    DIGITAL_INPUTS = 0x0A14
    SET_DIGITAL = 0x0A15
    DIGITAL_OUTPUTS = 0x0A18


_WIDE = (GripperRegister.TARGET, GripperRegister.POSITION)

GRIPPER_ERRORS = {
    9: "current detection",
    11: "overload: over-current",
    12: "overload: over-speed",
    14: "position command past its limit",
    15: "memory",
    20: "driver",
    21: "driver initialisation",
    23: "large position deviation",
    25: "command past its limit",
    26: "feedback position past its limit",
    33: "drive overload",
    34: "motor overload",
    36: "driver type",
}
"""Error codes of the gripper, from the vendor's SDK and manual."""


def read_gripper(register: GripperRegister) -> bytes:
    """Return the data of a ``TOOL_RS485`` request that reads a register of the gripper."""
    count = 2 if register in _WIDE else 1
    return struct.pack(">BBBHH", TOOL_BOARD, GRIPPER_ID, READ_REGISTERS, register, count)


def write_gripper(register: GripperRegister, value: int) -> bytes:
    """Return the data of a ``TOOL_RS485`` request that writes a register of the gripper."""
    head = struct.pack(">BBBH", TOOL_BOARD, GRIPPER_ID, WRITE_REGISTERS, register)
    if register in _WIDE:
        return head + struct.pack(">HBi", 2, 4, value)
    return head + struct.pack(">HBH", 1, 2, value)


def gripper_value(data: bytes) -> int | None:
    """Return the value in the answer to ``read_gripper``; None if the gripper has refused it or it is malformed."""
    if len(data) in (6, 8) and data[2] == READ_REGISTERS and data[3] == len(data) - 4:
        return int.from_bytes(data[4:], "big", signed=True)
    return None


def is_written(data: bytes) -> bool:
    """Return True if this answer to ``write_gripper`` confirms it."""
    return len(data) >= 3 and data[2] == WRITE_REGISTERS


def setpoint_pulses(pulses: float) -> int:
    """Return the target of a setpoint. Setpoints are even and stops odd, so that the log of sent frames can tell a
    stop from a setpoint."""
    return 2 * round(pulses / 2)


def stop_pulses(pulses: int) -> int:
    """Return the target that stops moving fingers where they are: their position, as an odd number."""
    return pulses | 1


def vacuum(on: bool) -> bytes:
    """Return the data of a ``TOOL_WRITE_16`` request that switches the vacuum on or off, at once."""
    word = 0x0301 if on else 0x0302
    return struct.pack(">BH", TOOL_BOARD, ToolRegister.SET_DIGITAL) + floats((float(word),)) + b"\0"


def read_tool(register: ToolRegister) -> bytes:
    """Return the data of a ``TOOL_READ_16`` request to the tool's board."""
    return struct.pack(">BH", TOOL_BOARD, register)


def classify_tool(body: bytes) -> str:
    """Return the kind of a request to the tool for the log of sent frames."""
    register, data = body[0], body[1:]
    if register == Register.TOOL_WRITE_16:
        return "setpoint" if data[:3] == vacuum(True)[:3] else "config"
    if len(data) < 5 or data[1] != GRIPPER_ID or data[2] != WRITE_REGISTERS:
        return "read"
    match int.from_bytes(data[3:5], "big"):
        case GripperRegister.TARGET:
            return "safe" if data[-1] & 1 else "setpoint"
        case GripperRegister.ENABLE:
            return "enable"
    return "config"


# -- the version text of a controller


class Version(NamedTuple):
    axes: int
    arm_type: int
    serial: str  # serial number of the arm
    firmware: tuple[int, int, int]

    @property
    def text(self) -> str:
        return ".".join(map(str, self.firmware))


_VERSION = re.compile(r"(\d),(\d+),([^,]*),([^,]*),\D*(\d+)\.(\d+)\.(\d+)")

TEXT_SIZE = 40


def parse_version(data: bytes) -> Version:
    """Decode a version text: ``7,7,XF1300012345,AC1300012345,v1.12.10``.

    The parts are the number of axes, the arm's type, the serial numbers of arm and control box, and the firmware.
    Raise ``MalformedFrame`` for any other text. Firmware before 1.0 sends a shorter text [assumed].
    """
    text = data.partition(b"\0")[0].decode("ascii", "replace")
    parts = _VERSION.match(text)
    if parts is None:
        raise MalformedFrame(f"version {text!r} names no type and firmware")
    axes, arm_type, serial, _, *firmware = parts.groups()
    major, minor, revision = (int(part) for part in firmware)
    return Version(int(axes), int(arm_type), serial.strip(), (major, minor, revision))
