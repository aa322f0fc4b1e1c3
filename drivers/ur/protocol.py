"""What goes over a UR controller's ports: RTDE packets (30004), the registers by which ur-rtde's control script
is told what to do, and the lines of the dashboard (29999). Pure: no I/O, no clock.

RTDE is big-endian: ``u16 size | u8 kind | payload``, where size counts all bytes.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

DASHBOARD_PORT = 29999
PRIMARY_PORT, SECONDARY_PORT, REALTIME_PORT = 30001, 30002, 30003
"""Each takes URScript text; a program ends with an unindented ``end``."""
RTDE_PORT = 30004

RTDE_VERSION = 2

Value = float | int | tuple[float, ...] | tuple[int, ...]


class Kind(enum.IntEnum):
    VERSION = ord("V")
    CONTROLLER = ord("v")
    OUTPUTS = ord("O")
    INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")
    DATA = ord("U")
    TEXT = ord("M")


class Packet(NamedTuple):
    kind: int
    payload: bytes


class Garbled(Exception):
    """The stream has lost its framing: only a new connection helps."""


_HEADER = struct.Struct(">HB")


def frame(kind: int, payload: bytes = b"") -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class Decoder:
    """Bytes in any pieces, packets out."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Raise ``Garbled`` at a size that cannot be."""
        self._buffer += data
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if size < _HEADER.size:
                raise Garbled(f"an RTDE packet of {size} bytes")
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[_HEADER.size : size])
            del self._buffer[:size]
            yield Packet(kind, payload)


# -- recipes: which variables a data packet carries, in which order

TYPES = {
    "DOUBLE": "d",
    "UINT8": "B",
    "BOOL": "?",
    "UINT32": "I",
    "UINT64": "Q",
    "INT32": "i",
    "VECTOR3D": "3d",
    "VECTOR6D": "6d",
    "VECTOR6INT32": "6i",
}
NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

REGISTERS = 48
"""Of each sort. 0 to 23 belong to fieldbus and PLC, 24 to 47 to RTDE clients."""
UPPER_RANGE = 24


class Recipe:
    """An agreed list of variables."""

    def __init__(self, number: int, names: Sequence[str], types: Sequence[str]) -> None:
        self.number = number
        self.names = tuple(names)
        formats = [TYPES[name] for name in types]
        self._counts = tuple(int(text[:-1] or 1) for text in formats)
        self._struct = struct.Struct(">B" + "".join(formats))

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """A data packet."""
        flat: list[float] = []
        for name, count in zip(self.names, self._counts, strict=True):
            value = values[name]
            flat.extend(value if isinstance(value, tuple) else [value] * count)
        return frame(Kind.DATA, self._struct.pack(self.number, *flat))

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """Raise ``Garbled`` when the payload is not of this recipe."""
        if len(payload) != self._struct.size:
            raise Garbled(f"{len(payload)} bytes of data, the recipe has {self._struct.size}")
        flat = self._struct.unpack(payload)
        values: dict[str, Value] = {}
        at = 1
        for name, count in zip(self.names, self._counts, strict=True):
            values[name] = flat[at] if count == 1 else flat[at : at + count]
            at += count
        return values


def version_request() -> bytes:
    return frame(Kind.VERSION, struct.pack(">H", RTDE_VERSION))


def outputs_request(hz: float, names: Sequence[str]) -> bytes:
    return frame(Kind.OUTPUTS, struct.pack(">d", hz) + ",".join(names).encode())


def outputs_answer(payload: bytes, names: Sequence[str]) -> Recipe:
    """Raise ``Garbled`` naming what the controller does not have."""
    types = payload[1:].decode("ascii", "replace").split(",")
    if len(types) != len(names) or any(name not in TYPES for name in types):
        missing = [name for name, kind in zip(names, types, strict=False) if kind not in TYPES]
        raise Garbled(f"the controller has no {', '.join(missing) or 'such outputs'}")
    return Recipe(payload[0], names, types)


# -- modes


class RobotMode(enum.IntEnum):
    NO_CONTROLLER = -1
    DISCONNECTED = 0
    CONFIRM_SAFETY = 1
    BOOTING = 2
    POWER_OFF = 3
    POWER_ON = 4
    IDLE = 5
    BACKDRIVE = 6
    RUNNING = 7
    UPDATING_FIRMWARE = 8


class SafetyMode(enum.IntEnum):
    NORMAL = 1
    REDUCED = 2
    PROTECTIVE_STOP = 3
    RECOVERY = 4
    SAFEGUARD_STOP = 5
    SYSTEM_EMERGENCY_STOP = 6
    ROBOT_EMERGENCY_STOP = 7
    VIOLATION = 8
    FAULT = 9


class RuntimeState(enum.IntEnum):
    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


MOVABLE_SAFETY = (SafetyMode.NORMAL, SafetyMode.REDUCED)

STATUS_POWER_ON, STATUS_PROGRAM_RUNNING = 1, 2
"""Bits of ``robot_status_bits``."""

SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 0 | 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    SafetyMode.VIOLATION: 1 << 8 | 1 << 10,
    SafetyMode.FAULT: 1 << 9 | 1 << 10,
}
"""``safety_status_bits`` of each mode: bit 10 says that the arm is stopped for it."""


def robot_mode_name(number: int) -> str:
    return _name(RobotMode, number)


def safety_mode_name(number: int) -> str:
    return _name(SafetyMode, number)


def _name(modes: type[enum.IntEnum], number: int) -> str:
    try:
        return f"{modes(number).name} ({number})"
    except ValueError:
        return f"unknown ({number})"


# -- the control script of ur-rtde, told what to do by input registers


class Command(enum.IntEnum):
    """Numbers in its first integer register. The script's own first output register answers."""

    NONE = 0
    MOVE_J = 1
    SPEED_J = 9
    SERVO_J = 11
    SPEED_STOP = 15
    SERVO_STOP = 16
    SET_PAYLOAD = 17
    GET_STEP_TIME = 26
    STOP_L = 33
    STOP_J = 34
    PROTECTIVE_STOP = 31
    SET_WATCHDOG = 35
    IS_POSE_WITHIN_LIMITS = 36
    ARE_JOINTS_WITHIN_LIMITS = 37
    GET_JOINT_TORQUES = 38
    IS_STEADY = 47
    KICK_WATCHDOG = 99
    STOP_SCRIPT = 255


READY, DONE = 1, 2
"""What the script answers."""

AT_ONCE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58})
"""Real-time commands: answered READY without an execution."""

MOTION = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14})
"""Commands that move the arm; those this wire does not use by their neighbourhood [assumed]."""

STOPS = frozenset(
    {
        Command.SPEED_STOP,
        Command.SERVO_STOP,
        Command.STOP_L,
        Command.STOP_J,
        Command.PROTECTIVE_STOP,
        Command.STOP_SCRIPT,
    }
)


def classify_command(number: int) -> str:
    """The kind, in the wire log, of a data packet that carries a command register."""
    if number in MOTION:
        return "setpoint"
    if number in STOPS:
        return "safe"
    return "keepalive" if number in (Command.NONE, Command.KICK_WATCHDOG) else "config"


# -- scripts and dashboard lines

STOP_DECELERATION_RAD_S2 = 4.0
STOP_SCRIPT = f"stopj({STOP_DECELERATION_RAD_S2})\n".encode()
"""Sent to a script port it replaces whatever program runs."""

DASHBOARD_STOP = "stop"
DASHBOARD_STOPPED = "Stopped"

_STOP_LINES = frozenset({"stop", "pause", "power off", "shutdown"})
_ENABLE_LINES = frozenset(
    {"play", "power on", "brake release", "unlock protective stop", "restart safety", "close safety popup"}
)


def classify_dashboard(line: str) -> str:
    """The kind of a dashboard line in the wire log."""
    words = line.strip().lower()
    if words in _STOP_LINES:
        return "safe"
    return "enable" if words in _ENABLE_LINES else "read"


def classify_script(text: bytes) -> str:
    """A program that only stops is a safe frame; any other gets the power to move the arm."""
    words = text.strip()
    return "safe" if words.startswith((b"stopj(", b"stopl(")) and b"\n" not in words else "enable"
