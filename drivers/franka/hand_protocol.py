"""Encode and decode the messages of the Franka Hand, which has a service at a separate TCP port.

Requests and replies use TCP, states UDP. A request is answered when it has ended, so the reply to a motion comes
when the fingers stand. Pure: bytes in, values out. Everything is little-endian and packed. Widths are the distance
of the fingers in metres. Source: the published headers of libfranka-common (``research_interface/gripper``), and
libfranka 0.21 for version 3, which adds the status ABORTED.
"""

from __future__ import annotations

import enum
import struct
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

from .protocol import Message

PORT = 1338
VERSION = 3
HEADER = struct.Struct("<HII")
"""Command, number of the request, and size of the message with this header."""
LARGEST_MESSAGE = 256

WIDEST_M = 1.0
"""Wider than any hand. Custom fingers change the width that a hand reports."""


class Command(enum.IntEnum):
    CONNECT = 0
    HOMING = 1
    GRASP = 2
    MOVE = 3
    STOP = 4


class Status(enum.IntEnum):
    SUCCESS = 0
    FAIL = 1  # It was not carried out.
    UNSUCCESSFUL = 2  # It was carried out, and the fingers are not where they should be.
    ABORTED = 3  # A stop has ended it.


class ConnectStatus(enum.IntEnum):
    SUCCESS = 0
    INCOMPATIBLE = 1


CONNECT = struct.Struct("<HH")
MOVE = struct.Struct("<2d")
GRASP = struct.Struct("<5d")
_STATE = struct.Struct("<I2d?H")
STATE_BYTES = _STATE.size


class HandState(NamedTuple):
    """A state of the hand.

    Attributes:
        message_id: The hand's time in milliseconds.
        width_m: Distance of the fingers.
        most_m: Largest distance, from the last homing; 0 before the first one.
        is_grasped: True if the last grasp has caught something, and still holds it.
        temperature_c: Temperature of the hand.
    """

    message_id: int
    width_m: float
    most_m: float
    is_grasped: bool
    temperature_c: int

    def pack(self) -> bytes:
        return _STATE.pack(*self)


def state(data: bytes) -> HandState:
    """Decode a state. Raise ``MalformedFrame`` if it is invalid."""
    if len(data) != STATE_BYTES:
        raise MalformedFrame(f"a state of {len(data)} bytes; the hand's has {STATE_BYTES}")
    decoded = HandState(*_STATE.unpack(data))
    # A comparison with NaN is false.
    if not all(-WIDEST_M < width < WIDEST_M for width in (decoded.width_m, decoded.most_m)):
        raise MalformedFrame("a state with a width that no hand has")
    return decoded


# -- requests and replies


def frame(command: int, number: int, payload: bytes = b"") -> bytes:
    """Encode a request, or the reply to it, which repeats its command and number."""
    return HEADER.pack(command, number, HEADER.size + len(payload)) + payload


def connect_payload(udp_port: int) -> bytes:
    return CONNECT.pack(VERSION, udp_port)


def move_payload(width_m: float, speed_m_s: float) -> bytes:
    return MOVE.pack(width_m, speed_m_s)


def grasp_payload(width_m: float, inner_m: float, outer_m: float, speed_m_s: float, force_n: float) -> bytes:
    """Encode a grasp. It succeeds if the fingers then are at most ``inner_m`` narrower than ``width_m``, and at
    most ``outer_m`` wider."""
    return GRASP.pack(width_m, inner_m, outer_m, speed_m_s, force_n)


def status_of(reply: Message) -> int:
    """Return the status of a reply. Raise ``MalformedFrame`` if the reply is too short."""
    if len(reply.payload) < 2:
        raise MalformedFrame("a reply of the hand without a status")
    return int.from_bytes(reply.payload[:2], "little")


def status_name(status: int) -> str:
    return Status(status).name.lower() if status in tuple(Status) else f"status {status}"
