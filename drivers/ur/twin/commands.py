"""Classify the requests of a UR controller's clients for the log (wire log). No I/O, no clock.

A request is a command to ur-rtde's control script in RTDE registers, a line for the dashboard, or a program.
"""

from __future__ import annotations

import enum

from strands_actors.drivers.ur.protocol import SafetyMode

NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

REGISTERS = 48
"""Number of registers of each type. 0 to 23 are for a fieldbus or a PLC, 24 to 47 for RTDE clients."""
UPPER_RANGE = 24

SINGLE_BITS = range(64, 128)
"""Bit registers that have a name each. The first 64 bits are read and written in groups of 32."""

STATUS_POWER_ON, STATUS_PROGRAM_RUNNING, STATUS_TEACH = 1, 2, 4
"""Bits of ``robot_status_bits``."""

SAFETY_BITS = {
    SafetyMode.NORMAL: 1 << 0,
    SafetyMode.REDUCED: 1 << 0 | 1 << 1,
    SafetyMode.PROTECTIVE_STOP: 1 << 2 | 1 << 10,
    SafetyMode.RECOVERY: 1 << 3,
    SafetyMode.SAFEGUARD_STOP: 1 << 4 | 1 << 10,
    SafetyMode.SYSTEM_EMERGENCY_STOP: 1 << 5 | 1 << 7 | 1 << 10,
    SafetyMode.ROBOT_EMERGENCY_STOP: 1 << 6 | 1 << 7 | 1 << 10,
    SafetyMode.VIOLATION: 1 << 8 | 1 << 10,
    SafetyMode.FAULT: 1 << 9 | 1 << 10,
}
"""``safety_status_bits`` of each mode. Bit 10 means that the mode has stopped the arm."""


# -- the control script of ur-rtde, commanded by input registers


class Command(enum.IntEnum):
    """Commands to ur-rtde's control script: the numbers that clients write into its first integer register."""

    NONE = 0
    MOVE_J = 1
    MOVE_J_IK = 2
    MOVE_L = 3
    MOVE_L_FK = 4
    FORCE_MODE = 6
    END_FORCE_MODE = 7
    ZERO_FT_SENSOR = 8
    SPEED_J = 9
    SPEED_L = 10
    SERVO_J = 11
    SERVO_C = 12
    SPEED_STOP = 15
    SERVO_STOP = 16
    SET_PAYLOAD = 17
    TEACH_MODE = 18
    END_TEACH_MODE = 19
    FORCE_MODE_DAMPING = 20
    FORCE_MODE_GAIN = 21
    SERVO_L = 24
    TOOL_CONTACT = 25
    GET_STEP_TIME = 26
    SET_TCP = 29
    GET_INVERSE_KINEMATICS_NEAR = 30
    PROTECTIVE_STOP = 31
    STOP_L = 33
    STOP_J = 34
    SET_WATCHDOG = 35
    IS_POSE_WITHIN_LIMITS = 36
    ARE_JOINTS_WITHIN_LIMITS = 37
    GET_JOINT_TORQUES = 38
    POSE_TRANS = 39
    GET_TCP_OFFSET = 40
    JOG_START = 41
    JOG_STOP = 42
    GET_FORWARD_KINEMATICS = 43
    GET_FORWARD_KINEMATICS_OF = 44
    MOVE_PATH = 45
    GET_INVERSE_KINEMATICS = 46
    IS_STEADY = 47
    MOVE_UNTIL_CONTACT = 51
    FREEDRIVE = 52
    END_FREEDRIVE = 53
    GET_FREEDRIVE_STATUS = 54
    GET_FLANGE_POSE = 58
    SET_GRAVITY = 59
    HAS_INVERSE_KINEMATICS = 60
    HAS_INVERSE_KINEMATICS_NEAR = 61
    START_CONTACT_DETECTION = 62
    STOP_CONTACT_DETECTION = 63
    READ_CONTACT_DETECTION = 64
    SET_TARGET_PAYLOAD = 65
    KICK_WATCHDOG = 99
    STOP_SCRIPT = 255


REFUSED = {
    27: "get_actual_joint_positions_history",
    28: "get_target_waypoint",
    56: "ft_rtde_input_enable",
    57: "enable_external_ft_sensor",
    66: "direct_torque",
    67: "get_mass_matrix",
    68: "get_coriolis_and_centrifugal_torques",
    69: "get_target_joint_accelerations",
    70: "get_jacobian",
    71: "get_jacobian_time_derivative",
}
"""Commands that the simulated controller does not support, with the names of their URScript functions.

On a real controller of this version (5.13), the script of ur-rtde does nothing at the commands 66 to 71, and is
then ready for the next one. Here it ends with an error, because nothing may seem done that is not.
"""

READY, DONE = 1, 2
"""Answers of the control script in its first output register."""

AT_ONCE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58})
"""Real-time commands, which the script answers with READY at once, without DONE.

ur-rtde sends them without waiting for an answer. So a getter among them (26, 38, 58) returns the registers as they
were before the script has read the command: the answer of an earlier call.
"""

FORCED = frozenset({6, 7, 8, 15, 16, 20, 21, 25, 31, 33, 34, 42, 62, 63, 64})
"""Commands of motion or force that are carried out during force mode. A motion on top of it is not simulated."""

MOTION = frozenset({1, 2, 3, 4, 6, 9, 10, 11, 12, 18, 24, 41, 45, 51, 52, 66})
"""Commands that move the arm, or let it be moved by hand."""

STOPS = frozenset(
    {
        Command.SPEED_STOP,
        Command.SERVO_STOP,
        Command.STOP_L,
        Command.STOP_J,
        Command.JOG_STOP,
        Command.PROTECTIVE_STOP,
        Command.STOP_SCRIPT,
    }
)


def classify_command(number: int) -> str:
    """Return the kind of a command to the control script for the wire log: ``setpoint``, ``safe``, and so on."""
    if number in MOTION:
        return "setpoint"
    if number in STOPS:
        return "safe"
    return "keepalive" if number in (Command.NONE, Command.KICK_WATCHDOG) else "config"


# -- scripts and dashboard lines

_STOP_LINES = frozenset({"stop", "pause", "power off", "shutdown"})
_ENABLE_LINES = frozenset(
    {"play", "power on", "brake release", "unlock protective stop", "restart safety", "close safety popup"}
)


def classify_dashboard(line: str) -> str:
    """Return the kind of a dashboard line for the wire log: ``safe``, ``enable`` or ``read``."""
    words = line.strip().lower()
    if words in _STOP_LINES:
        return "safe"
    return "enable" if words in _ENABLE_LINES else "read"


def classify_script(text: bytes) -> str:
    """Return the kind of a program for the wire log.

    It is ``safe`` for a program that only stops the arm. Any other program may move the arm and is ``enable``.
    """
    words = text.strip()
    return "safe" if words.startswith((b"stopj(", b"stopl(")) and b"\n" not in words else "enable"
