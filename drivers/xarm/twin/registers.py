"""The registers of the control port that the simulated controller models, and the settings that it stores."""

from __future__ import annotations

import enum
from typing import NamedTuple

from strands_actors.drivers.common.twin.modelled import Modelled
from strands_actors.drivers.xarm.protocol import Mode, Register


class Other(enum.IntEnum):
    """Registers that only the twin knows. Our driver does not use them."""

    SET_BRAKE = 18
    INVERSE_KINEMATICS = 43
    FORWARD_KINEMATICS = 44
    CHECK_JOINTS = 45
    CHECK_POSE = 46
    REDUCED_MM_S = 47
    REDUCED_RAD_S = 48
    GET_REDUCED = 49
    SET_REDUCED = 50
    BOUNDARY = 52
    REDUCED_STATE = 53
    REDUCED_RANGE = 58
    SET_FENCE = 59
    REPORT_CURRENTS = 70
    WORLD_OFFSET = 73
    COUNTER_RESET = 74
    COUNTER_PLUS = 75
    POSE_OFFSET = 76
    TCP_POSE_AXIS_ANGLE = 91
    TOOL_ERRORS = 125
    TOOL_WRITE_32 = 129
    TOOL_READ_32 = 130
    IO_DIGITAL_INPUTS = 131
    IO_ANALOG_INPUT_1 = 132
    IO_ANALOG_INPUT_2 = 133
    IO_DIGITAL_OUTPUTS = 134
    IO_ANALOG_OUTPUT_1 = 135
    IO_ANALOG_OUTPUT_2 = 136
    IO_INPUT_FUNCTION = 137
    IO_OUTPUT_FUNCTION = 138
    IO_STATE = 139


LIMITS = (
    *range(Other.REDUCED_MM_S, Other.SET_REDUCED + 1),
    Other.BOUNDARY,
    Other.REDUCED_STATE,
    Other.REDUCED_RANGE,
    Other.SET_FENCE,
)
"""Registers of the reduced mode and the safety boundary."""

DEVICES = range(Register.TOOL_RS485, Other.IO_STATE + 1)
"""Registers of the tool's board and of the inputs and outputs."""

MODES = tuple(Mode)

ANSWER_SIZE = 128
"""Bytes of zeros in the answer to an invalid request. The vendor's client decodes the answer of a read even if the
state byte says "invalid", so a shorter answer would end the client with an exception [assumed]. No answer that the
client decodes is longer."""


class Setting(NamedTuple):
    """A setting that clients write into a register, and read in the reports."""

    name: str
    size: int  # of the data of the request, in bytes
    place: int  # in a report, in bytes from its start


TOOL_OFFSET, COLLISION_SENSITIVITY = 35, 37

SETTINGS: dict[int, Setting] = {
    31: Setting("tool jerk", 4, 181),
    32: Setting("highest tool acceleration", 4, 189),
    33: Setting("joint jerk", 4, 201),
    34: Setting("highest joint acceleration", 4, 209),
    TOOL_OFFSET: Setting("tool offset, which poses then include", 24, 91),
    36: Setting("payload and its centre", 16, 115),
    COLLISION_SENSITIVITY: Setting("collision sensitivity, 0 to 5; 0 switches error 31 off", 1, 131),
    38: Setting("teaching sensitivity", 1, 132),
    51: Setting("direction of gravity", 12, 133),
    Other.WORLD_OFFSET: Setting("offset of the base, which poses then include", 24, 288),
}

REGISTERS: Modelled[int] = Modelled(
    "registers of the control port",
    {
        Register.VERSION: "returns the version text",
        Register.SERIAL: "returns the serial number",
        Register.MOTION_ENABLE: "switches motors on or off; without power the brakes hold",
        Register.SET_STATE: "0 readies the arm, 3 pauses it, 4 stops it; other numbers are invalid",
        Register.GET_STATE: "returns the state",
        Register.QUEUE: "returns the number of queued motions",
        Register.ERRORS: "returns error and warning",
        Register.CLEAR_ERROR: "removes the error",
        Register.CLEAR_WARNING: "removes the warning",
        Register.SET_MODE: "0, 1, 2, 4, 5, 6 or 7, and stops the arm; other modes are invalid",
        Register.MOVE_LINE: "moves the tool on a line; only in modes 0 (queued) and 7 (at once); error 21",
        Register.MOVE_LINE_ROUNDED: "as 21, without rounded corners",
        Register.MOVE_JOINT: "turns joints to a goal; only in modes 0 (queued) and 6 (at once); error 23",
        Register.MOVE_JOINT_ROUNDED: "as 23, without rounded corners",
        Register.MOVE_HOME: "queues a motion of all joints to zero; only in mode 0",
        Register.PAUSE: "queues a pause; only in mode 0",
        Register.MOVE_CIRCLE: "queues a circle of the tool through two poses; only in mode 0",
        Register.MOVE_LINE_TOOL: "as 21, with a pose in the frame of the tool",
        Register.SERVO_JOINT: "moves to joint positions; only in mode 1; error 23 out of range, 24 for large steps",
        Register.SERVO_POSE: "moves the tool to a pose; only in mode 1; errors 21, 23 and 24",
        Register.TCP_POSE: "returns the pose of the tool",
        Register.JOINT_STATES: "returns positions, speeds and torques of the joints",
        Register.JOINT_TORQUE: "returns the torques of the joints",
        Register.JOINT_VELOCITY: "turns the joints at speeds; only in mode 4; error 23 at the end of a range",
        Register.POSE_VELOCITY: "moves the tool at a speed; only in mode 5; error 23 at the end of a range",
        Register.MOVE_RELATIVE: "moves by joint angles or by a pose; only in modes 0, 6 and 7",
        Register.MOVE_LINE_AXIS_ANGLE: "as 21, with a rotation vector",
        Register.SERVO_POSE_AXIS_ANGLE: "as 30, with a rotation vector",
        Other.SET_BRAKE: "releases a joint that a hand can turn then, or brakes it",
        Other.INVERSE_KINEMATICS: "returns joint positions for a pose; invalid if it cannot be reached",
        Other.FORWARD_KINEMATICS: "returns the pose for joint positions",
        Other.CHECK_JOINTS: "returns whether joint positions are out of range",
        Other.CHECK_POSE: "returns whether a pose is out of reach",
        Other.REDUCED_MM_S: "sets the highest speed of the tool in the reduced mode, for lines",
        Other.REDUCED_RAD_S: "sets the highest speed of the joints in the reduced mode",
        Other.GET_REDUCED: "returns whether the arm is in the reduced mode",
        Other.SET_REDUCED: "switches the reduced mode on or off",
        Other.BOUNDARY: "sets the box that the tool must not leave",
        Other.REDUCED_STATE: "returns all settings of reduced mode and boundary",
        Other.REDUCED_RANGE: "sets the ranges of the joints in the reduced mode",
        Other.SET_FENCE: "switches the boundary on or off; error 35 outside of it",
        Other.REPORT_CURRENTS: "accepts 0, torques; invalid for currents",
        Other.COUNTER_RESET: "sets the counter of the rich reports to 0",
        Other.COUNTER_PLUS: "adds 1 to the counter of the rich reports",
        Other.POSE_OFFSET: "returns one pose in the frame of another",
        Other.TCP_POSE_AXIS_ANGLE: "returns the pose of the tool with a rotation vector",
        Register.TOOL_RS485: "Modbus RTU to the gripper: enable, speed, position, status, error; else invalid",
        Other.TOOL_ERRORS: "returns the errors of the gripper and of the tool's board",
        Register.TOOL_WRITE_16: "writes to the tool's board or the gripper: outputs, baud rate, gripper",
        Register.TOOL_READ_16: "reads from the tool's board or the gripper: inputs, outputs, baud rate, gripper",
        Other.TOOL_WRITE_32: "as 127",
        Other.TOOL_READ_32: "as 128",
        Other.IO_DIGITAL_INPUTS: "returns the digital inputs of the control box",
        Other.IO_ANALOG_INPUT_1: "returns analog input 0 of the control box",
        Other.IO_ANALOG_INPUT_2: "returns analog input 1 of the control box",
        Other.IO_DIGITAL_OUTPUTS: "sets digital outputs after the queued motions; 139 and rich reports show them",
        Other.IO_ANALOG_OUTPUT_1: "sets analog output 0 after the queued motions; shown as above",
        Other.IO_ANALOG_OUTPUT_2: "sets analog output 1 after the queued motions; shown as above",
        Other.IO_INPUT_FUNCTION: "stores the function of an input, without its effect; shown as above",
        Other.IO_OUTPUT_FUNCTION: "stores the function of an output, without its effect; shown as above",
        Other.IO_STATE: "returns all inputs, outputs and their functions",
        **{register: f"stores the {setting.name}; the reports show it" for register, setting in SETTINGS.items()},
    },
    'the bit "invalid" (0x08) in the state byte',
)
