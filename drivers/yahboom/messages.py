"""The ROS messages of an M3 Pro, as plain structs and in the JSON of rosbridge. Pure: no I/O.

A stop is written with whole numbers (``0``), a setpoint with fractions (``0.0``). For ROS they are
equal. A log of the messages can thereby tell a stop from a setpoint of zero.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import msgspec

from strands_actors.contract.axis import finite
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

CMD_VEL = "/cmd_vel"
ARM = "/arm6_joints"
ODOMETRY = "/odom_raw"
IMU = "/imu/data_raw"
JOINT_STATES = "/joint_states"
SCANS = ("/scan0", "/scan1")

COMMANDED: Mapping[str, str] = {CMD_VEL: "geometry_msgs/Twist", ARM: "arm_msgs/ArmJoints"}
"""Topics to which a robot of this wire must subscribe, and their types."""

REPORTED: Mapping[str, str] = {ODOMETRY: "nav_msgs/Odometry"}
"""Topics that it must publish. Without them it is unknown whether the robot stands."""

OPTIONAL: Mapping[str, str] = {
    IMU: "sensor_msgs/Imu",
    JOINT_STATES: "sensor_msgs/JointState",
    **dict.fromkeys(SCANS, "sensor_msgs/LaserScan"),
}
"""Topics that are read if the robot publishes them."""

SERVOS = 6
INT16 = 32767


class Twist(NamedTuple):
    """Speeds of the base: m/s and rad/s."""

    x: float
    y: float
    yaw: float


REST = Twist(0.0, 0.0, 0.0)


class _Vector(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0


class Quaternion(msgspec.Struct, frozen=True):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    w: float = 1.0


class _Stamp(msgspec.Struct, frozen=True):
    sec: int
    nanosec: int


class _Header(msgspec.Struct, frozen=True):
    stamp: _Stamp
    frame_id: str = ""


class _Pose(msgspec.Struct, frozen=True):
    position: _Vector
    orientation: Quaternion


class _PoseOfOdometry(msgspec.Struct, frozen=True):
    pose: _Pose


class _Speeds(msgspec.Struct, frozen=True):
    linear: _Vector
    angular: _Vector


class _TwistOfOdometry(msgspec.Struct, frozen=True):
    twist: _Speeds


class _Odometry(msgspec.Struct, frozen=True):
    header: _Header
    pose: _PoseOfOdometry
    twist: _TwistOfOdometry


class _Imu(msgspec.Struct, frozen=True):
    orientation: Quaternion
    angular_velocity: _Vector
    linear_acceleration: _Vector


class _JointState(msgspec.Struct, frozen=True):
    name: list[str]
    position: list[float]


class _Scan(msgspec.Struct, frozen=True):
    range_min: float
    range_max: float
    ranges: list[float | None]


class Odometry(NamedTuple):
    """Position and speed of the base, computed from its wheels."""

    stamp_ns: int  # time of the measurement by the robot's clock
    x_m: float
    y_m: float
    yaw_rad: float
    speed: Twist


class Imu(NamedTuple):
    """A reading of the inertial unit."""

    orientation_wxyz: tuple[float, float, float, float]
    gyro_rad_s: tuple[float, float, float]
    acceleration_m_s2: tuple[float, float, float]


class ArmGoal(NamedTuple):
    """Goal of the six servos, and the duration of the motion."""

    degrees: tuple[int, ...]
    time_ms: int


Message = Odometry | Imu | dict[str, float] | float
"""The content of a topic: odometry, inertial unit, joints by name in radians, or the nearest distance of a
scan in metres."""

_STRUCTS: Mapping[str, type[_Odometry | _Imu | _JointState | _Scan]] = {
    ODOMETRY: _Odometry,
    IMU: _Imu,
    JOINT_STATES: _JointState,
}
"""The struct of each topic. All other topics are scans."""


def twist_message(twist: Twist, *, stop: bool = False) -> dict[str, Any]:
    """Encode a ``geometry_msgs/Twist``. With ``stop`` the twist is ignored, and zero is written in
    whole numbers."""
    if stop:
        return {"linear": {"x": 0, "y": 0, "z": 0}, "angular": {"x": 0, "y": 0, "z": 0}}
    x, y, yaw = (float(value) for value in twist)
    return {"linear": {"x": x, "y": y, "z": 0.0}, "angular": {"x": 0.0, "y": 0.0, "z": yaw}}


def arm_message(goal: ArmGoal) -> dict[str, int]:
    """Encode an ``arm_msgs/ArmJoints``. Raise ``ValueError`` unless there are six servos and all
    numbers fit into 16 bits."""
    if len(goal.degrees) != SERVOS or not all(0 <= value <= INT16 for value in (*goal.degrees, goal.time_ms)):
        raise ValueError(
            f"an arm goal needs {SERVOS} servos and 16-bit numbers, not {goal.degrees} in {goal.time_ms} ms"
        )
    return {**{f"joint{number}": value for number, value in enumerate(goal.degrees, 1)}, "time": goal.time_ms}


def read_twist(message: Mapping[str, Any]) -> tuple[Twist, bool]:
    """Decode a ``geometry_msgs/Twist``. The second result is True if it is written as a stop. A
    missing number counts as 0, as in ROS. Raise ``MalformedFrame``."""
    parts = [message.get(name, {}) for name in ("linear", "angular")]
    if not all(isinstance(part, Mapping) for part in parts):
        raise MalformedFrame("a Twist in which linear or angular is not a vector")
    raw = [part.get(axis, 0) for part in parts for axis in "xyz"]
    numbers = [finite(value) for value in raw]
    speeds = [number for number in numbers if number is not None]
    if len(speeds) != len(numbers):
        raise MalformedFrame("a Twist with a value that is not a finite number")
    return Twist(speeds[0], speeds[1], speeds[5]), all(type(value) is int and value == 0 for value in raw)


def read_arm(message: Mapping[str, Any]) -> ArmGoal:
    """Decode an ``arm_msgs/ArmJoints``. Raise ``MalformedFrame``."""
    values = [message.get(name) for name in (*(f"joint{number}" for number in range(1, SERVOS + 1)), "time")]
    if not all(type(value) is int and -INT16 - 1 <= value <= INT16 for value in values):
        raise MalformedFrame("an ArmJoints without six joints and a time, each an int16")
    return ArmGoal(tuple(int(value) for value in values[:SERVOS] if value is not None), int(values[-1] or 0))


def read_report(topic: str, message: bytes | msgspec.Raw) -> Message:
    """Decode a message of a topic in ``REPORTED`` or ``OPTIONAL`` from JSON. Raise ``MalformedFrame``."""
    try:
        return _message(msgspec.json.decode(message, type=_STRUCTS.get(topic, _Scan)))
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise MalformedFrame(f"{topic}: {error}") from None


def read_fields(topic: str, fields: Mapping[str, Any]) -> Message:
    """Convert the fields of such a message, which came from the graph. Raise ``MalformedFrame``."""
    try:
        return _message(msgspec.convert(fields, type=_STRUCTS.get(topic, _Scan)))
    except (msgspec.ValidationError, ValueError) as error:
        raise MalformedFrame(f"{topic}: {error}") from None


def nearest_m(scan: Any) -> float:
    """Return the nearest distance of a ``sensor_msgs/LaserScan`` in metres; NaN if nothing is in range."""
    within = [
        value
        for value in scan.ranges
        if value is not None and math.isfinite(value) and scan.range_min <= value <= scan.range_max
    ]
    return min(within, default=math.nan)


def yaw_of(quaternion: Any) -> float:
    """Return the heading of an orientation, in radians."""
    q = quaternion
    return math.atan2(2 * (q.w * q.z + q.x * q.y), 1 - 2 * (q.y * q.y + q.z * q.z))


def quaternion_of(yaw_rad: float) -> dict[str, float]:
    """Return the ``geometry_msgs/Quaternion`` of a heading."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw_rad / 2), "w": math.cos(yaw_rad / 2)}


def _odometry(message: _Odometry) -> Odometry:
    stamp, pose, speeds = message.header.stamp, message.pose.pose, message.twist.twist
    return Odometry(
        stamp.sec * 10**9 + stamp.nanosec,
        pose.position.x,
        pose.position.y,
        yaw_of(pose.orientation),
        Twist(speeds.linear.x, speeds.linear.y, speeds.angular.z),
    )


def _imu(message: _Imu) -> Imu:
    turned, gyro, pushed = message.orientation, message.angular_velocity, message.linear_acceleration
    return Imu((turned.w, turned.x, turned.y, turned.z), (gyro.x, gyro.y, gyro.z), (pushed.x, pushed.y, pushed.z))


def _message(message: _Odometry | _Imu | _JointState | _Scan) -> Message:
    match message:
        case _Odometry():
            return _odometry(message)
        case _Imu():
            return _imu(message)
        case _JointState():
            return dict(zip(message.name, message.position, strict=False))
        case _Scan():
            return nearest_m(message)


def plain_type(name: str) -> str:
    """Return the name of a message type as ROS 1 and rosbridge spell it: ``geometry_msgs/Twist``
    for ``geometry_msgs/msg/Twist``."""
    return name.replace("/msg/", "/")


def full_type(name: str) -> str:
    """Return the name of a message type as ROS 2 spells it, for one of ``plain_type``."""
    return name.replace("/", "/msg/")


def stands(speed: Twist, still: Sequence[float] = (0.01, 0.01, 0.02)) -> bool:
    """Return True if a base with this speed stands still.

    Args:
        speed: The reported speed.
        still: Largest speeds that count as zero: m/s, m/s, rad/s [assumed].
    """
    return all(abs(value) <= most for value, most in zip(speed, still, strict=True))
