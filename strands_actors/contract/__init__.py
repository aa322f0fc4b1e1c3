"""The names that the author of a driver imports.

A stop channel is a second connection to the robot that can stop it when the usual one cannot; only the stop
channels of this package do I/O.

``Driver``, ``Wire``, ``StopChannel``   the three classes of a driver, besides its twin
``CONTRACT_VERSION``                    the version of this contract (docs/versioning.md)
``Part``, ``Axis``, ``axis_gates``      the axes of the robot, and the limits of their targets
``SafeState``, ``Reason``, ``Timing``   the states in which a robot is safe, the reasons for a stop, the times of a
                                        connection
``DriverOptions``, ``option``           keywords of the constructor
``DuplicateDescriptor`` to ``OwnProcess``   ready-made stop channels
``ArmModel``, ``arm_table``             the links and the tool of an arm, for motions to a pose
``CameraSettings``, ``Picture``, ``PictureSource``   the robot's own cameras

``strands_actors.testing`` has the tests that every driver must pass.
"""

from strands_actors.kernel.clock import NS, Clock
from strands_actors.kernel.messages import Refused

from .arm_model import ArmModel, arm_table
from .axis import Axis, AxisMode, Part, PartKind
from .axis_gates import axis_gates, past_range, stale, too_fast
from .cameras import CameraSettings, Picture, PictureSource
from .contract_version import CONTRACT_VERSION
from .driver import (
    HOLDING_REASONS,
    Candidate,
    Condition,
    Driver,
    GateCheck,
    GateState,
    OnResume,
    Reason,
    Service,
    Timing,
)
from .fallbacks import check_fallbacks, fallbacks_for
from .options import DriverOptions, meanings, option, plain, read_options, secrets_of
from .rotations import quaternion, roll_pitch_yaw
from .safe_state import SafeState
from .sensors import ReadOnlyJoint, Sensor
from .stop_channels import ConnectWhenNeeded, DuplicateDescriptor, KeptSession, WatchedFirmware
from .stop_process import OwnProcess
from .tool_verbs import GET_POSE, MOVE_TO, MOVE_TO_POSE, SENSORS, SET_TORQUE, STATE, STATUS, STOP, ToolVerb
from .wire import MotorReport, Observation, Permit, PermitDenied, ProcessSpent, StopChannel, Wire, WireDown

__all__ = [
    "CONTRACT_VERSION",
    "GET_POSE",
    "HOLDING_REASONS",
    "MOVE_TO",
    "MOVE_TO_POSE",
    "NS",
    "SENSORS",
    "SET_TORQUE",
    "STATE",
    "STATUS",
    "STOP",
    "ArmModel",
    "Axis",
    "AxisMode",
    "CameraSettings",
    "Candidate",
    "Clock",
    "Condition",
    "ConnectWhenNeeded",
    "Driver",
    "DriverOptions",
    "DuplicateDescriptor",
    "GateCheck",
    "GateState",
    "KeptSession",
    "MotorReport",
    "Observation",
    "OnResume",
    "OwnProcess",
    "Part",
    "PartKind",
    "Permit",
    "PermitDenied",
    "Picture",
    "PictureSource",
    "ProcessSpent",
    "ReadOnlyJoint",
    "Reason",
    "Refused",
    "SafeState",
    "Sensor",
    "Service",
    "StopChannel",
    "Timing",
    "ToolVerb",
    "WatchedFirmware",
    "Wire",
    "WireDown",
    "arm_table",
    "axis_gates",
    "check_fallbacks",
    "fallbacks_for",
    "meanings",
    "option",
    "past_range",
    "plain",
    "quaternion",
    "read_options",
    "roll_pitch_yaw",
    "secrets_of",
    "stale",
    "too_fast",
]
