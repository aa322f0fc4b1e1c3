"""Encode and decode what is sent to a UR controller without an SDK. Pure: no I/O, no clock.

These are RTDE packets (port 30004), and the lines and scripts that stop a program.

RTDE is big-endian: ``u16 size | u8 kind | payload``, where size counts all bytes.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

DASHBOARD_PORT = 29999
PRIMARY_PORT, SECONDARY_PORT, REALTIME_PORT = 30001, 30002, 30003
"""Each of these ports takes URScript text. A program ends with an unindented ``end``."""
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


_HEADER = struct.Struct(">HB")


def frame(kind: int, payload: bytes = b"") -> bytes:
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class Decoder:
    """Decode a stream of bytes, in pieces of any size, into RTDE packets."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Yield the complete packets. Raise ``MalformedFrame`` for an impossible size."""
        self._buffer += data
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if size < _HEADER.size:
                raise MalformedFrame(f"an RTDE packet of {size} bytes")
            if len(self._buffer) < size:
                return
            payload = bytes(self._buffer[_HEADER.size : size])
            del self._buffer[:size]
            yield Packet(kind, payload)


# -- recipes: the variables of a data packet and their order

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


class Recipe:
    """The list of variables in one kind of data packet, as client and controller have agreed on it."""

    def __init__(self, number: int, names: Sequence[str], types: Sequence[str]) -> None:
        self.number = number
        self.names = tuple(names)
        formats = [TYPES[name] for name in types]
        self._counts = tuple(int(text[:-1] or 1) for text in formats)
        self._struct = struct.Struct(">B" + "".join(formats))

    def pack(self, values: Mapping[str, Value]) -> bytes:
        """Encode values, by name of the variable, as a data packet."""
        rows = ((values[name], count) for name, count in zip(self.names, self._counts, strict=True))
        flat = [part for value, count in rows for part in (value if isinstance(value, tuple) else (value,) * count)]
        return frame(Kind.DATA, self._struct.pack(self.number, *flat))

    def unpack(self, payload: bytes) -> dict[str, Value]:
        """Decode the payload of a data packet. Raise ``MalformedFrame`` if it does not fit this recipe."""
        if len(payload) != self._struct.size:
            raise MalformedFrame(f"{len(payload)} bytes of data, the recipe has {self._struct.size}")
        number, *values = self._struct.unpack(payload)
        if number != self.number:
            raise MalformedFrame(f"data of recipe {number}, {self.number} was agreed")
        flat = iter(values)
        rows = zip(self.names, self._counts, strict=True)
        return {name: next(flat) if count == 1 else tuple(islice(flat, count)) for name, count in rows}


def version_request() -> bytes:
    return frame(Kind.VERSION, struct.pack(">H", RTDE_VERSION))


def outputs_request(hz: float, names: Sequence[str]) -> bytes:
    return frame(Kind.OUTPUTS, struct.pack(">d", hz) + ",".join(names).encode())


def outputs_answer(payload: bytes, names: Sequence[str]) -> Recipe:
    """Decode the answer to a request for outputs: return their recipe.

    Raise ``MalformedFrame``, with the names, if the controller does not have some of the outputs.
    """
    types = payload[1:].decode("ascii", "replace").split(",")
    if len(types) != len(names) or any(name not in TYPES for name in types):
        missing = [name for name, type_name in zip(names, types, strict=False) if type_name not in TYPES]
        raise MalformedFrame(f"the controller has no {', '.join(missing) or 'such outputs'}")
    return Recipe(payload[0], names, types)


def inputs_request(names: Sequence[str]) -> bytes:
    return frame(Kind.INPUTS, ",".join(names).encode())


def inputs_answer(payload: bytes, names: Sequence[str]) -> Recipe:
    """Decode the answer to a request to write inputs: return their recipe.

    Raises:
        MalformedFrame: The controller has no such input, or another client already writes it. The text names the
            inputs.
    """
    types = payload[1:].decode("ascii", "replace").split(",")
    if len(types) != len(names) or any(name not in TYPES for name in types):
        refused = [
            f"{name} ({type_name})" for name, type_name in zip(names, types, strict=False) if type_name not in TYPES
        ]
        raise MalformedFrame(f"the controller refuses to have us write {', '.join(refused) or 'these inputs'}")
    return Recipe(payload[0], names, types)


# -- modes of a controller


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


def mode_name(modes: type[enum.IntEnum], number: int) -> str:
    """Return the name and the number of a mode for messages, such as ``RUNNING (7)``."""
    return f"{modes(number).name if number in list(modes) else 'unknown'} ({number})"


# -- scripts and dashboard lines

STOP_DECELERATION_RAD_S2 = 4.0
STOP_SCRIPT = f"stopj({STOP_DECELERATION_RAD_S2})\n".encode()
"""A script that stops the arm. Sent to a script port it replaces any running program."""

DASHBOARD_STOP = "stop"
DASHBOARD_STOPPED = "Stopped"
