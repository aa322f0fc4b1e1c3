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
    """Read a message ``SE3Pose``; without a rotation it is not turned. Return None if the quaternion is no unit."""
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


def rotation_between(a: Quaternion, b: Quaternion) -> tuple[Vector, float]:
    """Return the shortest rotation from ``a`` to ``b``: its axis in the frame of ``a``, and its angle, radians."""
    w, x, y, z = _product((a[0], -a[1], -a[2], -a[3]), b)
    if w < 0:
        w, x, y, z = -w, -x, -y, -z
    length = math.sqrt(x * x + y * y + z * z)
    if length < _LEAST:
        return (1.0, 0.0, 0.0), 0.0
    return (x / length, y / length, z / length), 2 * math.atan2(length, w)


def between(a: Pose, b: Pose, share: float) -> Pose:
    """Return the pose on the way from ``a`` to ``b``: 0 is ``a``, 1 is ``b``. The position goes straight, and the
    rotation is about one axis."""
    if share >= 1.0:
        return b
    axis, angle = rotation_between(a.rotation, b.rotation)
    x, y, z = (start + (end - start) * share for start, end in zip(a.xyz, b.xyz, strict=True))
    return Pose((x, y, z), rotated_by(a.rotation, axis, angle * share))


def nearer(a: Pose, b: Pose, most_m: float, most_rad: float) -> Pose:
    """Return the pose on the straight way from ``a`` to ``b`` that is at most so far from ``a``."""
    far, angle = distance(a, b)
    if far <= most_m and angle <= most_rad:
        return b
    share = most_m / far if far > most_m else 1.0
    x, y, z = (start + (end - start) * share for start, end in zip(a.xyz, b.xyz, strict=True))
    axis, _ = rotation_between(a.rotation, b.rotation)
    return Pose((x, y, z), rotated_by(a.rotation, axis, min(angle, most_rad)))


def distance(a: Pose, b: Pose) -> tuple[float, float]:
    """Return how far two poses are apart: metres and radians."""
    return math.dist(a.xyz, b.xyz), rotation_between(a.rotation, b.rotation)[1]


def rotated_by(rotation: Quaternion, axis: Vector, angle_rad: float) -> Quaternion:
    """Turn a rotation about an axis of its frame, a unit vector."""
    sin = math.sin(angle_rad / 2)
    return _product(rotation, (math.cos(angle_rad / 2), axis[0] * sin, axis[1] * sin, axis[2] * sin))


def looking_at(eye: Vector, target: Vector, up: Vector) -> Quaternion | None:
    """Return the rotation with the x axis from ``eye`` to ``target``, and with the z axis as near to ``up`` as
    possible; None if the target is at the eye, or in the direction of ``up``."""
    x_axis = _unit((target[0] - eye[0], target[1] - eye[1], target[2] - eye[2]))
    y_axis = None if x_axis is None else _unit(_cross(up, x_axis))
    if x_axis is None or y_axis is None:
        return None
    return _rotation_of(x_axis, y_axis, _cross(x_axis, y_axis))


def gaze_and_roll(a: Quaternion, b: Quaternion) -> tuple[float, float]:
    """Return by how much the x axes of two rotations differ, and by how much they are turned about this axis,
    radians."""
    x_axis = rotated(b, (1.0, 0.0, 0.0))
    look = math.acos(max(-1.0, min(1.0, _dot(rotated(a, (1.0, 0.0, 0.0)), x_axis))))
    leveled = looking_at(ORIGIN, x_axis, rotated(a, (0.0, 0.0, 1.0)))
    return look, 0.0 if leveled is None else rotation_between(leveled, b)[1]


_LEAST = 1e-9


def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _unit(vector: Vector) -> Vector | None:
    length = math.hypot(*vector)
    return None if length < _LEAST else (vector[0] / length, vector[1] / length, vector[2] / length)


def _rotation_of(x_axis: Vector, y_axis: Vector, z_axis: Vector) -> Quaternion:
    """Return the rotation of a frame with these axes."""
    squares = (
        1 + x_axis[0] + y_axis[1] + z_axis[2],
        1 + x_axis[0] - y_axis[1] - z_axis[2],
        1 - x_axis[0] + y_axis[1] - z_axis[2],
        1 - x_axis[0] - y_axis[1] + z_axis[2],
    )
    # Divide by the largest of the four numbers, so that the others are not lost.
    largest = max(range(4), key=squares.__getitem__)
    double = math.sqrt(squares[largest])
    parts = (
        (double**2, y_axis[2] - z_axis[1], z_axis[0] - x_axis[2], x_axis[1] - y_axis[0]),
        (y_axis[2] - z_axis[1], double**2, y_axis[0] + x_axis[1], z_axis[0] + x_axis[2]),
        (z_axis[0] - x_axis[2], y_axis[0] + x_axis[1], double**2, z_axis[1] + y_axis[2]),
        (x_axis[1] - y_axis[0], z_axis[0] + x_axis[2], z_axis[1] + y_axis[2], double**2),
    )[largest]
    w, x, y, z = (part / (2 * double) for part in parts)
    return w, x, y, z
