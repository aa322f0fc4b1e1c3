"""Which joints put the wrist of Spot's arm at a pose. Pure.

The last three joints turn about one point, the centre of the wrist. So the first three follow from the place of
this point, and the last three from the rotation that is then left. Up to eight solutions exist: the shoulder turned
towards the goal or away from it, the elbow bent to either side, the wrist bent to either side.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from strands_actors.drivers.spot.protocol import Vector, rotated

from .geometry import Pose, pose_at, wrapped
from .limbs import FOREARM, SHOULDER, UPPER_ARM

Joints = tuple[float, ...]
Ranges = Sequence[tuple[float, float]]

_UPPER = UPPER_ARM[0]
_LOWER = math.hypot(FOREARM[0], FOREARM[2])
_LOWER_ANGLE = math.atan2(FOREARM[2], FOREARM[0])
"""Angle between the forearm's x axis and the line from the elbow to the wrist."""
_FARTHEST = _UPPER + _LOWER
_STRAIGHT = 1e-6
"""Below this sine of the wrist's bend, the two rolls of the wrist turn about the same axis."""
_ROUNDING = 1e-6


def within_reach(wrist: Pose) -> Pose:
    """Return the pose itself, or the nearest one of the same rotation whose place the stretched arm reaches."""
    x, y, z = _from_shoulder(wrist)
    far = math.hypot(x, y, z)
    if far <= _FARTHEST:
        return wrist
    share = _FARTHEST * (1 - _ROUNDING) / far
    return Pose((SHOULDER[0] + x * share, SHOULDER[1] + y * share, SHOULDER[2] + z * share), wrist.rotation)


def joints_for(wrist: Pose, present: Sequence[float], ranges: Ranges) -> Joints | None:
    """Return the six joints of the arm that put its wrist at a pose; None if it cannot be reached.

    Args:
        wrist: The pose of the wrist in the body, as ``limbs.wrist_at`` returns it.
        present: The present joints. Of several solutions, the nearest to them is returned.
        ranges: The lowest and the highest angle of each joint.
    """
    best, least = None, math.inf
    for solution in _solutions(wrist, present):
        joints = tuple(
            min(max(angle, low), high) for angle, (low, high) in zip(solution, ranges[: len(solution)], strict=True)
        )
        if max(abs(limited - angle) for limited, angle in zip(joints, solution, strict=True)) > _ROUNDING:
            continue
        way = sum((angle - now) ** 2 for angle, now in zip(joints, present, strict=False))
        if way < least:
            best, least = joints, way
    return best


def _solutions(wrist: Pose, present: Sequence[float]) -> Iterator[Joints]:
    x, y, z = _from_shoulder(wrist)
    aside = math.hypot(x, y)
    towards = math.atan2(y, x) if aside > _ROUNDING else present[0]
    cosine = (aside**2 + z**2 - _UPPER**2 - _LOWER**2) / (2 * _UPPER * _LOWER)
    if abs(cosine) > 1:
        return
    bend = math.acos(cosine)
    for sh0, ahead in ((towards, aside), (wrapped(towards + math.pi), -aside)):
        for elbow in (bend, -bend):
            above = math.atan2(-_LOWER * math.sin(elbow), _UPPER + _LOWER * math.cos(elbow))
            sh1 = wrapped(above - math.atan2(z, ahead))
            el0 = elbow + _LOWER_ANGLE
            forearm = pose_at(0.0, 0.0, 0.0, pitch=sh1 + el0, yaw=sh0)
            for rolls in _wrist(forearm.inverse().compose(Pose(rotation=wrist.rotation)), present):
                yield (sh0, sh1, el0, *rolls)


def _wrist(turn: Pose, present: Sequence[float]) -> Iterator[Vector]:
    """Yield the angles of roll, bend and roll that make up a rotation."""
    x_axis, y_axis, z_axis = (rotated(turn.rotation, axis) for axis in _AXES)
    bend = math.acos(max(-1.0, min(1.0, x_axis[0])))
    if math.sin(bend) < _STRAIGHT:
        both = math.atan2(y_axis[2], y_axis[1])
        yield present[3], bend, wrapped(both - present[3])
        return
    for sign in (1.0, -1.0):
        yield (
            math.atan2(sign * x_axis[1], -sign * x_axis[2]),
            sign * bend,
            math.atan2(sign * y_axis[0], sign * z_axis[0]),
        )


_AXES: tuple[Vector, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def _from_shoulder(wrist: Pose) -> Vector:
    x, y, z = (place - start for place, start in zip(wrist.xyz, SHOULDER, strict=True))
    return x, y, z
