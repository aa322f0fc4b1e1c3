"""Encode and decode commands of an RB-Y1 and the robot's feedback to them. Pure: no I/O.

    RobotCommand > ComponentBasedCommand > body: BodyComponentBasedCommand > torso, right arm, left arm
                                         > head

Each part is a ``JointPositionCommand``: the positions, the time in which to reach them, and how
long the controller holds them after that. For the field numbers see ``protocol``.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator, Mapping, Sequence

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

    @classmethod
    def decode(cls, data: bytes) -> JointPosition:
        """Decode the request. Raise ``MalformedFrame``, also for numbers that are not finite."""
        fields = pb.message(data)
        position = pb.doubles(data, 3)
        if not all(map(math.isfinite, position)):
            raise MalformedFrame(f"rb.api: joints at {position}")
        hold_s = decode_duration(pb.last_bytes(pb.message(pb.last_bytes(fields, 1)), 1))
        return cls(position, decode_duration(pb.last_bytes(fields, 2)), hold_s)


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


class Command(msgspec.Struct, frozen=True):
    """The fields of a ``RobotCommandRequest`` that the simulated robot uses."""

    parts: dict[str, JointPosition]
    priority: int = 0
    stops: bool = False  # True for a ``StopCommand`` to the whole body
    has_others: bool = False  # True if it also has a command of another kind, such as a Cartesian pose

    @classmethod
    def decode(cls, data: bytes) -> Command:
        """Decode joint positions of torso, arms and head, given by part or for the body as a whole. Raise
        ``MalformedFrame``."""
        fields = pb.message(data)
        request = pb.message(pb.last_bytes(fields, 2))
        components = pb.message(pb.last_bytes(request, 3))
        parts = dict(_parts(components))
        for name, part in parts.items():
            if len(part.position) != PARTS[name]:
                raise MalformedFrame(f"rb.api: {len(part.position)} positions for {name}, which has {PARTS[name]}")
        whole = pb.message(pb.last_bytes(request, 2))
        return cls(parts, pb.last_int(fields, 3), 2 in whole, _has_others(request, components))


def _has_others(request: dict[int, list[pb.Value]], components: dict[int, list[pb.Value]]) -> bool:
    """Return True if a request has a field for a command that ``Command`` does not decode. Field 1 is a header."""
    body = pb.message(pb.last_bytes(components, 3))
    by_part = pb.message(pb.last_bytes(body, 6))
    parts = [pb.message(pb.last_bytes(by_part, number)) for number in _BODY.values()]
    head = pb.message(pb.last_bytes(components, 4))
    whole = pb.message(pb.last_bytes(request, 2))
    decoded: list[tuple[Mapping[int, object], set[int]]] = [
        (request, {1, 2, 3}),
        (whole, {1, 2}),
        (components, {1, 3, 4}),
        (body, {1, 2, 6}),
        (by_part, {1, *_BODY.values()}),
        *((part, {1, 2}) for part in (*parts, head)),
    ]
    return any(set(fields) - numbers for fields, numbers in decoded)


def _parts(components: dict[int, list[pb.Value]]) -> Iterator[tuple[str, JointPosition]]:
    body = pb.message(pb.last_bytes(components, 3))
    if 2 in body:
        yield from _whole_body(JointPosition.decode(pb.last_bytes(body, 2)))
    by_part = pb.message(pb.last_bytes(body, 6))
    for name, number in _BODY.items():
        command = pb.message(pb.last_bytes(by_part, number))
        if 2 in command:
            yield name, JointPosition.decode(pb.last_bytes(command, 2))
    head = pb.message(pb.last_bytes(components, 4))
    if 2 in head:
        yield "head", JointPosition.decode(pb.last_bytes(head, 2))


def _whole_body(body: JointPosition) -> Iterator[tuple[str, JointPosition]]:
    """Split a body of twenty joints into torso, right arm and left arm."""
    start = 0
    for name in ("torso", "right_arm", "left_arm"):
        yield name, msgspec.structs.replace(body, position=body.position[start : start + PARTS[name]])
        start += PARTS[name]
    if len(body.position) != start:
        raise MalformedFrame(f"rb.api: {len(body.position)} positions for a body of {start}")


_BODY = {"right_arm": 2, "left_arm": 3, "torso": 4}
"""Fields of ``BodyComponentBasedCommand``."""


class Feedback(msgspec.Struct, frozen=True):
    """The fields of a ``RobotCommandResponse`` that this driver uses."""

    status: int = Status.IDLE
    finish: int = Finish.UNKNOWN

    def encode(self) -> bytes:
        return pb.bytes_field(2, pb.varint_field(10, self.status) + pb.varint_field(11, self.finish))

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
