"""Encode the commands of this driver, and decode the robot's feedback to them. Pure: no I/O.

    RobotCommand > ComponentBasedCommand > body: BodyComponentBasedCommand > torso, right arm, left arm
                                         > head

Each part is a ``JointPositionCommand``: the positions, the time in which to reach them, and how
long the controller holds them after that. For the field numbers see ``protocol``.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping, Sequence

import msgspec

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

NS = 1_000_000_000

PARTS = {"torso": 6, "right_arm": 7, "left_arm": 7, "head": 2}
"""The driven parts and their numbers of joints."""


class Status(enum.IntEnum):
    """Progress of a command, as the robot reports it."""

    IDLE = 0
    INITIALIZING = 1
    RUNNING = 2
    FINISHED = 3


class Finish(enum.IntEnum):
    """Reason why a command has ended."""

    UNKNOWN = 0
    OK = 1
    CANCELED = 2
    PREEMPTED = 3
    INITIALIZED_FAILED = 4
    CONTROL_MANAGER_IDLE = 5
    CONTROL_MANAGER_FAULT = 6
    UNEXPECTED_STATE = 7


class JointPosition(msgspec.Struct, frozen=True):
    """``JointPositionCommand.Request``."""

    position: tuple[float, ...]
    minimum_s: float = 0.0
    hold_s: float = 0.0

    def encode(self) -> bytes:
        header = pb.bytes_field(1, encode_duration(self.hold_s))
        return (
            pb.bytes_field(1, header)
            + pb.bytes_field(2, encode_duration(self.minimum_s))
            + pb.double_fields(3, self.position, packed=True)
        )


def encode_command(parts: Mapping[str, JointPosition], priority: int) -> bytes:
    """Encode ``RobotCommandRequest`` for the given parts."""
    encoded = {name: pb.bytes_field(2, part.encode()) for name, part in parts.items()}
    body = b"".join(pb.bytes_field(number, encoded[name]) for name, number in _BODY.items() if name in encoded)
    components = b""
    if body:
        components += pb.bytes_field(3, pb.bytes_field(6, body))
    if "head" in encoded:
        components += pb.bytes_field(4, encoded["head"])
    return pb.bytes_field(2, pb.bytes_field(3, components)) + pb.varint_field(3, priority)


_BODY = {"right_arm": 2, "left_arm": 3, "torso": 4}
"""Fields of ``BodyComponentBasedCommand``."""


class Feedback(msgspec.Struct, frozen=True):
    """The fields of a ``RobotCommandResponse`` that this driver uses."""

    status: int = Status.IDLE
    finish: int = Finish.UNKNOWN

    def encode(self, parts: bytes = b"") -> bytes:
        """Encode the response.

        Args:
            parts: Encoded feedback of the single parts of the command.
        """
        return pb.bytes_field(2, parts + pb.varint_field(10, self.status) + pb.varint_field(11, self.finish))

    @classmethod
    def decode(cls, data: bytes) -> Feedback:
        """Raise ``MalformedFrame``."""
        fields = pb.message(pb.last_bytes(pb.message(data), 2))
        return cls(pb.last_int(fields, 10), pb.last_int(fields, 11))

    @property
    def dropped(self) -> str:
        """Why the robot has dropped the command; empty if it still carries it out."""
        if self.status != Status.FINISHED or self.finish == Finish.OK:
            return ""
        return Finish(self.finish).name if self.finish in tuple(Finish) else f"finish code {self.finish}"


def split(values: Sequence[float]) -> dict[str, tuple[float, ...]]:
    """Split the values of all driven joints into the values of each body part. The parts are in the
    order of ``PARTS``."""
    rows, start = {}, 0
    for name, count in PARTS.items():
        rows[name] = tuple(values[start : start + count])
        start += count
    return rows


def encode_duration(seconds: float) -> bytes:
    """Encode a ``Duration``. It must not be negative."""
    whole, nanos = divmod(round(seconds * NS), NS)
    return pb.varint_field(1, whole) + pb.varint_field(2, nanos)


def decode_duration(data: bytes) -> float:
    """Decode a ``Duration`` to seconds. Raise ``MalformedFrame``, also for a negative duration."""
    fields = pb.message(data)
    whole, nanos = pb.last_int(fields, 1), pb.last_int(fields, 2)
    if whole >> 63 or nanos >= NS:
        raise MalformedFrame("rb.api: a negative time")
    return whole + nanos / NS
