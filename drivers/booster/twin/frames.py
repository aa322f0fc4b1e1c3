"""Compute the vendor's frame transform (``GetFrameTransform``) from the simulated body."""

from __future__ import annotations

from typing import Any

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.legged_body import LeggedBody

FRAMES = ("base", "head_pitch", "left_elbow_yaw", "right_elbow_yaw", "left_crank_down", "right_crank_down")
"""The link of each frame, in the order of the vendor's enum: body, head, left hand, right hand, left foot, right
foot. The links are those that have these names in MuJoCo Menagerie's T1 (Trunk, H2, left_hand_link, ...)."""


def transform_between(body: LeggedBody, source: object, destination: object) -> dict[str, Any] | None:
    """Return the pose of one frame in another one, at the present joint positions.

    Args:
        body: The simulated body.
        source: Number of the frame whose pose is returned.
        destination: Number of the frame in which this pose is expressed [assumed: the vendor describes them only as
            source and destination].

    Returns:
        Position (m) and orientation (quaternion), as the vendor's client reads them. None if a number is not that
        of a frame.
    """
    poses = [_pose_of(body, number) for number in (source, destination)]
    if None in poses:
        return None
    (point, turn), (origin, frame) = (pose for pose in poses if pose is not None)
    back, position, orientation = np.empty(4), np.empty(3), np.empty(4)
    mujoco.mju_negQuat(back, frame)
    mujoco.mju_rotVecQuat(position, point - origin, back)
    mujoco.mju_mulQuat(orientation, back, turn)
    w, *xyz = orientation.tolist()
    return {
        "position": dict(zip("xyz", position.tolist(), strict=True)),
        "orientation": {**dict(zip("xyz", xyz, strict=True)), "w": w},
    }


def _pose_of(body: LeggedBody, number: object) -> tuple[Any, Any] | None:
    """Return the position and the quaternion of a frame in the world, or None if there is no such frame."""
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(FRAMES):
        return None
    link = body.data.body(FRAMES[number])
    return np.array(link.xpos), np.array(link.xquat)
