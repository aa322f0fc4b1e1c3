"""A valid request to each register that the twin models, and the state in which it has an effect."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping

from strands_actors.drivers.xarm.protocol import Mode, Register, floats
from strands_actors.drivers.xarm.twin.controller import Controller
from strands_actors.drivers.xarm.twin.devices import GRIPPER, TOOL_BOARD, Devices, Gripper
from strands_actors.drivers.xarm.twin.registers import REGISTERS, SETTINGS, Other

POSE = (400.0, 0.0, 350.0, 3.14, 0.0, 0.0)
SPEEDS = (100.0, 1000.0, 0.0)
JOINTS = floats((0.1, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.5, 10.0, 0.0))
NEAR = floats((0.1, -0.247, 0.0, 0.909, 0.0, 1.156, 0.0, 0.5, 10.0, 0.0))
LINE = floats((*POSE, *SPEEDS))
AXIS_ANGLE = floats((400.0, 0.0, 350.0, 3.14, 0.0, 0.0))


def ready(mode: int) -> Callable[[Controller], None]:
    """Return a function that brings a twin into a mode, ready to move."""

    def act(twin: Controller) -> None:
        twin.obey(Register.MOTION_ENABLE, b"\x08\x01")
        twin.obey(Register.SET_MODE, bytes((mode,)))
        twin.obey(Register.SET_STATE, b"\0")

    return act


def warn(twin: Controller) -> None:
    twin.warning = 11


def tool(device: int, address: int, value: float | None = None) -> bytes:
    """Return a request to a device at the tool: a read, or a write of a value."""
    return bytes((device,)) + struct.pack(">H", address) + (b"" if value is None else floats((value,)))


REQUESTS: Mapping[int, bytes] = {
    **dict.fromkeys(REGISTERS.effects, b""),
    Register.MOTION_ENABLE: b"\x08\x01",
    Register.SET_STATE: b"\0",
    Register.SET_MODE: bytes((Mode.SERVO,)),
    Register.MOVE_LINE: LINE,
    Register.MOVE_LINE_ROUNDED: LINE + floats((0.0,)),
    Register.MOVE_JOINT: JOINTS,
    Register.MOVE_JOINT_ROUNDED: JOINTS,
    Register.MOVE_HOME: floats((0.5, 10.0, 0.0)),
    Register.PAUSE: floats((1.0,)),
    Register.MOVE_CIRCLE: floats((*POSE, 400.0, 50.0, 380.0, 3.14, 0.0, 0.0, *SPEEDS, 50.0)),
    Register.MOVE_LINE_TOOL: floats((0.0, 0.0, 20.0, 0.0, 0.0, 0.0, *SPEEDS)),
    Register.SERVO_JOINT: NEAR,
    Register.SERVO_POSE: floats((400.0, 5.0, 400.0, 3.14, 0.0, 0.0, *SPEEDS)),
    Register.JOINT_STATES: b"\3",
    Register.JOINT_VELOCITY: JOINTS[:28] + b"\1",
    Register.POSE_VELOCITY: floats((0.0, 50.0, 0.0, 0.0, 0.0, 0.0)) + b"\0",
    Register.MOVE_RELATIVE: floats((0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 10.0, 0.0, -1.0)) + b"\1\0",
    Register.MOVE_LINE_AXIS_ANGLE: LINE + b"\0\0",
    Register.SERVO_POSE_AXIS_ANGLE: floats((9.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)) + struct.pack("<iB", 0, 1),
    Other.SET_BRAKE: b"\1\1",
    Other.INVERSE_KINEMATICS: floats(POSE),
    Other.FORWARD_KINEMATICS: JOINTS[:28],
    Other.CHECK_JOINTS: JOINTS[:28],
    Other.CHECK_POSE: floats(POSE),
    Other.REDUCED_MM_S: floats((250.0,)),
    Other.REDUCED_RAD_S: floats((0.5,)),
    Other.SET_REDUCED: b"\1",
    Other.BOUNDARY: struct.pack("<6i", 500, -500, 500, -500, 500, 0),
    Other.REDUCED_RANGE: floats((-1.0, 1.0) * 7),
    Other.SET_FENCE: b"\1",
    Other.REPORT_CURRENTS: b"\0",
    Other.POSE_OFFSET: floats((*POSE, *POSE)) + b"\0\0",
    Register.TOOL_RS485: bytes((TOOL_BOARD, GRIPPER)) + struct.pack(">BHH", 3, Gripper.POSITION, 2),
    Register.TOOL_WRITE_16: tool(GRIPPER, Gripper.ENABLE, 1.0),
    Register.TOOL_READ_16: tool(TOOL_BOARD, Devices.BAUD),
    Other.TOOL_WRITE_32: tool(GRIPPER, Gripper.TARGET, 300.0),
    Other.TOOL_READ_32: tool(GRIPPER, Gripper.POSITION),
    Other.IO_DIGITAL_OUTPUTS: struct.pack(">H", 0x0101),
    Other.IO_ANALOG_OUTPUT_1: struct.pack(">H", 1000),
    Other.IO_ANALOG_OUTPUT_2: struct.pack(">H", 1000),
    Other.IO_INPUT_FUNCTION: b"\1\2",
    Other.IO_OUTPUT_FUNCTION: b"\1\2",
    **{register: bytes(setting.size) for register, setting in SETTINGS.items()},
}

POSITION_MOTIONS = (
    Register.MOVE_LINE,
    Register.MOVE_LINE_ROUNDED,
    Register.MOVE_JOINT,
    Register.MOVE_JOINT_ROUNDED,
    Register.MOVE_HOME,
    Register.PAUSE,
    Register.MOVE_CIRCLE,
    Register.MOVE_LINE_TOOL,
    Register.MOVE_RELATIVE,
    Register.MOVE_LINE_AXIS_ANGLE,
)
SERVO_MOTIONS = (Register.SERVO_JOINT, Register.SERVO_POSE, Register.SERVO_POSE_AXIS_ANGLE)

PREPARE: Mapping[int, Callable[[Controller], None]] = {
    Register.SET_STATE: lambda twin: twin._enable(8, True),
    Register.CLEAR_ERROR: lambda twin: twin.fail(24),
    Register.CLEAR_WARNING: warn,
    Register.JOINT_VELOCITY: ready(Mode.VELOCITY),
    Register.POSE_VELOCITY: ready(Mode.POSE_VELOCITY),
    Other.COUNTER_RESET: lambda twin: twin.obey(Other.COUNTER_PLUS, b"") and None,
    **dict.fromkeys(POSITION_MOTIONS, ready(Mode.POSITION)),
    **dict.fromkeys(SERVO_MOTIONS, ready(Mode.SERVO)),
}
