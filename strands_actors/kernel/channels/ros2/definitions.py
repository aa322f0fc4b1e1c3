"""The fields of the ROS messages, services and actions that this package sends or receives.

A field's type is written as in ROS: ``float64``, ``string``, the full name of another message, and behind it
``[]`` for a sequence, ``[36]`` for an array, ``[<=1]`` for a sequence of at most one element. Constants are left
out, because they are neither sent nor hashed. ROS 2 reads ``char`` as ``uint8``, so that stands here. A test
compares all definitions with those of ROS 2 Jazzy.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

Fields = Mapping[str, str]

TIME = "builtin_interfaces/msg/Time"
HEADER = "std_msgs/msg/Header"
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
IMU = "sensor_msgs/msg/Imu"
BATTERY = "sensor_msgs/msg/BatteryState"
ODOMETRY = "nav_msgs/msg/Odometry"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"
TWIST = "geometry_msgs/msg/Twist"
TWIST_STAMPED = "geometry_msgs/msg/TwistStamped"
POSE = "geometry_msgs/msg/PoseStamped"
WRENCH = "geometry_msgs/msg/WrenchStamped"
NUMBERS = "std_msgs/msg/Float64MultiArray"
TF = "tf2_msgs/msg/TFMessage"
COMPRESSED_IMAGE = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
TRIGGER = "std_srvs/srv/Trigger"
STATUS = "action_msgs/msg/GoalStatusArray"
CANCEL = "action_msgs/srv/CancelGoal"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
GRIPPER = "control_msgs/action/GripperCommand"
TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
DURATION = "builtin_interfaces/msg/Duration"
UUID = "unique_identifier_msgs/msg/UUID"
_GOAL_INFO = "action_msgs/msg/GoalInfo"
_POINT, _MULTI_POINT = (
    "trajectory_msgs/msg/JointTrajectoryPoint",
    "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint",
)
_MULTI_TRAJECTORY = "trajectory_msgs/msg/MultiDOFJointTrajectory"
_TOLERANCE, _COMPONENT_TOLERANCE = "control_msgs/msg/JointTolerance", "control_msgs/msg/JointComponentTolerance"

_GRIPPER_STATE: Fields = {"position": "float64", "effort": "float64", "stalled": "bool", "reached_goal": "bool"}

ACTIONS = (FOLLOW, GRIPPER)
"""The actions. Each has the messages ``_Goal``, ``_Result`` and ``_Feedback`` in the table below."""

MESSAGES: Mapping[str, Fields] = {
    TIME: {"sec": "int32", "nanosec": "uint32"},
    HEADER: {"stamp": TIME, "frame_id": "string"},
    STRING: {"data": "string"},
    JOINT_STATE: {
        "header": HEADER,
        "name": "string[]",
        "position": "float64[]",
        "velocity": "float64[]",
        "effort": "float64[]",
    },
    "geometry_msgs/msg/Vector3": {"x": "float64", "y": "float64", "z": "float64"},
    "geometry_msgs/msg/Point": {"x": "float64", "y": "float64", "z": "float64"},
    "geometry_msgs/msg/Quaternion": {"x": "float64", "y": "float64", "z": "float64", "w": "float64"},
    "geometry_msgs/msg/Pose": {
        "position": "geometry_msgs/msg/Point",
        "orientation": "geometry_msgs/msg/Quaternion",
    },
    "geometry_msgs/msg/PoseWithCovariance": {"pose": "geometry_msgs/msg/Pose", "covariance": "float64[36]"},
    TWIST: {"linear": "geometry_msgs/msg/Vector3", "angular": "geometry_msgs/msg/Vector3"},
    TWIST_STAMPED: {"header": HEADER, "twist": TWIST},
    POSE: {"header": HEADER, "pose": "geometry_msgs/msg/Pose"},
    "geometry_msgs/msg/Wrench": {"force": "geometry_msgs/msg/Vector3", "torque": "geometry_msgs/msg/Vector3"},
    WRENCH: {"header": HEADER, "wrench": "geometry_msgs/msg/Wrench"},
    "std_msgs/msg/MultiArrayDimension": {"label": "string", "size": "uint32", "stride": "uint32"},
    "std_msgs/msg/MultiArrayLayout": {"dim": "std_msgs/msg/MultiArrayDimension[]", "data_offset": "uint32"},
    NUMBERS: {"layout": "std_msgs/msg/MultiArrayLayout", "data": "float64[]"},
    "geometry_msgs/msg/TwistWithCovariance": {"twist": TWIST, "covariance": "float64[36]"},
    "geometry_msgs/msg/Transform": {
        "translation": "geometry_msgs/msg/Vector3",
        "rotation": "geometry_msgs/msg/Quaternion",
    },
    "geometry_msgs/msg/TransformStamped": {
        "header": HEADER,
        "child_frame_id": "string",
        "transform": "geometry_msgs/msg/Transform",
    },
    TF: {"transforms": "geometry_msgs/msg/TransformStamped[]"},
    IMU: {
        "header": HEADER,
        "orientation": "geometry_msgs/msg/Quaternion",
        "orientation_covariance": "float64[9]",
        "angular_velocity": "geometry_msgs/msg/Vector3",
        "angular_velocity_covariance": "float64[9]",
        "linear_acceleration": "geometry_msgs/msg/Vector3",
        "linear_acceleration_covariance": "float64[9]",
    },
    BATTERY: {
        "header": HEADER,
        "voltage": "float32",
        "temperature": "float32",
        "current": "float32",
        "charge": "float32",
        "capacity": "float32",
        "design_capacity": "float32",
        "percentage": "float32",
        "power_supply_status": "uint8",
        "power_supply_health": "uint8",
        "power_supply_technology": "uint8",
        "present": "bool",
        "cell_voltage": "float32[]",
        "cell_temperature": "float32[]",
        "location": "string",
        "serial_number": "string",
    },
    ODOMETRY: {
        "header": HEADER,
        "child_frame_id": "string",
        "pose": "geometry_msgs/msg/PoseWithCovariance",
        "twist": "geometry_msgs/msg/TwistWithCovariance",
    },
    "diagnostic_msgs/msg/KeyValue": {"key": "string", "value": "string"},
    "diagnostic_msgs/msg/DiagnosticStatus": {
        "level": "byte",
        "name": "string",
        "message": "string",
        "hardware_id": "string",
        "values": "diagnostic_msgs/msg/KeyValue[]",
    },
    DIAGNOSTICS: {"header": HEADER, "status": "diagnostic_msgs/msg/DiagnosticStatus[]"},
    COMPRESSED_IMAGE: {"header": HEADER, "format": "string", "data": "uint8[]"},
    "sensor_msgs/msg/RegionOfInterest": {
        "x_offset": "uint32",
        "y_offset": "uint32",
        "height": "uint32",
        "width": "uint32",
        "do_rectify": "bool",
    },
    CAMERA_INFO: {
        "header": HEADER,
        "height": "uint32",
        "width": "uint32",
        "distortion_model": "string",
        "d": "float64[]",
        "k": "float64[9]",
        "r": "float64[9]",
        "p": "float64[12]",
        "binning_x": "uint32",
        "binning_y": "uint32",
        "roi": "sensor_msgs/msg/RegionOfInterest",
    },
    "sensor_msgs/msg/LaserScan": {
        "header": HEADER,
        "angle_min": "float32",
        "angle_max": "float32",
        "angle_increment": "float32",
        "time_increment": "float32",
        "scan_time": "float32",
        "range_min": "float32",
        "range_max": "float32",
        "ranges": "float32[]",
        "intensities": "float32[]",
    },
    # Of the vendor of the ROSMASTER M3 Pro.
    "arm_msgs/msg/ArmJoints": {**{f"joint{number}": "int16" for number in range(1, 7)}, "time": "int16"},
    DURATION: {"sec": "int32", "nanosec": "uint32"},
    UUID: {"uuid": "uint8[16]"},
    _GOAL_INFO: {"goal_id": UUID, "stamp": TIME},
    "action_msgs/msg/GoalStatus": {"goal_info": _GOAL_INFO, "status": "int8"},
    STATUS: {"status_list": "action_msgs/msg/GoalStatus[]"},
    _POINT: {
        "positions": "float64[]",
        "velocities": "float64[]",
        "accelerations": "float64[]",
        "effort": "float64[]",
        "time_from_start": DURATION,
    },
    TRAJECTORY: {"header": HEADER, "joint_names": "string[]", "points": f"{_POINT}[]"},
    _MULTI_POINT: {
        "transforms": "geometry_msgs/msg/Transform[]",
        "velocities": f"{TWIST}[]",
        "accelerations": f"{TWIST}[]",
        "time_from_start": DURATION,
    },
    _MULTI_TRAJECTORY: {"header": HEADER, "joint_names": "string[]", "points": f"{_MULTI_POINT}[]"},
    _TOLERANCE: {"name": "string", "position": "float64", "velocity": "float64", "acceleration": "float64"},
    _COMPONENT_TOLERANCE: {
        "joint_name": "string",
        "component": "uint16",
        "position": "float64",
        "velocity": "float64",
        "acceleration": "float64",
    },
    f"{FOLLOW}_Goal": {
        "trajectory": TRAJECTORY,
        "multi_dof_trajectory": _MULTI_TRAJECTORY,
        "path_tolerance": f"{_TOLERANCE}[]",
        "component_path_tolerance": f"{_COMPONENT_TOLERANCE}[]",
        "goal_tolerance": f"{_TOLERANCE}[]",
        "component_goal_tolerance": f"{_COMPONENT_TOLERANCE}[]",
        "goal_time_tolerance": DURATION,
    },
    f"{FOLLOW}_Result": {"error_code": "int32", "error_string": "string"},
    f"{FOLLOW}_Feedback": {
        "header": HEADER,
        "joint_names": "string[]",
        "desired": _POINT,
        "actual": _POINT,
        "error": _POINT,
        "multi_dof_joint_names": "string[]",
        "multi_dof_desired": _MULTI_POINT,
        "multi_dof_actual": _MULTI_POINT,
        "multi_dof_error": _MULTI_POINT,
    },
    "control_msgs/msg/GripperCommand": {"position": "float64", "max_effort": "float64"},
    f"{GRIPPER}_Goal": {"command": "control_msgs/msg/GripperCommand"},
    f"{GRIPPER}_Result": _GRIPPER_STATE,
    f"{GRIPPER}_Feedback": _GRIPPER_STATE,
    **{f"{action}_FeedbackMessage": {"goal_id": UUID, "feedback": f"{action}_Feedback"} for action in ACTIONS},
    "service_msgs/msg/ServiceEventInfo": {
        "event_type": "uint8",
        "stamp": TIME,
        "client_gid": "uint8[16]",
        "sequence_number": "int64",
    },
}
"""The fields of each message, by its name."""


_NOTHING: Fields = {"structure_needs_at_least_one_member": "uint8"}
"""The fields of a message without fields. ROS adds this one, because a structure must have a member."""


class Service(NamedTuple):
    """The two messages of a service."""

    request: Fields
    response: Fields


SERVICES: Mapping[str, Service] = {
    TRIGGER: Service(request=_NOTHING, response={"success": "bool", "message": "string"}),
    CANCEL: Service(
        request={"goal_info": _GOAL_INFO},
        response={"return_code": "int8", "goals_canceling": f"{_GOAL_INFO}[]"},
    ),
    # The two services of an action that have separate types.
    **{
        f"{action}_SendGoal": Service(
            request={"goal_id": UUID, "goal": f"{action}_Goal"}, response={"accepted": "bool", "stamp": TIME}
        )
        for action in ACTIONS
    },
    **{
        f"{action}_GetResult": Service(
            request={"goal_id": UUID}, response={"status": "int8", "result": f"{action}_Result"}
        )
        for action in ACTIONS
    },
}
"""The messages of each service, by its name."""


class FieldType(NamedTuple):
    """The type of a field, parsed.

    Attributes:
        base: A basic type, or the name of a message.
        kind: The form of the value.
        size: The number of elements of an array, or the greatest number of a bounded sequence; else 0.
    """

    base: str
    kind: str
    size: int


SINGLE, ARRAY, SEQUENCE, BOUNDED = "", "array", "sequence", "bounded"


def parse_type(text: str) -> FieldType:
    """Return the parts of a field's type, such as ``float64[36]``."""
    base, bracket, rest = text.partition("[")
    if not bracket:
        return FieldType(base, SINGLE, 0)
    size = rest.removesuffix("]")
    if not size:
        return FieldType(base, SEQUENCE, 0)
    if size.startswith("<="):
        return FieldType(base, BOUNDED, int(size[2:]))
    return FieldType(base, ARRAY, int(size))


def fields_of(name: str) -> Fields:
    """Return the fields of a message, or of a service's ``NAME_Request``, ``NAME_Response`` or ``NAME_Event``.

    Raises:
        KeyError: The table has no such type.
    """
    if name in MESSAGES:
        return MESSAGES[name]
    service, _, part = name.rpartition("_")
    if part == "Request":
        return SERVICES[service].request
    if part == "Response":
        return SERVICES[service].response
    if part == "Event" and service in SERVICES:
        return {
            "info": "service_msgs/msg/ServiceEventInfo",
            "request": f"{service}_Request[<=1]",
            "response": f"{service}_Response[<=1]",
        }
    raise KeyError(name)
