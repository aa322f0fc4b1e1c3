"""Convert the topics of a robot to ROS messages. Pure.

A stamp is the time of the reading, by the wall clock of the robot's host.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from typing import Any

from strands_actors.contract.axis import finite
from strands_actors.contract.rotations import quaternion as quaternion_of
from strands_actors.kernel.clock import NS

from .joints import Layout
from .samples import Battery, Imu, Numbers, Odom, State, Wrench
from .tool_pose import PoseOf

_UNKNOWN = [-1.0] + 8 * [0.0]
"""The covariance of sensor_msgs/msg/Imu that stands for a value which is not measured."""


def stamp(time_s: float) -> dict[str, int]:
    """Return builtin_interfaces/msg/Time for a time of the wall clock, in seconds."""
    time_ns = round(time_s * NS)
    return {"sec": time_ns // NS, "nanosec": time_ns % NS}


def header(time_s: float, frame: str = "") -> dict[str, Any]:
    return {"stamp": stamp(time_s), "frame_id": frame}


def joint_state(state: State, layout: Layout) -> dict[str, Any] | None:
    """Return sensor_msgs/msg/JointState with each joint that was read.

    Velocities are given only if all these joints have one, since ROS expects as many velocities as names. Efforts
    are given if one joint has one, with NaN for the others, since few grippers report any.

    Returns:
        None if no joint was read, or if the reading is too old.
    """
    if state.age_s is None or not 0.0 <= state.age_s <= layout.stale_s:
        return None
    names: list[str] = []
    positions: list[float] = []
    velocities: list[float] = []
    efforts: list[float] = []
    for joint in layout.joints:
        value, speed = finite(state.joints.get(joint.key)), finite(state.velocities.get(joint.key))
        if value is None:
            continue
        names.append(joint.key)
        positions.append(joint.position(value))
        effort = finite(state.efforts.get(joint.key))
        efforts.append(math.nan if effort is None else effort)
        if speed is not None:
            velocities.append(joint.velocity(speed))
    if not names:
        return None
    return {
        "header": header(state.t - state.age_s),
        "name": names,
        "position": positions,
        "velocity": velocities if len(velocities) == len(names) else [],
        "effort": [] if all(map(math.isnan, efforts)) else efforts,
    }


def tool_pose(joint_state_message: Mapping[str, Any], pose_of: PoseOf, frame: str) -> dict[str, Any] | None:
    """Return geometry_msgs/msg/PoseStamped of the tool, with the stamp of the joints. None if a joint is missing.

    Args:
        joint_state_message: The joints.
        pose_of: Computes the pose.
        frame: The frame of the arm's base.
    """
    positions = dict(zip(joint_state_message["name"], joint_state_message["position"], strict=True))
    pose = pose_of(positions)
    if pose is None:
        return None
    return {
        "header": {**joint_state_message["header"], "frame_id": frame},
        "pose": {"position": _vector(pose[0]), "orientation": _quaternion(*pose[1])},
    }


def wrench(sample: Wrench, fields: frozenset[str], frame: str) -> dict[str, Any] | None:
    """Return geometry_msgs/msg/WrenchStamped. ``frame`` is the frame along whose axes the wrench is."""
    numbers = _numbers(sample.wrench, 6) if "wrench" in fields else None
    if numbers is None:
        return None
    return {
        "header": header(sample.t, frame),
        "wrench": {"force": _vector(numbers[:3]), "torque": _vector(numbers[3:])},
    }


def image(jpeg: bytes, time_s: float, frame: str) -> dict[str, Any]:
    """Return sensor_msgs/msg/CompressedImage."""
    return {"header": header(time_s, frame), "format": "jpeg", "data": jpeg}


def camera_info(width: int, height: int, time_s: float, frame: str) -> dict[str, Any]:
    """Return sensor_msgs/msg/CameraInfo of a camera that is not calibrated: all numbers of the lens are zero."""
    return {"header": header(time_s, frame), "width": width, "height": height}


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return width and height of a JPEG picture in pixels. None if the bytes are no such picture."""
    offset = 2
    while jpeg[:2] == b"\xff\xd8" and offset + 9 <= len(jpeg) and jpeg[offset] == 0xFF:
        marker, length = jpeg[offset + 1], int.from_bytes(jpeg[offset + 2 : offset + 4], "big")
        # 0xC0 to 0xCF begin a frame, except for two kinds of tables and an extension.
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", jpeg, offset + 5)
            return width, height
        offset += 2 + length
    return None


def imu(sample: Imu, fields: frozenset[str], frame: str) -> dict[str, Any] | None:
    """Return sensor_msgs/msg/Imu. Parts that the robot does not measure have the covariance -1.

    Args:
        sample: The reading.
        fields: The fields with a known unit. All others are left out.
        frame: The frame of the sensor.

    Returns:
        None if nothing was measured.
    """
    orientation = None
    if "quaternion" in fields and (quaternion := _numbers(sample.quaternion, 4)):
        orientation = _quaternion(*quaternion)
    elif "rpy" in fields and (rpy := _numbers(sample.rpy, 3)):
        orientation = _quaternion(*quaternion_of(*rpy))
    gyro = _numbers(sample.gyro, 3) if "gyro" in fields else None
    accel = _numbers(sample.accel, 3) if "accel" in fields else None
    if orientation is None and gyro is None and accel is None:
        return None
    return {
        "header": header(sample.t, frame),
        "orientation": orientation or _quaternion(1.0, 0.0, 0.0, 0.0),
        "orientation_covariance": _covariance(orientation),
        "angular_velocity": _vector(gyro),
        "angular_velocity_covariance": _covariance(gyro),
        "linear_acceleration": _vector(accel),
        "linear_acceleration_covariance": _covariance(accel),
    }


def battery(sample: Battery, fields: frozenset[str]) -> dict[str, Any] | None:
    """Return sensor_msgs/msg/BatteryState. Numbers that the robot does not measure are NaN."""
    charge = finite(sample.pct) if "pct" in fields else None
    voltage = finite(sample.voltage) if "voltage" in fields else None
    if charge is None and voltage is None:
        return None
    not_measured = dict.fromkeys(("temperature", "current", "charge", "capacity", "design_capacity"), math.nan)
    return {
        "header": header(sample.t),
        "voltage": math.nan if voltage is None else voltage,
        "percentage": math.nan if charge is None else charge / 100.0,
        "present": True,
        **not_measured,
    }


def odometry(sample: Odom, fields: frozenset[str], frame: str, child: str) -> dict[str, Any] | None:
    """Return nav_msgs/msg/Odometry. Its covariances are zero, because no robot reports them.

    Args:
        sample: The reading.
        fields: The fields with a known unit. All others are left out.
        frame: The frame of the position.
        child: The frame of the robot, in which its speeds are.

    Returns:
        None without a position.
    """
    position = _numbers(sample.xyz, 3) if "xyz" in fields else None
    if position is None and "xy" in fields and (flat := _numbers(sample.xy, 2)):
        position = (*flat, 0.0)
    if position is None:
        return None
    if "quaternion" in fields and (quaternion := _numbers(sample.quaternion, 4)):
        orientation = _quaternion(*quaternion)
    else:
        orientation = _quaternion(*quaternion_of(0.0, 0.0, _heading(sample, fields)))
    return {
        "header": header(sample.t, frame),
        "child_frame_id": child,
        "pose": {"pose": {"position": _vector(position), "orientation": orientation}},
        "twist": {
            "twist": {
                "linear": _vector(_speeds(sample.linear, first=True) if "linear" in fields else None),
                "angular": _vector(_speeds(sample.angular, first=False) if "angular" in fields else None),
            }
        },
    }


def transform(odometry_message: dict[str, Any]) -> dict[str, Any]:
    """Return tf2_msgs/msg/TFMessage with the place of a robot, from its odometry."""
    pose = odometry_message["pose"]["pose"]
    return {
        "transforms": [
            {
                "header": odometry_message["header"],
                "child_frame_id": odometry_message["child_frame_id"],
                "transform": {"translation": pose["position"], "rotation": pose["orientation"]},
            }
        ]
    }


def _heading(sample: Odom, fields: frozenset[str]) -> float:
    for field in ("theta", "yaw", "heading"):
        angle = finite(getattr(sample, field))
        if field in fields and angle is not None:
            return angle
    return 0.0


def _speeds(value: Numbers | float | None, first: bool) -> tuple[float, ...] | None:
    """Return three speeds. A single number is the speed forwards (``first``), or that about the z axis."""
    if isinstance(value, list):
        if len(value) == 2:
            return _numbers([*value, 0.0], 3)
        return _numbers(value, 3)
    speed = finite(value)
    if speed is None:
        return None
    return (speed, 0.0, 0.0) if first else (0.0, 0.0, speed)


def _numbers(values: Sequence[float | None] | None, count: int) -> tuple[float, ...] | None:
    """Return so many numbers; None if one of them is missing or is not finite."""
    if values is None or len(values) != count:
        return None
    numbers = tuple(number for number in map(finite, values) if number is not None)
    return numbers if len(numbers) == count else None


def _vector(values: Sequence[float] | None) -> dict[str, float]:
    return dict(zip("xyz", values or (0.0, 0.0, 0.0), strict=True))


def _quaternion(w: float, x: float, y: float, z: float) -> dict[str, float]:
    return {"x": x, "y": y, "z": z, "w": w}


def _covariance(measured: object) -> list[float]:
    return _UNKNOWN if measured is None else [0.0] * 9
