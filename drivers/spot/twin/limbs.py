"""Geometry of Spot's legs and arm: where feet and hand are, and which joints put a foot at a place. Pure.

Lengths are those of the model in ``robots.toml``: spot_arm of MuJoCo Menagerie (BSD-3).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from strands_actors.drivers.spot.protocol import Vector

from .geometry import Pose, pose_at, wrapped

HIPS: tuple[tuple[float, float], ...] = ((0.29785, 0.055), (0.29785, -0.055), (-0.29785, 0.055), (-0.29785, -0.055))
"""Place of each hip in the body, in the order of the legs fl, fr, hl, hr."""
_ABDUCTION = 0.1108
"""Distance from the hip to the upper leg, outwards."""
_THIGH = (0.025, -0.32)
"""The knee below the upper leg, forwards and upwards, when its joint is at 0."""
_SHANK = 0.338
"""Length of the lower leg, to the centre of the foot."""
_THIGH_LENGTH = math.hypot(*_THIGH)
_THIGH_ANGLE = math.atan2(_THIGH[0], -_THIGH[1])
SOLE = 0.034
"""Radius of a foot."""

SHOULDER: Vector = (0.292, 0.0, 0.188)
UPPER_ARM: Vector = (0.3385, 0.0, 0.0)
FOREARM: Vector = (0.4033, 0.0, 0.075)
HAND: Vector = (0.19557, 0.0, 0.0)
"""The hand in the frame of the wrist: the default tool of ``ArmCartesianCommand`` (arm_command.proto)."""


def foot_at(leg: int, joints_rad: Sequence[float]) -> Vector:
    """Return where the foot of a leg is in the body, for its angles of hip (two) and knee."""
    hx, hy, kn = joints_rad
    side = math.copysign(_ABDUCTION, HIPS[leg][1])
    forwards = -_THIGH_LENGTH * math.sin(hy - _THIGH_ANGLE) - _SHANK * math.sin(hy + kn)
    down = _THIGH_LENGTH * math.cos(hy - _THIGH_ANGLE) + _SHANK * math.cos(hy + kn)
    return (
        HIPS[leg][0] + forwards,
        HIPS[leg][1] + side * math.cos(hx) + down * math.sin(hx),
        side * math.sin(hx) - down * math.cos(hx),
    )


def leg_to(leg: int, foot: Vector) -> Vector | None:
    """Return the angles of hip and knee that put a foot at a place in the body; None if the leg is too short."""
    x, y, z = foot[0] - HIPS[leg][0], foot[1] - HIPS[leg][1], foot[2]
    side = math.copysign(_ABDUCTION, HIPS[leg][1])
    down_squared = y * y + z * z - side * side
    if down_squared <= 0:
        return None
    down = math.sqrt(down_squared)
    hx = wrapped(math.atan2(z, y) - math.atan2(-down, side))
    reach = math.hypot(x, down)
    cosine = (reach**2 - _THIGH_LENGTH**2 - _SHANK**2) / (2 * _THIGH_LENGTH * _SHANK)
    if abs(cosine) > 1:
        return None
    bend = math.acos(cosine)
    # The knee of a Spot points backwards, so the lower leg is bent forwards.
    thigh = math.atan2(-x, down) + math.atan2(_SHANK * math.sin(bend), _THIGH_LENGTH + _SHANK * math.cos(bend))
    return hx, thigh + _THIGH_ANGLE, -bend - _THIGH_ANGLE


def wrist_at(joints_rad: Sequence[float]) -> Pose:
    """Return the pose of the last link of the arm in the body, for its six angles."""
    sh0, sh1, el0, el1, wr0, wr1 = joints_rad
    pose = pose_at(*SHOULDER, yaw=sh0)
    pose = pose.compose(pose_at(0.0, 0.0, 0.0, pitch=sh1))
    pose = pose.compose(pose_at(*UPPER_ARM, pitch=el0))
    pose = pose.compose(pose_at(*FOREARM, roll=el1))
    return pose.compose(pose_at(0.0, 0.0, 0.0, pitch=wr0)).compose(pose_at(0.0, 0.0, 0.0, roll=wr1))


def hand_at(joints_rad: Sequence[float]) -> Pose:
    """Return the pose of the hand in the body."""
    return wrist_at(joints_rad).compose(Pose(HAND))
