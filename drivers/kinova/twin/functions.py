"""Name the functions that only the simulated base has, and state what it models.

The numbers and the names of the message types are those of the vendor's public protobuf definitions (Kortex 2.6).
"""

from __future__ import annotations

import enum

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.kinova.protocol import Call


class Function(enum.IntEnum):
    """Functions that this project's driver does not call. See ``protocol.Call`` for the others."""

    CREATE_USER_PROFILE = 0x20001
    DELETE_USER_PROFILE = 0x20004
    CREATE_SEQUENCE = 0x20008
    READ_SEQUENCE = 0x2000A
    DELETE_SEQUENCE = 0x2000B
    READ_ALL_SEQUENCES = 0x2000C
    PLAY_SEQUENCE = 0x2000F
    STOP_SEQUENCE = 0x20011
    CREATE_PROTECTION_ZONE = 0x20014
    READ_PROTECTION_ZONE = 0x20016
    DELETE_PROTECTION_ZONE = 0x20017
    READ_ALL_PROTECTION_ZONES = 0x20018
    CREATE_ACTION = 0x2002A
    READ_ACTION = 0x2002B
    READ_ALL_ACTIONS = 0x2002C
    DELETE_ACTION = 0x2002D
    EXECUTE_ACTION_FROM_REFERENCE = 0x2002F
    EXECUTE_ACTION = 0x20030
    STOP_ACTION = 0x20032
    UNSUBSCRIBE = 0x20061
    CONFIGURATION_CHANGE_TOPIC = 0x20062
    SEQUENCE_INFO_TOPIC = 0x20066
    ACTION_TOPIC = 0x2006A
    PLAY_CARTESIAN_TRAJECTORY = 0x2006D
    GET_MEASURED_CARTESIAN_POSE = 0x20073
    SEND_TWIST_COMMAND = 0x20079
    PLAY_JOINT_TRAJECTORY = 0x2007C
    GET_MEASURED_JOINT_ANGLES = 0x2007E
    SEND_GRIPPER_COMMAND = 0x20088
    GET_MEASURED_GRIPPER_MOVEMENT = 0x20089
    SERVOING_MODE_TOPIC = 0x2009A
    ARM_STATE_TOPIC = 0x200B0
    GET_ALL_JOINTS_SPEED_HARD_LIMITATION = 0x200B7
    GET_TWIST_HARD_LIMITATION = 0x200B9
    GET_PRODUCT_CONFIGURATION = 0x200C6
    EXECUTE_WAYPOINT_TRAJECTORY = 0x200E2
    COMPUTE_FORWARD_KINEMATICS = 0x200E9
    COMPUTE_INVERSE_KINEMATICS = 0x200EA
    VALIDATE_WAYPOINT_LIST = 0x200EB
    REFRESH = 0x30001
    REFRESH_COMMAND = 0x30002
    GET_DEVICE_TYPE = 0x90003
    GET_FIRMWARE_VERSION = 0x90004
    GET_BOOTLOADER_VERSION = 0x90005
    GET_MODEL_NUMBER = 0x90006
    GET_PART_NUMBER = 0x90007
    GET_SERIAL_NUMBER = 0x90008
    GET_MAC_ADDRESS = 0x90009
    GET_PART_NUMBER_REVISION = 0x9000C
    GET_CONTROL_MODE = 0xA0006
    SET_CONTROL_MODE = 0xA0007
    READ_ALL_DEVICES = 0x170001


SERVICES = frozenset((0x1, 0x2, 0x3, 0x9, 0xA, 0x17))
"""Services of the simulated base: session, base, cyclic data, device and actuator configuration, devices."""

CALLS: Modelled[int] = Modelled(
    "calls of the base",
    {
        Call.CREATE_SESSION: "opens a session; an error for a wrong user or password",
        Call.CLOSE_SESSION: "closes the session",
        Call.KEEP_ALIVE: "keeps the session",
        Call.STOP: "stops the arm and the gripper, and aborts an action or a sequence",
        Call.SEND_JOINT_SPEEDS: "turns the joints; an error in a wrong mode or state, or for too fast speeds",
        Call.APPLY_EMERGENCY_STOP: "stops the arm in the state of a fault",
        Call.CLEAR_FAULTS: "ends the state of a fault",
        Call.SET_SERVOING_MODE: "sets the mode and stops the arm; an error in the state of a fault",
        Call.GET_SERVOING_MODE: "returns the mode",
        Call.GET_ACTUATOR_COUNT: "returns the number of joints",
        Call.GET_ARM_STATE: "returns the state",
        Call.REFRESH_FEEDBACK: "returns the readings of base, joints and gripper",
        Function.CREATE_USER_PROFILE: "adds a user, who may open sessions",
        Function.DELETE_USER_PROFILE: "removes a user",
        Function.CREATE_SEQUENCE: "stores a sequence of actions",
        Function.READ_SEQUENCE: "returns a sequence",
        Function.DELETE_SEQUENCE: "removes a sequence",
        Function.READ_ALL_SEQUENCES: "returns all sequences",
        Function.PLAY_SEQUENCE: "carries out the actions of a sequence, one after the other",
        Function.STOP_SEQUENCE: "stops the sequence",
        Function.CREATE_PROTECTION_ZONE: "adds a zone that the tool does not enter",
        Function.READ_PROTECTION_ZONE: "returns a zone",
        Function.DELETE_PROTECTION_ZONE: "removes a zone",
        Function.READ_ALL_PROTECTION_ZONES: "returns all zones",
        Function.CREATE_ACTION: "stores an action",
        Function.READ_ACTION: "returns an action",
        Function.READ_ALL_ACTIONS: "returns the stored actions of one type, or all: with Retract, Home, Zero",
        Function.DELETE_ACTION: "removes an action",
        Function.EXECUTE_ACTION_FROM_REFERENCE: "carries out a stored action",
        Function.EXECUTE_ACTION: "carries out an action",
        Function.STOP_ACTION: "aborts the action",
        Function.UNSUBSCRIBE: "ends a subscription",
        Function.CONFIGURATION_CHANGE_TOPIC: "subscribes to changes of users, actions, sequences and zones",
        Function.SEQUENCE_INFO_TOPIC: "subscribes to the events of sequences",
        Function.ACTION_TOPIC: "subscribes to the events of actions",
        Function.PLAY_CARTESIAN_TRAJECTORY: "moves the tool to a pose",
        Function.GET_MEASURED_CARTESIAN_POSE: "returns the pose of the tool",
        Function.SEND_TWIST_COMMAND: "moves the tool at a velocity until the next command, whatever its duration",
        Function.PLAY_JOINT_TRAJECTORY: "turns the joints to a goal",
        Function.GET_MEASURED_JOINT_ANGLES: "returns the angles of the joints",
        Function.SEND_GRIPPER_COMMAND: "moves the gripper to a position or at a speed",
        Function.GET_MEASURED_GRIPPER_MOVEMENT: "returns position or speed of the gripper; no finger without one",
        Function.SERVOING_MODE_TOPIC: "subscribes to changes of the servoing mode",
        Function.ARM_STATE_TOPIC: "subscribes to changes of the state",
        Function.GET_ALL_JOINTS_SPEED_HARD_LIMITATION: "returns the highest speed of each joint",
        Function.GET_TWIST_HARD_LIMITATION: "returns the highest speed of the tool",
        Function.GET_PRODUCT_CONFIGURATION: "returns model, number of joints, and gripper",
        Function.EXECUTE_WAYPOINT_TRAJECTORY: "moves through waypoints, and stops at each",
        Function.COMPUTE_FORWARD_KINEMATICS: "returns the pose for angles",
        Function.COMPUTE_INVERSE_KINEMATICS: "returns angles for a pose; an error without a solution",
        Function.VALIDATE_WAYPOINT_LIST: "returns the errors of waypoints",
        Function.REFRESH: "in low-level servoing: sets the goals of joints and gripper, and returns the readings",
        Function.REFRESH_COMMAND: "in low-level servoing: sets the goals of joints and gripper",
        Function.GET_DEVICE_TYPE: "returns the type of base, actuator, interface or gripper",
        Function.GET_FIRMWARE_VERSION: "returns a version",
        Function.GET_BOOTLOADER_VERSION: "returns a version",
        Function.GET_MODEL_NUMBER: "returns a text",
        Function.GET_PART_NUMBER: "returns a text",
        Function.GET_SERIAL_NUMBER: "returns a text",
        Function.GET_MAC_ADDRESS: "returns an address",
        Function.GET_PART_NUMBER_REVISION: "returns a text",
        Function.GET_CONTROL_MODE: "returns the control mode of an actuator",
        Function.SET_CONTROL_MODE: "sets position or torque control of an actuator, in low-level servoing",
        Function.READ_ALL_DEVICES: "returns base, actuators, interface and gripper",
    },
    "an error of the server, UNSUPPORTED_METHOD or UNSUPPORTED_SERVICE",
)


class ActionKind(enum.IntEnum):
    """``ActionType`` of the vendor."""

    UNSPECIFIED = 0
    SEND_TWIST_COMMAND = 1
    SEND_WRENCH_COMMAND = 2
    SEND_JOINT_SPEEDS = 4
    REACH_POSE = 6
    REACH_JOINT_ANGLES = 7
    TOGGLE_ADMITTANCE_MODE = 13
    SNAPSHOT = 14
    SWITCH_CONTROL_MAPPING = 16
    NAVIGATE_JOINTS = 17
    NAVIGATE_MAPPINGS = 18
    CHANGE_TWIST = 22
    CHANGE_JOINT_SPEEDS = 23
    CHANGE_WRENCH = 25
    APPLY_EMERGENCY_STOP = 28
    CLEAR_FAULTS = 29
    TIME_DELAY = 31
    EXECUTE_ACTION = 32
    SEND_GRIPPER_COMMAND = 33
    SEND_GPIO_COMMAND = 34
    STOP_ACTION = 35
    PLAY_PRE_COMPUTED_TRAJECTORY = 39
    EXECUTE_SEQUENCE = 40
    EXECUTE_WAYPOINT_LIST = 41


ACTIONS: Modelled[int] = Modelled(
    "actions of the base",
    {
        ActionKind.SEND_TWIST_COMMAND: "moves the tool at a velocity until it is stopped",
        ActionKind.SEND_JOINT_SPEEDS: "turns the joints until they are stopped",
        ActionKind.REACH_POSE: "moves the tool on a line to a pose",
        ActionKind.REACH_JOINT_ANGLES: "turns the joints to a goal",
        ActionKind.APPLY_EMERGENCY_STOP: "stops the arm in the state of a fault",
        ActionKind.CLEAR_FAULTS: "ends the state of a fault",
        ActionKind.TIME_DELAY: "waits for some seconds",
        ActionKind.EXECUTE_ACTION: "carries out a stored action",
        ActionKind.SEND_GRIPPER_COMMAND: "moves the gripper; no event follows its start",
        ActionKind.STOP_ACTION: "stops the arm",
        ActionKind.EXECUTE_WAYPOINT_LIST: "moves through waypoints, and stops at each",
    },
    "an error of the device, UNSUPPORTED_ACTION",
)
