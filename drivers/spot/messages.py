"""The messages of Spot's services that this driver uses, as tables of fields with number and kind.
Pure: no I/O.

A message is a plain ``dict`` of the fields that are set. Decoding skips fields that are not in the
tables. Source: the protobuf descriptors of Boston Dynamics' published API, version 5.2.

Kinds: ``int`` (signed), ``uint``, ``bool``, ``float``, ``double``, ``text``, ``bytes``, or the name of a
message. ``*`` after a kind means repeated.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from strands_actors.drivers.common.codecs import protobuf as pb
from strands_actors.drivers.common.codecs.malformed import MalformedFrame

Message = dict[str, Any]

_REQUEST = "header 1 RequestHeader"
_REPLY = "header 1 ResponseHeader"

TABLES: Mapping[str, str] = {
    # common
    "Timestamp": "seconds 1 int, nanos 2 int",
    "Number": "value 1 double",
    "Vec2": "x 1 double, y 2 double",
    "Vec3": "x 1 double, y 2 double, z 3 double",
    "Quaternion": "x 1 double, y 2 double, z 3 double, w 4 double",
    "Pose": "position 1 Vec3, rotation 2 Quaternion",
    "Twist2": "linear 1 Vec2, angular 2 double",
    "Twist3": "linear 1 Vec3, angular 2 Vec3",
    "TwistLimit": "max_vel 1 Twist2, min_vel 2 Twist2",
    "Pose2": "position 1 Vec2, angle 2 double",
    "Trajectory2": "points 1 Point2*, reference_time 3 Timestamp",
    "Point2": "pose 1 Pose2, time_since_reference 3 Timestamp",
    "Trajectory3": "points 1 Point3*, reference_time 3 Timestamp",
    "Point3": "pose 1 Pose, time_since_reference 3 Timestamp",
    "RequestHeader": "request_timestamp 1 Timestamp, client_name 2 text",
    "CommonError": "code 1 uint, message 2 text",
    "ResponseHeader": "request_header 1 RequestHeader, request_received_timestamp 2 Timestamp, "
    "response_timestamp 3 Timestamp, error 4 CommonError",
    # auth, robot-id, directory
    "GetAuthTokenRequest": f"{_REQUEST}, username 2 text, password 3 text, token 4 text",
    "GetAuthTokenResponse": f"{_REPLY}, status 2 uint, token 3 text",
    "RobotIdRequest": _REQUEST,
    "RobotIdResponse": f"{_REPLY}, robot_id 2 RobotId",
    "RobotId": "serial_number 1 text, species 2 text, version 3 text, software_release 4 Release, nickname 5 text",
    "Release": "version 1 Version",
    "Version": "major_version 1 int, minor_version 2 int, patch_level 3 int",
    "ListServiceEntriesRequest": _REQUEST,
    "ListServiceEntriesResponse": f"{_REPLY}, service_entries 2 ServiceEntry*",
    "GetServiceEntryRequest": f"{_REQUEST}, service_name 2 text",
    "GetServiceEntryResponse": f"{_REPLY}, status 2 uint, service_entry 3 ServiceEntry",
    "ServiceEntry": "name 1 text, type 2 text, authority 3 text, last_update 4 Timestamp, "
    "user_token_required 5 bool, liveness_timeout_secs 8 double",
    "RegisterServiceRequest": f"{_REQUEST}, service_entry 3 ServiceEntry",
    "RegisterServiceResponse": f"{_REPLY}, status 2 uint",
    "UnregisterServiceRequest": f"{_REQUEST}, service_name 2 text",
    "UnregisterServiceResponse": f"{_REPLY}, status 2 uint",
    "UpdateServiceRequest": f"{_REQUEST}, service_entry 3 ServiceEntry",
    "UpdateServiceResponse": f"{_REPLY}, status 2 uint",
    # time-sync
    "TimeSyncUpdateRequest": f"{_REQUEST}, previous_round_trip 2 RoundTrip, clock_identifier 3 text",
    "TimeSyncUpdateResponse": f"{_REPLY}, previous_estimate 2 Estimate, state 3 TimeSyncState, "
    "clock_identifier 4 text",
    "RoundTrip": "client_tx 1 Timestamp, server_rx 2 Timestamp, server_tx 3 Timestamp, client_rx 4 Timestamp",
    "Estimate": "round_trip_time 1 Timestamp, clock_skew 2 Timestamp",
    "TimeSyncState": "best_estimate 1 Estimate, status 2 uint, measurement_time 3 Timestamp",
    # estop
    "Endpoint": "role 1 text, name 2 text, unique_id 3 text, timeout 4 Timestamp, cut_power_timeout 5 Timestamp",
    "EstopConfig": "endpoints 1 Endpoint*, unique_id 2 text",
    "EndpointStatus": "endpoint 1 Endpoint, stop_level 2 uint, time_since_valid_response 3 Timestamp",
    "EstopStatus": "endpoints 3 EndpointStatus*, stop_level 4 uint, stop_level_details 5 text",
    "EstopCheckInRequest": f"{_REQUEST}, endpoint 2 Endpoint, challenge 3 uint, response 4 uint, stop_level 5 uint",
    "EstopCheckInResponse": f"{_REPLY}, request 2 EstopCheckInRequest, challenge 3 uint, status 4 uint",
    "RegisterEstopEndpointRequest": f"{_REQUEST}, target_endpoint 2 Endpoint, target_config_id 3 text, "
    "new_endpoint 4 Endpoint",
    "RegisterEstopEndpointResponse": f"{_REPLY}, request 2 RegisterEstopEndpointRequest, new_endpoint 3 Endpoint, "
    "status 4 uint",
    "DeregisterEstopEndpointRequest": f"{_REQUEST}, target_endpoint 2 Endpoint, target_config_id 3 text",
    "DeregisterEstopEndpointResponse": f"{_REPLY}, request 2 DeregisterEstopEndpointRequest, status 4 uint",
    "GetEstopConfigRequest": f"{_REQUEST}, target_config_id 4 text",
    "GetEstopConfigResponse": f"{_REPLY}, request 2 GetEstopConfigRequest, active_config 3 EstopConfig",
    "SetEstopConfigRequest": f"{_REQUEST}, config 3 EstopConfig, target_config_id 4 text",
    "SetEstopConfigResponse": f"{_REPLY}, request 2 SetEstopConfigRequest, active_config 3 EstopConfig, "
    "status 4 uint",
    "GetEstopSystemStatusRequest": _REQUEST,
    "GetEstopSystemStatusResponse": f"{_REPLY}, status 3 EstopStatus",
    # lease
    "Lease": "resource 1 text, epoch 2 text, sequence 3 uint*, client_names 4 text*",
    "LeaseOwner": "client_name 1 text, user_name 2 text",
    "LeaseUse": "status 1 uint, owner 2 LeaseOwner, attempted_lease 3 Lease, previous_lease 4 Lease, "
    "latest_known_lease 5 Lease",
    "AcquireLeaseRequest": f"{_REQUEST}, resource 2 text",
    "AcquireLeaseResponse": f"{_REPLY}, status 2 uint, lease 3 Lease, lease_owner 4 LeaseOwner",
    "TakeLeaseRequest": f"{_REQUEST}, resource 2 text",
    "TakeLeaseResponse": f"{_REPLY}, status 2 uint, lease 3 Lease, lease_owner 4 LeaseOwner",
    "ReturnLeaseRequest": f"{_REQUEST}, lease 2 Lease",
    "ReturnLeaseResponse": f"{_REPLY}, status 2 uint",
    "RetainLeaseRequest": f"{_REQUEST}, lease 2 Lease",
    "RetainLeaseResponse": f"{_REPLY}, lease_use_result 2 LeaseUse",
    "ListLeasesRequest": _REQUEST,
    "ListLeasesResponse": f"{_REPLY}, resources 2 LeaseResource*",
    "LeaseResource": "resource 1 text, lease 2 Lease, lease_owner 3 LeaseOwner, is_stale 5 bool",
    # power
    "PowerCommandRequest": f"{_REQUEST}, lease 2 Lease, request 3 uint",
    "PowerCommandResponse": f"{_REPLY}, lease_use_result 2 LeaseUse, status 3 uint, power_command_id 4 uint, "
    "license_status 5 uint",
    "PowerCommandFeedbackRequest": f"{_REQUEST}, power_command_id 2 uint",
    "PowerCommandFeedbackResponse": f"{_REPLY}, status 2 uint",
    # robot-state
    "RobotStateRequest": _REQUEST,
    "RobotStateResponse": f"{_REPLY}, robot_state 2 RobotState",
    "RobotState": "power_state 1 PowerState, battery_states 2 Battery*, estop_states 5 EStopState*, "
    "system_fault_state 4 SystemFaults, kinematic_state 6 Kinematics, behavior_fault_state 7 BehaviorFaults, "
    "foot_state 8 Foot*, service_fault_state 10 ServiceFaults, manipulator_state 11 Manipulator, "
    "behavior_state 14 Behavior",
    "Manipulator": "is_gripper_holding_item 6 bool, stow_state 9 uint, gripper_open_percentage 12 double, "
    "carry_state 16 uint",
    "SystemFaults": "faults 1 SystemFault*",
    "SystemFault": "name 1 text, onset_timestamp 2 Timestamp, error_message 5 text, severity 7 uint",
    "ServiceFaults": "faults 1 ServiceFault*",
    "ServiceFault": "fault_id 1 ServiceFaultId, error_message 2 text, attributes 3 text*, severity 4 uint, "
    "onset_timestamp 5 Timestamp",
    "ServiceFaultId": "fault_name 1 text, service_name 2 text, payload_guid 3 text",
    "TriggerServiceFaultRequest": f"{_REQUEST}, fault 2 ServiceFault",
    "TriggerServiceFaultResponse": f"{_REPLY}, status 2 uint",
    "ClearServiceFaultRequest": f"{_REQUEST}, fault_id 2 ServiceFaultId, clear_all_service_faults 3 bool, "
    "clear_all_payload_faults 4 bool",
    "ClearServiceFaultResponse": f"{_REPLY}, status 2 uint",
    "Foot": "foot_position_rt_body 1 Vec3, contact 2 uint",
    "Behavior": "state 1 uint",
    "PowerState": "timestamp 1 Timestamp, motor_power_state 2 uint, shore_power_state 3 uint, "
    "robot_power_state 6 uint",
    "Battery": "identifier 2 text, charge_percentage 3 Number, voltage 6 Number, status 8 uint",
    "EStopState": "name 2 text, type 3 uint, state 4 uint, state_description 5 text",
    "Kinematics": "joint_states 2 Joint*, velocity_of_body_in_vision 8 Twist3, velocity_of_body_in_odom 12 Twist3, "
    "acquisition_timestamp 30 Timestamp, transforms_snapshot 31 FrameTree",
    "Joint": "name 1 text, position 2 Number, velocity 3 Number, load 5 Number",
    "FrameTree": "edges 1 Edge*",
    "Edge": "key 1 text, value 2 ParentEdge",
    "ParentEdge": "parent_frame_name 1 text, parent_tform_child 2 Pose",
    "BehaviorFaults": "faults 1 BehaviorFault*",
    "BehaviorFault": "behavior_fault_id 1 uint, onset_timestamp 2 Timestamp, cause 3 uint, status 4 uint",
    "RobotMetricsRequest": _REQUEST,
    "RobotMetricsResponse": f"{_REPLY}, robot_metrics 2 RobotMetrics",
    "RobotMetrics": "timestamp 1 Timestamp, metrics 2 Parameter*",
    "Parameter": "label 1 text, units 2 text, float_value 4 double, duration 6 Timestamp",
    "RobotHardwareConfigurationRequest": _REQUEST,
    "RobotHardwareConfigurationResponse": f"{_REPLY}, hardware_configuration 2 Hardware",
    "Hardware": "skeleton 1 Skeleton, can_power_command_request_off_robot 2 bool, "
    "can_power_command_request_cycle_robot 3 bool, can_power_command_request_payload_ports 4 bool, "
    "can_power_command_request_wifi_radio 5 bool, has_audio_visual_system 7 bool, "
    "redundant_safety_stop_enabled 8 bool",
    "Skeleton": "links 2 Link*, urdf 3 text",
    "Link": "name 1 text",
    "RobotLinkModelRequest": f"{_REQUEST}, link_name 2 text",
    "RobotLinkModelResponse": f"{_REPLY}, link_model 2 LinkModel",
    "LinkModel": "file_name 1 text, file_contents 2 text",
    # robot-command
    "RobotCommandRequest": f"{_REQUEST}, lease 2 Lease, command 3 Command, clock_identifier 4 text",
    "RobotCommandResponse": f"{_REPLY}, lease_use_result 2 LeaseUse, status 3 uint, message 4 text, "
    "robot_command_id 5 uint",
    "RobotCommandFeedbackRequest": f"{_REQUEST}, robot_command_id 2 uint",
    "RobotCommandFeedbackResponse": f"{_REPLY}, feedback 4 Feedback, lease_use_result 5 LeaseUse",
    "ClearBehaviorFaultRequest": f"{_REQUEST}, lease 2 Lease, behavior_fault_id 3 uint",
    "ClearBehaviorFaultResponse": f"{_REPLY}, lease_use_result 2 LeaseUse, status 3 uint, "
    "behavior_fault 4 BehaviorFault, blocking_system_faults 5 SystemFault*",
    "Command": "full_body_command 1 FullBody, synchronized_command 3 Synchronized",
    "FullBody": "stop_request 1 Empty, freeze_request 2 Empty, selfright_request 3 Empty, "
    "safe_power_off_request 4 SafePowerOff, battery_change_pose_request 5 Empty, "
    "payload_estimation_request 6 Empty, constrained_manipulation_request 7 Empty, joint_request 8 Empty",
    "Empty": "",
    "SafePowerOff": "unsafe_action 1 uint",
    "Synchronized": "arm_command 1 Arm, mobility_command 2 Mobility, gripper_command 3 Gripper",
    "Mobility": "se2_trajectory_request 1 Trajectory, se2_velocity_request 2 Velocity, sit_request 3 Empty, "
    "stand_request 4 Empty, stance_request 5 StanceRequest, stop_request 6 Empty, follow_arm_request 7 FollowArm, "
    "freeze_request 8 Empty, params 100 Any",
    "Any": "type_url 1 text, value 2 MobilityParams",
    "MobilityParams": "vel_limit 1 TwistLimit, body_control 2 BodyControl, locomotion_hint 3 uint",
    "BodyControl": "base_offset_rt_footprint 1 Trajectory3, rotation_setting 2 uint, body_pose 4 BodyPose",
    "BodyPose": "root_frame_name 1 text, base_offset_rt_root 2 Trajectory3",
    "Velocity": "end_time 1 Timestamp, velocity 2 Twist2, slew_rate_limit 4 Twist2, se2_frame_name 5 text",
    "Trajectory": "end_time 1 Timestamp, trajectory 2 Trajectory2, se2_frame_name 3 text",
    "StanceRequest": "end_time 1 Timestamp, stance 2 Stance",
    "Stance": "se2_frame_name 3 text, foot_positions 2 FootPosition*, accuracy 4 float",
    "FootPosition": "key 1 text, value 2 Vec2",
    "FollowArm": "body_offset_from_hand 1 Vec3",
    "Arm": "arm_cartesian_command 3 ArmCartesian, arm_joint_move_command 4 ArmJointMove, "
    "named_arm_position_command 5 NamedPosition, arm_velocity_command 6 ArmVelocity, arm_gaze_command 8 Gaze, "
    "arm_stop_command 9 Empty, arm_drag_command 10 Empty, params 11 Empty, arm_impedance_command 12 Empty",
    "ArmCartesian": "root_frame_name 19 text, wrist_tform_tool 6 Pose, root_tform_task 20 Pose, "
    "pose_trajectory_in_task 2 Trajectory3, max_linear_velocity 4 Number, max_angular_velocity 5 Number, "
    "max_pos_tracking_error 15 Number, max_rot_tracking_error 16 Number, x_axis 8 uint, y_axis 9 uint, "
    "z_axis 10 uint, rx_axis 11 uint, ry_axis 12 uint, rz_axis 13 uint, wrench_trajectory_in_task 14 Empty",
    "ArmVelocity": "cylindrical_velocity 1 CylindricalVelocity, cartesian_velocity 2 CartesianVelocity, "
    "angular_velocity_of_hand_rt_odom_in_hand 6 Vec3, end_time 5 Timestamp",
    "CylindricalVelocity": "linear_velocity 1 Cylindrical, max_linear_velocity 2 Number",
    "Cylindrical": "r 1 double, theta 2 double, z 3 double",
    "CartesianVelocity": "frame_name 1 text, velocity_in_frame_name 2 Vec3",
    "Gaze": "target_trajectory_in_frame1 1 Places, frame1_name 2 text, tool_trajectory_in_frame2 10 Trajectory3, "
    "frame2_name 11 text, wrist_tform_tool 9 Pose, max_linear_velocity 7 Number, max_angular_velocity 8 Number",
    "Places": "points 1 PlacePoint*, reference_time 3 Timestamp",
    "PlacePoint": "point 1 Vec3, time_since_reference 3 Timestamp",
    "ArmJointMove": "trajectory 1 ArmTrajectory",
    "NamedPosition": "position 1 uint",
    "ArmTrajectory": "points 1 ArmPoint*, reference_time 2 Timestamp, maximum_velocity 3 Number, "
    "maximum_acceleration 4 Number",
    "ArmPoint": "position 1 ArmPosition, time_since_reference 3 Timestamp",
    "ArmPosition": "sh0 1 Number, sh1 2 Number, el0 3 Number, el1 4 Number, wr0 5 Number, wr1 6 Number",
    "Gripper": "claw_gripper_command 1 Claw",
    "Claw": "maximum_open_close_velocity 2 Number, trajectory 5 ClawTrajectory",
    "ClawTrajectory": "points 1 ClawPoint*, reference_time 2 Timestamp",
    "ClawPoint": "point 1 double, time_since_reference 3 Timestamp",
    "Feedback": "full_body_feedback 2 FullBodyFeedback, synchronized_feedback 3 SynchronizedFeedback",
    "FullBodyFeedback": "stop_feedback 1 Empty, safe_power_off_feedback 4 Status1, status 100 uint",
    "SynchronizedFeedback": "arm_command_feedback 1 ArmFeedback, mobility_command_feedback 2 MobilityFeedback, "
    "gripper_command_feedback 3 GripperFeedback",
    "ArmFeedback": "arm_cartesian_feedback 3 ArmCartesianFeedback, arm_joint_move_feedback 4 ArmJointMoveFeedback, "
    "named_arm_position_feedback 5 Status1, arm_velocity_feedback 6 Empty, arm_gaze_feedback 8 GazeFeedback, "
    "arm_stop_feedback 9 Empty, status 100 uint",
    "ArmCartesianFeedback": "status 1 uint, measured_pos_tracking_error 2 double, "
    "measured_rot_tracking_error 3 double, measured_pos_distance_to_goal 4 double, "
    "measured_rot_distance_to_goal 5 double",
    "GazeFeedback": "status 1 uint, gazing_at_target 2 bool, gaze_to_target_rotation_measured 5 float, "
    "hand_position_at_goal 3 bool, hand_distance_to_goal_measured 6 float, hand_roll_at_goal 4 bool, "
    "hand_roll_to_target_roll_measured 7 float",
    "ArmJointMoveFeedback": "status 1 uint, planner_status 2 uint, time_to_goal 4 Timestamp",
    "GripperFeedback": "claw_gripper_feedback 1 Status1, status 2 uint",
    "MobilityFeedback": "se2_trajectory_feedback 1 TrajectoryFeedback, se2_velocity_feedback 2 VelocityFeedback, "
    "sit_feedback 3 Status2, stand_feedback 4 StandFeedback, stance_feedback 5 Status1, stop_feedback 6 Empty, "
    "follow_arm_feedback 7 Empty, status 100 uint",
    "TrajectoryFeedback": "status 1 uint, body_movement_status 2 uint, final_goal_status 5 uint, "
    "request_information 6 Trajectory",
    "VelocityFeedback": "request_information 1 Velocity",
    "StandFeedback": "status 1 uint, standing_state 2 uint",
    "Status1": "status 1 uint",
    "Status2": "status 2 uint",
    # image
    "ListImageSourcesRequest": _REQUEST,
    "ListImageSourcesResponse": f"{_REPLY}, image_sources 2 ImageSource*, transforms_snapshot 3 FrameTree",
    "ImageSource": "name 2 text, cols 4 int, rows 5 int, depth_scale 6 double, pinhole 8 Pinhole, "
    "image_type 9 uint, pixel_formats 10 uint*, image_formats 11 uint*",
    "Pinhole": "intrinsics 1 Intrinsics",
    "Intrinsics": "focal_length 1 Vec2, principal_point 2 Vec2, skew 3 Vec2",
    "GetImageRequest": f"{_REQUEST}, image_requests 2 ImageRequest*",
    "ImageRequest": "image_source_name 1 text, quality_percent 2 double, image_format 3 uint, "
    "resize_ratio 4 double, pixel_format 5 uint, fallback_formats 7 uint*",
    "GetImageResponse": f"{_REPLY}, image_responses 2 ImageResponse*",
    "ImageResponse": "shot 1 ImageCapture, source 2 ImageSource, status 4 uint",
    "ImageCapture": "acquisition_time 30 Timestamp, transforms_snapshot 31 FrameTree, "
    "frame_name_image_sensor 5 text, image 3 Image",
    "Image": "cols 2 int, rows 3 int, data 4 bytes, format 5 uint, pixel_format 6 uint",
    # data-buffer
    "RecordOperatorCommentsRequest": f"{_REQUEST}, operator_comments 2 OperatorComment*",
    "RecordOperatorCommentsResponse": _REPLY,
    "OperatorComment": "message 1 text, timestamp 2 Timestamp",
}


class Field:
    """One field of a message. ``kind`` is stored without the star, which marks a repeated field."""

    __slots__ = ("kind", "number", "repeated")

    def __init__(self, number: int, kind: str) -> None:
        self.number = number
        self.repeated = kind.endswith("*")
        self.kind = kind.removesuffix("*")


@cache
def table(name: str) -> Mapping[str, Field]:
    """Return the fields of a message type by name."""
    rows = (row.split() for row in TABLES[name].split(",") if row.strip())
    return {field: Field(int(number), kind) for field, number, kind in rows}


@cache
def _by_number(name: str) -> Mapping[int, tuple[str, Field]]:
    return {field.number: (key, field) for key, field in table(name).items()}


def encode(name: str, message: Mapping[str, Any]) -> bytes:
    """Encode a message. Raise ``KeyError`` for a field that its table lacks."""
    fields = table(name)
    data = b""
    for key, value in message.items():
        field = fields[key]
        for each in value if field.repeated else (value,):
            data += _encode_field(field, each)
    return data


def _encode_field(field: Field, value: Any) -> bytes:
    match field.kind:
        case "uint" | "bool":
            return pb.varint_field(field.number, int(value))
        case "int":
            return pb.varint_field(field.number, int(value) & _ALL_BITS)
        case "float":
            return pb.float_field(field.number, float(value))
        case "double":
            return pb.double_field(field.number, float(value))
        case "text":
            return pb.bytes_field(field.number, str(value).encode())
        case "bytes":
            return pb.bytes_field(field.number, value)
    return pb.bytes_field(field.number, encode(field.kind, value))


def decode(name: str, data: bytes) -> Message:
    """Decode a message. Return the fields that are set. Raise ``MalformedFrame``."""
    fields, message = _by_number(name), Message()
    for number, wire_type, value in pb.fields(data):
        if number not in fields:
            continue
        key, field = fields[number]
        if field.repeated:
            message.setdefault(key, []).extend(_values(field, wire_type, value))
        else:
            message[key] = _value(field, wire_type, value)
    return message


def _values(field: Field, wire_type: int, value: pb.Value) -> Sequence[Any]:
    if field.kind == "uint" and isinstance(value, bytes):
        # A packed list of numbers.
        return pb.varints(pb.bytes_field(1, value), 1)
    return (_value(field, wire_type, value),)


def _value(field: Field, wire_type: int, value: pb.Value) -> Any:
    match field.kind:
        case "uint" | "int" | "bool" if wire_type == pb.VARINT and isinstance(value, int):
            if field.kind == "int" and value > _ALL_BITS // 2:
                return value - _ALL_BITS - 1
            return bool(value) if field.kind == "bool" else value
        case "double" if wire_type == pb.FIXED64 and isinstance(value, int):
            return pb.as_double(value)
        case "float" if wire_type == pb.FIXED32 and isinstance(value, int):
            return pb.as_float(value)
        case "bytes" if isinstance(value, bytes):
            return value
        case "text" if isinstance(value, bytes):
            try:
                return value.decode()
            except UnicodeDecodeError:
                raise MalformedFrame(f"protobuf: field {field.number} is no text") from None
        case "uint" | "int" | "bool" | "float" | "double" | "text" | "bytes":
            raise MalformedFrame(f"protobuf: field {field.number} is no {field.kind}")
    if not isinstance(value, bytes):
        raise MalformedFrame(f"protobuf: field {field.number} is no {field.kind}")
    return decode(field.kind, value)


_ALL_BITS = (1 << 64) - 1
