"""Add a camera to a robot's hand, unless its model has one. The camera is behind and above the gripper and looks at
it."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from strands_actors.drivers.common.physics.lean_mujoco import PLAIN, mujoco

WRIST = "wrist"
FIELD_DEG = 75.0
LEAST_M = 0.04
"""Least distance from the hand's origin to its tip, for a hand without shapes."""

_HANDS = re.compile(r"hand|gripper|wrist|palm|tool|flange|_ee")


def add_wrist(spec: Any) -> bool:
    """Add a camera at the robot's hand to the model ``spec``, unless the model has one. Return False for a robot
    without an arm, which gets no camera."""
    if any(camera.name == WRIST for camera in spec.cameras):
        return True
    model = spec.copy().compile()
    hand = hand_of(model)
    if hand is None:
        return False
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    place, quat = _mounted(model, data, hand)
    spec.body(model.body(hand).name).add_camera(
        default=PLAIN.default, name=WRIST, pos=place, quat=quat, fovy=FIELD_DEG
    )
    return True


def hand_of(model: Any) -> int | None:
    """Return the index of the body that is the robot's hand; None for a robot without an arm.

    It is the outermost body with a name like "hand" or "gripper". If no name fits, it is the end of the longest arm
    on a fixed base.
    """
    depth = [0] * model.nbody
    fixed = [True] * model.nbody
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        depth[body] = depth[parent] + 1
        joint_types = [int(model.jnt_type[joint]) for joint in _joints(model, body)]
        fixed[body] = fixed[parent] and int(mujoco.mjtJoint.mjJNT_FREE) not in joint_types
    named = [body for body in range(1, model.nbody) if _HANDS.search(model.body(body).name.lower())]
    arms = [body for body in range(1, model.nbody) if fixed[body] and depth[body] > 2 and model.body(body).name]
    candidates = named or arms
    return max(candidates, key=lambda body: depth[body]) if candidates else None


def _joints(model: Any, body: int) -> range:
    first = int(model.body_jntadr[body])
    return range(first, first + int(model.body_jntnum[body])) if first >= 0 else range(0)


def _mounted(model: Any, data: Any, hand: int) -> tuple[list[float], list[float]]:
    """Return position and orientation of the camera in the frame of the hand's body."""
    origin, axes = data.xpos[hand], data.xmat[hand].reshape(3, 3)
    carried = {hand}
    for body in range(hand + 1, model.nbody):
        if int(model.body_parentid[body]) in carried:
            carried.add(body)
    shapes = [data.geom_xpos[geom] for geom in range(model.ngeom) if int(model.geom_bodyid[geom]) in carried]
    tip = np.mean(shapes, axis=0) if shapes else origin
    ahead = _unit(tip - data.xpos[int(model.body_parentid[hand])], np.array([0.0, 0.0, 1.0]))
    reach_m = max(2 * float(np.linalg.norm(tip - origin)), LEAST_M)
    up = np.array([0.0, 0.0, 1.0]) if abs(ahead[2]) < 0.9 else np.array([1.0, 0.0, 0.0])
    up = _unit(up - ahead * float(up @ ahead), up)
    eye = origin - ahead * 0.6 * reach_m + up * 1.2 * reach_m
    forward = _unit(tip + ahead * reach_m - eye, ahead)
    right = _unit(np.cross(forward, up), np.array([0.0, 1.0, 0.0]))
    camera_axes = np.column_stack([right, np.cross(right, forward), -forward])
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, (axes.T @ camera_axes).flatten())
    place: list[float] = (axes.T @ (eye - origin)).tolist()
    turned: list[float] = quat.tolist()
    return place, turned


def _unit(vector: Any, otherwise: Any) -> Any:
    length = float(np.linalg.norm(vector))
    return vector / length if length > 1e-6 else otherwise
