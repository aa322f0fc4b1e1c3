"""What clients of a UR controller tell it, and what that counts as in the wire log: the registers
by which ur-rtde's control script is told what to do, lines of the dashboard, programs. No I/O, no
clock."""

from __future__ import annotations

import enum

from strands_actors.drivers.ur.protocol import SafetyMode

NOT_FOUND, IN_USE = "NOT_FOUND", "IN_USE"

REGISTERS = 48
"""Of each sort. 0 to 23 belong to fieldbus and PLC, 24 to 47 to RTDE clients."""
UPPER_RANGE = 24

STATUS_POWER_ON, STATUS_PROGRAM_RUNNING = 1, 2
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
"""``safety_status_bits`` of each mode: bit 10 says that the arm is stopped for it."""


# -- the control script of ur-rtde, told what to do by input registers


class Command(enum.IntEnum):
    """Numbers in its first integer register. The script's own first output register answers."""

    NONE = 0
    MOVE_J = 1
    SPEED_J = 9
    SERVO_J = 11
    SPEED_STOP = 15
    SERVO_STOP = 16
    SET_PAYLOAD = 17
    GET_STEP_TIME = 26
    STOP_L = 33
    STOP_J = 34
    PROTECTIVE_STOP = 31
    SET_WATCHDOG = 35
    IS_POSE_WITHIN_LIMITS = 36
    ARE_JOINTS_WITHIN_LIMITS = 37
    GET_JOINT_TORQUES = 38
    IS_STEADY = 47
    KICK_WATCHDOG = 99
    STOP_SCRIPT = 255


READY, DONE = 1, 2
"""What the script answers."""

AT_ONCE = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58})
"""Real-time commands: answered READY without an execution."""

MOTION = frozenset({1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14})
"""Commands that move the arm; those this wire does not use by their neighbourhood [assumed]."""

STOPS = frozenset(
    {
        Command.SPEED_STOP,
        Command.SERVO_STOP,
        Command.STOP_L,
        Command.STOP_J,
        Command.PROTECTIVE_STOP,
        Command.STOP_SCRIPT,
    }
)


def classify_command(number: int) -> str:
    """The kind, in the wire log, of a data packet that carries a command register."""
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
    """The kind of a dashboard line in the wire log."""
    words = line.strip().lower()
    if words in _STOP_LINES:
        return "safe"
    return "enable" if words in _ENABLE_LINES else "read"


def classify_script(text: bytes) -> str:
    """A program that only stops is a safe frame; any other gets the power to move the arm."""
    words = text.strip()
    return "safe" if words.startswith((b"stopj(", b"stopl(")) and b"\n" not in words else "enable"
