"""Decode commands of velocity, and check them against the limits of the arm."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.kinova.protocol import JOINTS, SubError

from . import messages as m
from .errors import CallFailed
from .kinematics import Matrix

MOST_M_S, MOST_DEG_S = 0.5, 100.0
"""Highest velocity of the tool (hard limits since release 2.2, from the vendor's answers to users)."""

FRAMES: Mapping[int, tuple[bool, bool]] = {
    0: (False, True),  # The default of the base is the mixed frame [assumed].
    m.MIXED_FRAME: (False, True),
    m.TOOL_FRAME: (True, True),
    m.BASE_FRAME: (False, False),
}
"""For each reference frame: whether the velocity is along the axes of the tool, and whether the angular one is."""


class Twist(NamedTuple):
    """A velocity of the tool: m/s, then rad/s."""

    values: Matrix
    in_tool: tuple[bool, bool]


def decode_speeds(payload: bytes, fastest_rad_s: Sequence[float]) -> dict[int, float]:
    """Return the joint speeds of ``JointSpeeds`` in rad/s, by joint. The durations in it have no effect, as the
    vendor's reference states.

    Raises:
        CallFailed: They are not one speed for each joint, or one is too high.
    """
    rows = m.sub_messages(pb.message(payload), 1)
    if len(rows) != JOINTS:
        raise CallFailed(SubError.ACTUATOR_COUNT_MISMATCH, f"{len(rows)} speeds, not {JOINTS}")
    speeds: dict[int, float] = {}
    for row in rows:
        joint, value = pb.last_int(row, 1), pb.last_float(row, 2)
        if joint >= JOINTS or joint in speeds:
            raise CallFailed(SubError.INVALID_PARAM, f"no speed for each joint: twice, or no joint: {joint}")
        if not math.isfinite(value):
            raise CallFailed(SubError.INVALID_SPEED, f"joint {joint + 1}: {value}")
        if abs(math.radians(value)) > fastest_rad_s[joint]:
            raise CallFailed(SubError.LARGE_SPEED, f"joint {joint + 1}: {value:.1f} degrees/s")
        speeds[joint] = math.radians(value)
    return speeds


def decode_twist(payload: bytes) -> Twist:
    """Decode ``TwistCommand``. Its duration has no effect, as the vendor's reference states.

    Raises:
        CallFailed: The frame is none, or the velocity is too high.
    """
    fields = pb.message(payload)
    frame = pb.last_int(fields, 1)
    if frame not in FRAMES:
        raise CallFailed(SubError.INVALID_PARAM, f"reference frame {frame}")
    twist = m.sub_message(fields, 2)
    values = np.array([pb.last_float(twist, number) for number in range(1, 7)])
    if not np.isfinite(values).all():
        raise CallFailed(SubError.INVALID_SPEED, f"velocity {values.tolist()}")
    linear, angular = (float(np.linalg.norm(part)) for part in values.reshape(2, 3))
    if linear > MOST_M_S + 1e-6 or angular > MOST_DEG_S + 1e-3:
        raise CallFailed(SubError.LARGE_SPEED, f"{linear:.2f} m/s, {angular:.1f} degrees/s")
    values[3:] = np.radians(values[3:])
    return Twist(values, FRAMES[frame])
