"""The frames that the simulated Spot knows by name, and where they are."""

from __future__ import annotations

from collections.abc import Mapping

from .geometry import Pose, pose_at
from .limbs import hand_at, wrist_at
from .mechanism import CLAW_INDEX, Mechanism

FIXED = ("odom", "vision")
"""Frames that stay where they are. The twin's two are the same."""
OF_THE_BODY = ("body", "flat_body")
"""Frames that move with the body."""
OF_THE_FEET = ("gpe", "feet_center")
OF_THE_ARM = ("arm0.link_wr1", "hand")


def frames_of(mechanism: Mechanism, has_arm: bool) -> Mapping[str, Pose]:
    """Return the pose of each frame, relative to the place on the floor where the robot started. The frames are
    those that robot_state.proto promises."""
    body = mechanism.body_pose
    frames = {"body": body, "flat_body": level(body)}
    frames |= dict.fromkeys(FIXED, mechanism.odometry) | dict.fromkeys(OF_THE_FEET, mechanism.footprint)
    if has_arm:
        arm = mechanism.joints[:CLAW_INDEX]
        frames |= zip(OF_THE_ARM, (body.compose(wrist_at(arm)), body.compose(hand_at(arm))), strict=True)
    return frames


def level(body: Pose) -> Pose:
    """Return the pose of the frame ``flat_body``: at the body, and level."""
    return pose_at(*body.xyz, yaw=body.roll_pitch_yaw[2])
