"""Describe the devices of the simulated robot, as its service answers the vendor's requests for them.

The answers have the fields ``imus``, ``hands`` and ``robot_model``, which the vendor's SDK documents (its
``b1_loco_client.hpp`` and ``device_info.hpp``, July 2026). Within these fields the names are those of the vendor's
messages ``ImuInfo``, ``Hand`` and ``RobotModel`` [assumed: the code that reads them is not public].
"""

from __future__ import annotations

from typing import Any

import numpy as np

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.booster.robots import Model
from strands_actors.drivers.booster.rpc import Api
from strands_actors.drivers.common.kit.motor_targets import Joint
from strands_actors.drivers.common.physics.lean_mujoco import mujoco
from strands_actors.drivers.common.physics.legged_body import LeggedBody

UNKNOWN_IMU = 0
"""Number of an inertial unit without a known type, in the vendor's enum ``ImuModel``."""
REVOLUTE = 1
"""Number of a joint with an axis and limits, in the vendor's enum ``JointType``."""

_INERTIA = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}


def device_info(model: Model, body: LeggedBody, api: int) -> dict[str, Any]:
    """Return the answer to a request for devices.

    Args:
        model: The robot type.
        body: The robot's body.
        api: ``GET_SENSORS``, ``GET_HANDS`` or ``GET_ROBOT_MODEL``.
    """
    match api:
        case Api.GET_SENSORS:
            return {"imus": [{"index": 0, "name": "imu", "model": UNKNOWN_IMU, "mount_position": "base"}]}
        case Api.GET_HANDS:
            return {"hands": []}
    links = [body.model.body(number) for number in range(1, body.model.nbody)]
    joints = [_joint(body.model, motor) for motor in model.motors]
    return {"robot_model": {"root_link": links[0].name, "links": [*map(_link, links)], "joints": joints}}


def _link(link: Any) -> dict[str, Any]:
    turn = np.empty(9)
    mujoco.mju_quat2Mat(turn, link.iquat)
    axes = turn.reshape(3, 3)
    inertia = axes @ np.diag(link.inertia) @ axes.T
    inertial = {
        "origin": _origin(link.ipos, (1.0, 0.0, 0.0, 0.0)),
        "mass": float(link.mass[0]),
        "inertia": {name: float(inertia[index]) for name, index in _INERTIA.items()},
    }
    return {"name": link.name, "inertial": inertial, "collisions": []}


def _joint(model: Any, motor: Joint) -> dict[str, Any]:
    joint = model.joint(motor.key)
    child = model.body(joint.bodyid[0])
    return {
        "name": motor.key,
        "type": REVOLUTE,
        "parent_link": model.body(child.parentid[0]).name,
        "child_link": child.name,
        "origin": _origin(child.pos, child.quat),
        "axis": _vector(joint.axis),
        "limit": {"lower": motor.low, "upper": motor.high, "effort": motor.torque, "velocity": motor.speed},
    }


def _origin(xyz: Any, quaternion_wxyz: Any) -> dict[str, dict[str, float]]:
    return {"xyz": _vector(xyz), "rpy": _vector(roll_pitch_yaw(quaternion_wxyz))}


def _vector(values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip("xyz", values, strict=True)}
