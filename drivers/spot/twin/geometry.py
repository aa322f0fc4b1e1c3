"""Poses in space, as the simulated Spot needs them: a position and a rotation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

from strands_actors.contract.rotations import roll_pitch_yaw
from strands_actors.drivers.spot.messages import Message
from strands_actors.drivers.spot.protocol import Quaternion, Vector, rotated

ORIGIN: Vector = (0.0, 0.0, 0.0)
NO_ROTATION: Quaternion = (1.0, 0.0, 0.0, 0.0)


class Pose(NamedTuple):
    """The pose of a frame in another frame: metres, and a unit quaternion (w, x, y, z)."""

    xyz: Vector = ORIGIN
    rotation: Quaternion = NO_ROTATION

    def compose(self, inner: Pose) -> Pose:
        """Return the pose of a frame that has the pose ``inner`` in this frame."""
        x, y, z = rotated(self.rotation, inner.xyz)
        return Pose((self.xyz[0] + x, self.xyz[1] + y, self.xyz[2] + z), _product(self.rotation, inner.rotation))

    def inverse(self) -> Pose:
        w, x, y, z = self.rotation
        back = (w, -x, -y, -z)
        px, py, pz = rotated(back, self.xyz)
        return Pose((-px, -py, -pz), back)

    @property
    def roll_pitch_yaw(self) -> Vector:
        return roll_pitch_yaw(self.rotation)

    def as_message(self) -> Message:
        """Return the message ``SE3Pose``."""
        return {
            "position": dict(zip("xyz", self.xyz, strict=True)),
            "rotation": dict(zip("wxyz", self.rotation, strict=True)),
        }


def pose_of(message: Mapping[str, Any]) -> Pose | None:
    """Read a message ``SE3Pose``. Return None if its rotation is no unit quaternion. A missing rotation is none."""
    position, rotation = message.get("position", {}), message.get("rotation") or {"w": 1.0}
    x, y, z = (float(position.get(axis, 0.0)) for axis in "xyz")
    w, qx, qy, qz = (float(rotation.get(axis, 0.0)) for axis in "wxyz")
    norm = math.sqrt(w * w + qx * qx + qy * qy + qz * qz)
    if abs(norm - 1.0) > _NORM_TOLERANCE:
        return None
    return Pose((x, y, z), (w / norm, qx / norm, qy / norm, qz / norm))


def pose_at(x: float, y: float, z: float, roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Pose:
    """Return a pose from a position (metres) and from rotations about x, then y, then z (radians)."""
    about_x = (math.cos(roll / 2), math.sin(roll / 2), 0.0, 0.0)
    about_y = (math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0)
    about_z = (math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2))
    return Pose((x, y, z), _product(_product(about_z, about_y), about_x))


def turned(angle_rad: float, x: float, y: float) -> tuple[float, float]:
    """Return a vector of the plane, turned by an angle."""
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)
    return x * cos - y * sin, x * sin + y * cos


def wrapped(angle_rad: float) -> float:
    """Return the same angle in the range -pi to pi."""
    return math.remainder(angle_rad, math.tau)


_NORM_TOLERANCE = 0.01


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
