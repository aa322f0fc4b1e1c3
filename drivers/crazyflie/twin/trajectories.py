"""Compute where a flight of the high-level commander has to be at a time. Pure: no I/O, no clock.

A flight consists of pieces. A piece has a duration and four polynomials of degree 7, for x, y, z and yaw. Planned
flights (takeoff, landing, going to a place, a spiral) have one piece. Uploaded trajectories have many.

Sources: the firmware's page ``trajectory_formats``, and the description of its planner.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from strands_actors.drivers.common.codecs.malformed import MalformedFrame

Vector = tuple[float, float, float]
Coefficients = tuple[float, ...]

COEFFICIENTS = 8
PIECE = struct.Struct(f"<{4 * COEFFICIENTS + 1}f")
"""An uncompressed piece: the coefficients of x, y, z and yaw, constant terms first, and the duration."""
AT_REST: Vector = (0.0, 0.0, 0.0)


class Moment(NamedTuple):
    """Where a flight has to be at one time, in the frame of the world."""

    xyz_m: Vector
    yaw_rad: float
    velocity_m_s: Vector = AT_REST
    yaw_rate_rad_s: float = 0.0
    acceleration_m_s2: Vector = AT_REST


class Piece(NamedTuple):
    """A part of a flight: its duration, and the polynomials of x, y, z and yaw over the time since it began."""

    duration_s: float
    x: Coefficients
    y: Coefficients
    z: Coefficients
    yaw: Coefficients

    def moment_at(self, t_s: float, rate: float = 1.0) -> Moment:
        """Evaluate the polynomials.

        Args:
            t_s: Time since the piece began.
            rate: How fast ``t_s`` passes. It is negative if the piece is flown backwards.
        """
        x, y, z, yaw = (_derivatives(row, t_s) for row in (self.x, self.y, self.z, self.yaw))
        return Moment(
            (x[0], y[0], z[0]),
            yaw[0],
            (x[1] * rate, y[1] * rate, z[1] * rate),
            yaw[1] * rate,
            (x[2] * rate**2, y[2] * rate**2, z[2] * rate**2),
        )


class Flight:
    """A flight along pieces, and what it is shifted by."""

    def __init__(
        self, pieces: Sequence[Piece], began_s: float, time_scale: float = 1.0, reverse: bool = False
    ) -> None:
        """Make a flight.

        Args:
            pieces: At least one piece.
            began_s: Start of the flight.
            time_scale: How many times longer than planned the flight takes.
            reverse: Fly backwards, from the end to the beginning.
        """
        self._pieces = tuple(reversed(pieces)) if reverse else tuple(pieces)
        self._reverse = reverse
        self._time_scale = time_scale
        self.began_s = began_s
        self.ends_s = began_s + sum(piece.duration_s for piece in pieces) * time_scale
        self._shift_m: Vector = AT_REST
        self._turn_rad = 0.0

    def shift_to(self, xyz_m: Vector, yaw_rad: float | None = None) -> None:
        """Let the flight begin at a place, and, if ``yaw_rad`` is given, turn it to begin with that yaw."""
        self._shift_m, self._turn_rad = AT_REST, 0.0
        start = self.moment_at(self.began_s)
        if yaw_rad is not None:
            self._turn_rad = shortest_turn(start.yaw_rad, yaw_rad)
            start = self.moment_at(self.began_s)
        x, y, z = (to - where for to, where in zip(xyz_m, start.xyz_m, strict=True))
        self._shift_m = x, y, z

    def moment_at(self, now_s: float) -> Moment:
        """Return where the flight has to be. At its end it stays where it ends."""
        left_s = now_s - self.began_s
        for piece in self._pieces:
            lasts_s = piece.duration_s * self._time_scale
            if left_s <= lasts_s and lasts_s > 0:
                t_s = left_s / self._time_scale
                if self._reverse:
                    return self._moved(piece.moment_at(piece.duration_s - t_s, -1.0 / self._time_scale))
                return self._moved(piece.moment_at(t_s, 1.0 / self._time_scale))
            left_s -= lasts_s
        last = self._pieces[-1]
        end = last.moment_at(0.0 if self._reverse else last.duration_s)
        return self._moved(Moment(end.xyz_m, end.yaw_rad))

    def _moved(self, moment: Moment) -> Moment:
        x, y, z = self._turned(moment.xyz_m)
        dx, dy, dz = self._shift_m
        return Moment(
            (x + dx, y + dy, z + dz),
            moment.yaw_rad + self._turn_rad,
            self._turned(moment.velocity_m_s),
            moment.yaw_rate_rad_s,
            self._turned(moment.acceleration_m_s2),
        )

    def _turned(self, vector: Vector) -> Vector:
        cos, sin = math.cos(self._turn_rad), math.sin(self._turn_rad)
        x, y, z = vector
        return cos * x - sin * y, sin * x + cos * y, z


# -- planned flights


def piece_between(start: Moment, end: Moment, duration_s: float) -> Piece:
    """Plan a piece that begins and ends with the given positions, velocities and accelerations, without jerk at
    both ends."""
    if duration_s <= 0:
        px, py, pz = end.xyz_m
        return Piece(0.0, (px,), (py,), (pz,), (end.yaw_rad,))
    x, y, z = (
        _without_jerk(duration_s, *ends)
        for ends in zip(
            start.xyz_m,
            start.velocity_m_s,
            start.acceleration_m_s2,
            end.xyz_m,
            end.velocity_m_s,
            end.acceleration_m_s2,
            strict=True,
        )
    )
    yaw = _without_jerk(duration_s, start.yaw_rad, start.yaw_rate_rad_s, 0.0, end.yaw_rad, end.yaw_rate_rad_s, 0.0)
    return Piece(duration_s, x, y, z, yaw)


def straight(start: Moment, xyz_m: Vector, yaw_rad: float, duration_s: float) -> Piece:
    """Plan a straight line at constant speed."""
    if duration_s <= 0:
        return piece_between(start, Moment(xyz_m, yaw_rad), 0.0)
    vx, vy, vz = ((to - where) / duration_s for to, where in zip(xyz_m, start.xyz_m, strict=True))
    speed, rate = (vx, vy, vz), (yaw_rad - start.yaw_rad) / duration_s
    return piece_between(
        Moment(start.xyz_m, start.yaw_rad, speed, rate), Moment(xyz_m, yaw_rad, speed, rate), duration_s
    )


def spiral(
    start: Moment, angle_rad: float, radii_m: tuple[float, float], ascent_m: float, duration_s: float, style: int
) -> Piece:
    """Plan an arc around a centre beside the drone, or before or behind it, with a changing radius.

    Args:
        start: The present moment.
        angle_rad: Angle of the arc.
        radii_m: Radius at the beginning and at the end.
        ascent_m: Climb during the arc.
        duration_s: Duration.
        style: Bit 0: fly sideways. Bit 1: clockwise.
    """
    sideways, clockwise = bool(style & 1), bool(style & 2)
    angle_rad = max(-2 * math.pi, min(2 * math.pi, angle_rad))
    first_m, last_m = (max(0.0, radius_m) for radius_m in radii_m)
    sense = 1.0 if clockwise else -1.0
    turn, growth = -sense * angle_rad / duration_s, (last_m - first_m) / duration_s
    yaw = math.remainder(start.yaw_rad, math.tau)
    # The centre lies to the side of a drone that flies ahead, and ahead of or behind one that flies sideways.
    outward = (math.pi if clockwise else 0.0) if sideways else sense * math.pi / 2

    def around(radius_m: float, angle: float) -> tuple[Vector, Vector, Vector]:
        cos, sin = math.cos(angle), math.sin(angle)
        place = (radius_m * cos, radius_m * sin, 0.0)
        speed = (growth * cos - radius_m * turn * sin, growth * sin + radius_m * turn * cos, ascent_m / duration_s)
        bend = (
            -radius_m * turn**2 * cos - 2 * growth * turn * sin,
            -radius_m * turn**2 * sin + 2 * growth * turn * cos,
            0.0,
        )
        return place, speed, bend

    place, speed, bend = around(first_m, yaw + outward)
    end_yaw = yaw - sense * angle_rad
    end_place, end_speed, end_bend = around(last_m, end_yaw + outward)
    x, y, z = start.xyz_m
    end_xyz_m = (x - place[0] + end_place[0], y - place[1] + end_place[1], z + ascent_m)
    return piece_between(
        Moment(start.xyz_m, yaw, speed, turn, bend),
        Moment(end_xyz_m, end_yaw, end_speed, turn, end_bend),
        duration_s,
    )


def shortest_turn(from_rad: float, to_rad: float) -> float:
    """Return the shortest turn from one yaw to another, -pi to pi."""
    return math.remainder(to_rad - from_rad, math.tau)


# -- uploaded trajectories


def pieces_in(memory: bytes | bytearray, offset: int, count: int) -> list[Piece]:
    """Decode uncompressed pieces. Raise ``MalformedFrame`` if they are not inside the memory."""
    if count < 1 or offset + count * PIECE.size > len(memory):
        raise MalformedFrame(f"{count} pieces from byte {offset} of a memory with {len(memory)}")
    pieces = []
    for number in range(count):
        values = PIECE.unpack_from(memory, offset + number * PIECE.size)
        rows = [values[COEFFICIENTS * row : COEFFICIENTS * (row + 1)] for row in range(4)]
        pieces.append(Piece(values[-1], *rows))
    return pieces


_CONTROL_POINTS = (0, 1, 3, 7)
"""Number of control points that a piece stores for an axis, by the two bits of its header."""
_PER_M, _PER_RAD = 1000.0, math.degrees(10.0)
"""Units of the compressed form: millimetres, and tenths of a degree."""


def compressed_pieces_in(memory: bytes | bytearray, offset: int) -> list[Piece]:
    """Decode compressed pieces: a start, then curves by their control points. A piece without a duration, or the
    end of the memory, ends them. Raise ``MalformedFrame`` if there is no start."""
    if offset + 8 > len(memory):
        raise MalformedFrame(f"a trajectory from byte {offset} of a memory with {len(memory)}")
    units = (_PER_M, _PER_M, _PER_M, _PER_RAD)
    places = [value / unit for value, unit in zip(struct.unpack_from("<4h", memory, offset), units, strict=True)]
    return list(_compressed(memory, offset + 8, places, units))


def _compressed(
    memory: bytes | bytearray, offset: int, places: list[float], units: Sequence[float]
) -> Iterator[Piece]:
    while offset + 3 <= len(memory):
        kinds, duration_ms = struct.unpack_from("<BH", memory, offset)
        offset += 3
        counts = [_CONTROL_POINTS[kinds >> 2 * axis & 3] for axis in range(4)]
        if duration_ms == 0 or offset + 2 * sum(counts) > len(memory):
            return
        duration_s = duration_ms / 1e3
        rows = []
        for axis, (count, unit) in enumerate(zip(counts, units, strict=True)):
            stored = struct.unpack_from(f"<{count}h", memory, offset)
            offset += 2 * count
            points = [places[axis], *(value / unit for value in stored)]
            rows.append(_bezier(points, duration_s))
            places[axis] = points[-1]
        yield Piece(duration_s, *rows)


# -- polynomials


def _derivatives(row: Coefficients, t: float) -> tuple[float, float, float]:
    """Return a polynomial and its first two derivatives at a time."""
    value = slope = bend = 0.0
    for coefficient in reversed(row):
        bend = bend * t + 2 * slope
        slope = slope * t + value
        value = value * t + coefficient
    return value, slope, bend


def _without_jerk(
    duration_s: float, x0: float, v0: float, a0: float, x1: float, v1: float, a1: float
) -> Coefficients:
    """Return the polynomial of degree 7 with these ends. Its third derivative is zero at both ends."""
    v0, v1, a0, a1 = v0 * duration_s, v1 * duration_s, a0 * duration_s**2, a1 * duration_s**2
    way, speed, bend = x1 - (x0 + v0 + a0 / 2), v1 - (v0 + a0), a1 - a0
    scaled = (
        x0,
        v0,
        a0 / 2,
        0.0,
        35 * way - 15 * speed + 2.5 * bend,
        -84 * way + 39 * speed - 7 * bend,
        70 * way - 34 * speed + 6.5 * bend,
        -20 * way + 10 * speed - 2 * bend,
    )
    return tuple(value / duration_s**power for power, value in enumerate(scaled))


def _bezier(points: Sequence[float], duration_s: float) -> Coefficients:
    """Return the polynomial of a Bézier curve by its control points."""
    degree = len(points) - 1
    row = []
    for power in range(degree + 1):
        parts = ((-1) ** (power - index) * math.comb(power, index) * points[index] for index in range(power + 1))
        row.append(math.comb(degree, power) * sum(parts) / duration_s**power)
    return tuple(row)


__all__ = [
    "AT_REST",
    "PIECE",
    "Flight",
    "Moment",
    "Piece",
    "compressed_pieces_in",
    "piece_between",
    "pieces_in",
    "shortest_turn",
    "spiral",
    "straight",
]
