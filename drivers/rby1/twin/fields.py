"""Decode single fields of a command. Every number must be finite. Each function raises ``MalformedFrame``."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame
from strands_actors.drivers.common.physics.poses import Matrix, Pose
from strands_actors.drivers.rby1.commands import decode_duration
from strands_actors.drivers.rby1.protocol import double, messages, text

from .links import matrix_of
from .parts import Aim, Spring

T = TypeVar("T")
Fields = dict[int, list[pb.Value]]


def row(data: bytes, number: int) -> tuple[float, ...]:
    """Decode a list of numbers."""
    values = pb.doubles(data, number)
    if not all(map(math.isfinite, values)):
        raise MalformedFrame(f"rb.api: joints at {values}")
    return values


def row_of(data: bytes, number: int, count: int) -> tuple[float, ...]:
    """Decode a list that has one positive value for each joint, or none at all."""
    values = row(data, number)
    if len(values) not in (0, count) or any(value < 0.0 for value in values):
        raise MalformedFrame(f"rb.api: {values} for {count} joints")
    return values


def finite(value: float) -> float:
    if not math.isfinite(value):
        raise MalformedFrame(f"rb.api: {value}")
    return value


def positive(values: tuple[float, ...]) -> tuple[float, ...]:
    if any(value < 0.0 for value in values):
        raise MalformedFrame(f"rb.api: a stiffness of {values}")
    return values


def checked(spring: Spring) -> Spring:
    if spring.damping < 0.0:
        raise MalformedFrame(f"rb.api: a damping ratio of {spring.damping}")
    return spring


def optional(fields: Fields, number: int, missing: T) -> float | T:
    """Decode a ``DoubleValue``."""
    return finite(double(pb.message(pb.last_bytes(fields, number)), 1)) if number in fields else missing


def name(fields: Fields, number: int) -> str:
    return text(pb.last_bytes(fields, number))


def vector(fields: Fields, number: int) -> tuple[float, float, float]:
    entry = pb.message(pb.last_bytes(fields, number))
    return finite(double(entry, 1)), finite(double(entry, 2)), finite(double(entry, 3))


def velocity(fields: Fields) -> tuple[float, float]:
    """Decode an ``SE2Velocity``: forwards in m/s, to the left in rad/s. A model A has no way to move sideways, and
    ignores such a speed."""
    linear = pb.message(pb.last_bytes(fields, 1))
    return finite(double(linear, 1)), finite(double(fields, 2))


def aims(fields: Fields, number: int) -> tuple[Aim, ...]:
    return tuple(
        Aim(name(entry, 1), finite(double(entry, 2)), optional(entry, 3, math.inf))
        for entry in messages(fields, number)
    )


def stop_errors(fields: Fields, first: int) -> tuple[float | None, float | None, float | None]:
    return (
        optional(fields, first, None),
        optional(fields, first + 1, None),
        optional(fields, first + 2, None),
    )


def pose(fields: Fields, number: int) -> Pose:
    """Decode an ``SE3Pose``. Without a rotation it is the identity."""
    entry = pb.message(pb.last_bytes(fields, number))
    position = np.array(vector(entry, 1))
    if 3 in entry:
        z, y, x = vector(entry, 3)
        return Pose(position, turn(2, z) @ turn(1, y) @ turn(0, x))
    if 2 not in entry:
        return Pose(position, np.eye(3))
    quaternion = pb.message(pb.last_bytes(entry, 2))
    x, y, z, w = (finite(double(quaternion, field)) for field in (1, 2, 3, 4))
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if length < 1e-6:
        raise MalformedFrame("rb.api: a quaternion of zero")
    return Pose(position, matrix_of(w / length, x / length, y / length, z / length))


def turn(axis: int, rad: float) -> Matrix:
    """Return the rotation about one axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[first, first] = matrix[second, second] = math.cos(rad)
    matrix[second, first] = math.sin(rad)
    matrix[first, second] = -math.sin(rad)
    return matrix


def hold_s(fields: Fields) -> float:
    """Decode the hold time in the header of a command, in seconds."""
    return decode_duration(pb.last_bytes(pb.message(pb.last_bytes(fields, 1)), 1))


def minimum_s(fields: Fields, number: int) -> float:
    return decode_duration(pb.last_bytes(fields, number))
